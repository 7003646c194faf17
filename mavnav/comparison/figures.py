"""Which runs of a comparison are best, and their relative cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mavnav.outputs.quantities import QUANTITIES, number, winners

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.outputs.quantities import Run

RELATIVE_COSTS: Final = {
    "evaluations": "search.evaluations_per_scan.mean",
    "cpu": "timing.cpu_s",
    "seconds": "timing.wall_s",
}
"""Relative cost -> the number of run.json that is divided by that of the coarsest grid."""


def best(runs: Sequence[Run | None]) -> dict[str, list[int]]:
    """Return by every metric which runs are the best."""
    return {figure.name: winners(figure, runs) for figure in QUANTITIES}


def relative_costs(groups: Sequence[tuple[object, int]], runs: Sequence[Run | None]) -> dict[str, list[Any]]:
    """Return the cost of each run relative to the coarsest of its group.

    Parameters
    ----------
    groups
        For each run its group (log and method) and the samples of its search: the fewer, the coarser.
    runs
        Their documents.

    Returns
    -------
    dict
        ``coarsest``: for each run the index of the coarsest of its group that has a result; and by the keys of
        `RELATIVE_COSTS` the ratio to it. None where there is nothing to divide, or to divide by.
    """
    coarsest: dict[object, int] = {}
    for k in sorted(range(len(runs)), key=lambda k: groups[k][1], reverse=True):
        if runs[k] is not None:
            coarsest[groups[k][0]] = k
    references = [coarsest.get(group) for group, _ in groups]
    ratios = {
        cost: [_ratio(runs, k, reference, name) for k, reference in enumerate(references)]
        for cost, name in RELATIVE_COSTS.items()
    }
    return {"coarsest": references, **ratios}


def _ratio(runs: Sequence[Run | None], k: int, reference: int | None, name: str) -> float | None:
    own, base = number(runs[k], name), None if reference is None else number(runs[reference], name)
    return None if own is None or not base else own / base
