"""The figures that cells are compared by: which there are, who is best, and what it costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from mavnav.errors import ExitCode, UsageError
from mavnav.gates import find

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    Run = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Figure:
    """A number of run.json: its name there, its title, and which is best.

    It is shown times ``factor`` with so many ``digits``, and what reads the same counts as the same. ``per_cell`` marks
    what counts cells of the map, and cannot be compared between maps of different cells; ``by_cells`` marks lengths
    that a map knows to a cell: smaller differences are none.
    """

    name: str
    title: str
    digits: int
    best: Literal["low", "high"]
    factor: float = 1.0
    per_cell: bool = False
    by_cells: bool = False

    def shown(self, number: float | None) -> str:
        """Write a number, or a dash where there is none."""
        return "-" if number is None else f"{number * self.factor:.{self.digits}f}"


FIGURES: Final = (
    Figure("map.accepted_share", "mapped %", 1, "high", 100.0),
    Figure("wall_thickness.2.p95_mm", "wall p95 mm", 0, "low", by_cells=True),
    Figure("wall_thickness.2.max_mm", "wall max mm", 0, "low", by_cells=True),
    Figure("map_quality.ghost_walls.length_m", "ghosts m", 1, "low"),
    Figure("map_quality.crispness.occupied_cells_per_m", "cells/m", 1, "low", per_cell=True),
    Figure("map_quality.crispness.entropy_bits", "entropy bit", 3, "low", per_cell=True),
    Figure("map_quality.revisits.nn_l_mm", "revisits mm", 1, "low"),
    Figure("reference.ate.rmse_m", "ATE mm", 0, "low", 1e3),
    Figure("reference.map_distance.mean_mm", "off the map mm", 0, "low"),
    Figure("search.evaluations_per_scan.mean", "evaluations", 0, "low"),
    Figure("timing.cpu_s", "cpu s", 2, "low"),
)

PRICES: Final = {
    "evaluations": "search.evaluations_per_scan.mean",
    "cpu": "timing.cpu_s",
    "seconds": "timing.wall_s",
}
"""Ratio -> the number of run.json that is divided by the coarsest grid's."""


def value(run: Run | None, name: str) -> float | None:
    """Return a number of run.json, None where there is no such number."""
    try:
        return None if run is None else find(run, name)
    except UsageError:
        return None


def best(runs: Sequence[Run | None]) -> dict[str, list[int]]:
    """Return by every figure which runs are the best.

    Only maps that mean something take part: those that map quality calls meaningful, of runs that were not lost. Nobody
    is best where fewer than two take part, or where all are equal.
    """
    eligible = [k for k, run in enumerate(runs) if run is not None and _meaningful(run)]
    return {figure.name: _best(figure, runs, eligible) for figure in FIGURES}


def _meaningful(run: Run) -> bool:
    quality = run.get("map_quality") or {}
    return bool(quality.get("meaningful", True)) and run["exit_code"] != ExitCode.TRACKING_LOST


def _best(figure: Figure, runs: Sequence[Run | None], eligible: Iterable[int]) -> list[int]:
    known = ((k, value(runs[k], figure.name)) for k in eligible)
    found = {k: round(number * figure.factor, figure.digits) for k, number in known if number is not None}
    cells_mm = {value(runs[k], "map.cell_mm") or 0.0 for k in found}
    if not found or (figure.per_cell and len(cells_mm) > 1):
        return []
    top = min(found.values()) if figure.best == "low" else max(found.values())
    least_difference = max(cells_mm) if figure.by_cells else 0.0
    equals = [k for k, number in found.items() if number == top or abs(number - top) < least_difference]
    return equals if len(equals) < len(found) else []


def prices(groups: Sequence[tuple[object, int]], runs: Sequence[Run | None]) -> dict[str, list[Any]]:
    """Say what each run costs, compared with the coarsest of its group.

    Parameters
    ----------
    groups
        For each run its group (log and method) and the points of its grids: the fewer, the coarser.
    runs
        Their documents.

    Returns
    -------
    dict
        ``coarsest``: for each run the index of the coarsest of its group that has a result; and by the keys of `PRICES`
        the ratio to it. None where there is nothing to divide, or to divide by.
    """
    coarsest: dict[object, int] = {}
    for k in sorted(range(len(runs)), key=lambda k: groups[k][1], reverse=True):
        if runs[k] is not None:
            coarsest[groups[k][0]] = k
    references = [coarsest.get(group) for group, _ in groups]
    ratios = {
        price: [_ratio(runs, k, reference, name) for k, reference in enumerate(references)]
        for price, name in PRICES.items()
    }
    return {"coarsest": references, **ratios}


def _ratio(runs: Sequence[Run | None], k: int, reference: int | None, name: str) -> float | None:
    own, base = value(runs[k], name), None if reference is None else value(runs[reference], name)
    return None if own is None or not base else own / base
