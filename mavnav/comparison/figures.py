"""The best runs of a comparison, and the relative cost of its runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mavnav.outputs.documents.quantities import QUANTITIES, comparable, number, ranked_values, winners

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.outputs.documents.quantities import Run

RELATIVE_COSTS: Final = {
    "evaluations": "search.evaluations_per_scan.mean",
    "cpu": "timing.cpu_s",
    "seconds": "timing.wall_s",
}
"""Name of a relative cost -> the number of run.json that is divided by that of the run with the coarsest grid."""


def best(runs: Sequence[Run | None]) -> dict[str, list[int]]:
    """Return the indices of the best runs by each metric."""
    return {figure.name: winners(figure, runs) for figure in QUANTITIES}


def one_best(runs: Sequence[Run | None]) -> dict[str, int | None]:
    """Return the index of the first of the best runs by each metric; None where not all runs can be compared."""
    compared = {f.name: comparable(f, [runs[k] for k in ranked_values(f, runs)]) for f in QUANTITIES}
    return {name: next(iter(places), None) if compared[name] else None for name, places in best(runs).items()}


def relative_costs(groups: Sequence[tuple[object, int]], runs: Sequence[Run | None]) -> dict[str, list[Any]]:
    """Return the cost of each run relative to the coarsest of its group.

    Parameters
    ----------
    groups
        For each run its group (log and method) and the number of samples of its search; fewer samples are coarser.
    runs
        run.json of each run, None if it failed.

    Returns
    -------
    dict
        ``coarsest``: for each run the index of the coarsest run of its group that has a result. For each key of
        `RELATIVE_COSTS`: the ratio of each run to that run, None if either number is missing or the divisor is 0.
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
