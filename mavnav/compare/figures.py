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
    """A number of run.json: its name there, its title, how it is written, and which is best.

    ``per_cell`` marks what counts cells of the map, and cannot be compared between maps of different cells.
    """

    name: str
    title: str
    form: str
    best: Literal["low", "high"]
    per_cell: bool = False


FIGURES: Final = (
    Figure("map.accepted_share", "mapped", "{:.1%}", "high"),
    Figure("wall_thickness.2.p95_mm", "wall p95 mm", "{:.0f}", "low"),
    Figure("wall_thickness.2.max_mm", "wall max mm", "{:.0f}", "low"),
    Figure("map_quality.ghost_walls.length_m", "ghosts m", "{:.1f}", "low"),
    Figure("map_quality.revisits.nn_l_mm", "revisits mm", "{:.1f}", "low"),
    Figure("map_quality.crispness.occupied_cells_per_m", "cells/m", "{:.1f}", "low", per_cell=True),
    Figure("search.evaluations_per_scan.mean", "evaluations", "{:.0f}", "low"),
    Figure("timing.cpu_s", "cpu s", "{:.2f}", "low"),
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


def winners(runs: Sequence[Run | None]) -> dict[str, int | None]:
    """Return the index of the best run by every figure; of equals the first.

    Only maps that mean something take part: those that map quality calls meaningful, of runs that were not lost. There
    is no winner where nobody takes part, or where all of several are equal.
    """
    eligible = [k for k, run in enumerate(runs) if run is not None and _meaningful(run)]
    return {figure.name: _winner(figure, runs, eligible) for figure in FIGURES}


def _meaningful(run: Run) -> bool:
    quality = run.get("map_quality") or {}
    return bool(quality.get("meaningful", True)) and run["exit_code"] != ExitCode.TRACKING_LOST


def _winner(figure: Figure, runs: Sequence[Run | None], eligible: Iterable[int]) -> int | None:
    found = {k: number for k in eligible if (number := value(runs[k], figure.name)) is not None}
    if figure.per_cell and len({value(runs[k], "map.cell_mm") for k in found}) > 1:
        return None
    if not found or (len(found) > 1 and len(set(found.values())) == 1):
        return None
    best = min(found.values()) if figure.best == "low" else max(found.values())
    return next(k for k in found if found[k] == best)


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
