"""Lower bounds of the cost for all candidates of a grid."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, helper
from mavnav.kernels.polar_search.cost import Beams, Work, span, to_polar
from mavnav.kernels.polar_search.fixed_beams import (
    FIXED_SHARE,
    BeamReach,
    HalfWindow,
    Sight,
    classify,
    find_fixed,
    reach_of,
    rest_of,
    sweep,
)
from mavnav.kernels.polar_search.polynomial import polynomial, sum_loose
from mavnav.kernels.polar_search.wide_bounds import bound_wide

FIXED_BEAMS, TRIMMED_BEAMS, WORTH_TRIMMING = 0.25, 6.0, 15
"""Bounds on the beams that points pass on the grid, on average.

Above the first, too few beams keep their segments. Above the second, or with fewer candidates than the third, trimming
is not worth its time, which is that of bounding some ten candidates.
"""
SUM_M2 = 1e-11
"""Upper bound of the change of a cost by the series of the bearings and the order of summation."""


@helper
def bound(scan: Beams, motions: F64_2D, offsets: F64_2D, window: HalfWindow, work: Work, bounds: F64_1D) -> Beams:
    """Write a lower bound of each candidate's cost, -inf if unknown.

    ``motions`` are those of the candidates, and of the grid's middle at the end; ``offsets`` (m, 2) are relative to it.
    Returns the scan without the parts that contribute nowhere on the grid: its cost is the same, to the bit.
    """
    virtual, points, limits = scan
    n, beams, middle = points.shape[1], len(virtual), motions[-1]
    to_polar(points, middle, limits, work.r[:n], work.beam[:n])
    reach, swept = BeamReach(np.empty(n), np.empty(n), np.empty(n)), np.empty((2, n))
    sight, fixed = Sight(np.empty(beams), np.empty(beams), np.empty(beams)), np.empty(beams, np.int64)
    passed, share = reach_of(scan, middle, window, work.r, reach)
    small = passed <= FIXED_BEAMS and share <= FIXED_SHARE
    if not small and (passed > TRIMMED_BEAMS or share > 0.5 or len(bounds) < WORTH_TRIMMING):
        bound_wide(scan, motions, work, bounds)
        return scan
    span(scan, work)
    sweep(scan, work.beam, reach.by_beams, swept)
    find_fixed(scan, work, reach, swept, sight, fixed)
    classify(scan, work, reach, sight, fixed, small)
    rest = rest_of(scan, swept, fixed)
    if not small:
        to_polar(rest, middle, limits, work.r[: rest.shape[1]], work.beam[: rest.shape[1]])
        trimmed = Beams(np.where(fixed < 0, virtual, np.nan), rest, limits)
        bound_wide(trimmed, motions, work, bounds)
        return trimmed
    p0, p_u, p_v, p_uu, p_uv, p_vv = polynomial(scan, middle, window, work, sight.seen, fixed)
    loose, sure = np.flatnonzero(fixed < 0), float(np.count_nonzero(fixed > 0))
    for i in range(len(bounds)):
        u, v = offsets[i]
        total, used = sum_loose(Beams(virtual, rest, limits), loose, motions[i], work)
        total += p0 + u * (p_u + u * p_uu + v * p_uv) + v * (p_v + v * p_vv)
        used += sure
        bounds[i] = total / used - SUM_M2 if used >= max(limits.fewest_beams, 1.0) else np.inf
    return scan
