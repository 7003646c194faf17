"""The figures by which runs are compared: where run.json has them, how they are written, and which run is best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from mavnav.errors import ExitCode, UsageError
from mavnav.metrics.gates import find

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    Run = Mapping[str, Any]

LEAST_MAPPED_SHARE: Final = 0.5
"""Where a run does not say itself whether its map means anything, it does not with fewer of the scans on it."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A number of run.json: its name there, its title and unit, and what it is.

    It is written times ``factor`` with so many ``digits``, and what reads the same counts as the same. ``better`` is -1
    where less is better, +1 where more is, 0 where neither. ``per_cell`` marks what counts cells of the map, and cannot
    be compared between maps of different cells, ``by_cells`` lengths that a map knows to a cell: smaller differences
    are none. A ``price`` is no virtue of the map. ``otherwise`` is a second name, of runs that do not have the first.
    """

    name: str
    title: str
    unit: str
    digits: int
    better: int
    about: str
    factor: float = 1.0
    per_cell: bool = False
    by_cells: bool = False
    price: bool = False
    otherwise: str = ""

    @property
    def head(self) -> str:
        """The title with the unit."""
        return f"{self.title} {self.unit}".rstrip()

    def of(self, run: Run | None) -> float | None:
        """Return the number of a run in the unit it is written in, None where there is none."""
        found = number(run, self.name)
        if found is None and self.otherwise:
            found = number(run, self.otherwise)
        return None if found is None else float(found) * self.factor

    def shown(self, run: Run | None) -> str:
        """Write the number of a run, or a dash where there is none."""
        value = self.of(run)
        return "-" if value is None else f"{value:.{self.digits}f}"


FIGURES: Final = (
    Figure("map.accepted_share", "mapped", "%", 1, 1, "share of the scans that are on the map", 100.0),
    Figure("wall_thickness.2.p95_mm", "wall p95", "mm", 0, -1,
           "95 % of the wall, by length, is not thicker (cells of at least 2 hits)", by_cells=True),
    Figure("wall_thickness.2.max_mm", "wall max", "mm", 0, -1, "the thickest section of a wall", by_cells=True),
    Figure("map_quality.ghost_walls.length_m", "ghosts", "m", 1, -1, "length of walls that stand on the map twice"),
    Figure("map_quality.crispness.occupied_cells_per_m", "cells per m", "", 1, -1, "occupied cells per metre of wall",
           per_cell=True),
    Figure("map_quality.crispness.entropy_bits", "entropy", "bit", 3, -1, "how undecided the cells are", per_cell=True),
    Figure("map_quality.revisits.nn_l_mm", "revisits", "mm", 1, -1,
           "how far scans of a place lie from scans of the same place at another time"),
    Figure("reference.ate.rmse_m", "ATE", "mm", 0, -1,
           "absolute trajectory error against the truth, root mean square, after alignment", 1e3,
           otherwise="truth.ate_rmse_m"),
    Figure("reference.map_distance.mean_mm", "off the map", "mm", 0, -1, "how far the walls lie from the true ones"),
    Figure("search.evaluations_per_scan.mean", "evaluations", "", 0, -1, "poses that the search tries for each scan",
           price=True),
    Figure("timing.cpu_s", "cpu", "s", 2, -1, "processor time of the whole run", price=True),
)  # fmt: skip

WAY: Final = Figure("tracking.path_length_m", "way", "m", 1, 0, "length of the way of the laser")
TIME: Final = Figure("timing.wall_s", "time", "s", 1, -1, "seconds that the run took", price=True)
"""Figures that are told, but not compared."""

NAMED: Final = {figure.name: figure for figure in FIGURES}


def number(run: Run | None, name: str) -> float | None:
    """Return a number of run.json, None where there is no such number."""
    try:
        return None if run is None else find(run, name)
    except UsageError:
        return None


def why_not_meaningful(run: Run) -> str:
    """Say why the map of a run is not to be compared with others; empty where it is."""
    quality = run.get("map_quality")
    if quality:
        return "" if quality.get("meaningful") else "; ".join(map(str, quality.get("why") or ["no usable map"]))
    if run.get("exit_code") == ExitCode.TRACKING_LOST or number(run, "tracking.lost"):
        return "the track was lost for good"
    share = number(run, "map.accepted_share") or 0.0
    return "" if share >= LEAST_MAPPED_SHARE else f"only {share:.0%} of the scans are on the map"


def winners(figure: Figure, runs: Sequence[Run | None]) -> list[int]:
    """Return which runs are best by a figure, up to differences that do not count.

    Only meaningful maps compete, at least two, and only of one cell size where the figure counts cells. Nobody is best
    where all are equal.
    """
    known = {k: figure.of(run) for k, run in enumerate(runs) if run is not None and not why_not_meaningful(run)}
    found = {k: round(value, figure.digits) for k, value in known.items() if value is not None}
    cells_mm = {number(runs[k], "map.cell_mm") or 0.0 for k in found}
    if not found or (figure.per_cell and len(cells_mm) > 1):
        return []
    top = max(found.values(), key=lambda value: figure.better * value)
    counts_from = max(cells_mm) if figure.by_cells else 0.0
    best = [k for k, value in found.items() if value == top or abs(value - top) < counts_from]
    return best if len(best) < len(found) else []
