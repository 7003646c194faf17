"""Groups of points that are linked along their direction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels.machine.jit import helper, kernel
from mavnav.kernels.machine.types import F64_2D, I64_1D, I64_3D, float64, int32

if TYPE_CHECKING:
    from numpy.typing import NDArray


@helper
def _root(parent: NDArray[np.int32], k: int) -> int:
    """Return the first point of the group of a point, and shorten the path to it."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel(int32[::1](F64_2D, F64_2D, I64_1D, I64_3D, float64, float64, float64))
def link_groups(
    xy_m: NDArray[np.float64],
    directions: NDArray[np.float64],
    order: NDArray[np.int64],
    spans: NDArray[np.int64],
    reach_m: float,
    across_m: float,
    sin_turn: float,
) -> NDArray[np.int32]:
    """Return the group number (n,) of each point (n, 2); groups are numbered in the order of their first points.

    ``directions`` (n, 2) are cosines and sines. Links of a point are searched among ``order[first:last]``, its
    stretches ``spans`` (n, stretches, 2); each pair must occur in those of one of both points at least. Two points are
    linked within ``reach_m`` if the sine between their directions is at most ``sin_turn`` and neither lies more than
    ``across_m`` off the line through the other.
    """
    n, reach_m2 = len(xy_m), reach_m * reach_m
    parent = np.arange(n).astype(np.int32)
    for a in range(n):
        ca, sa = directions[a]
        for k in range(spans.shape[1]):
            for at in range(spans[a, k, 0], spans[a, k, 1]):
                b = order[at]
                dx, dy = xy_m[b, 0] - xy_m[a, 0], xy_m[b, 1] - xy_m[a, 1]
                cb, sb = directions[b]
                if (
                    dx * dx + dy * dy > reach_m2
                    or abs(ca * sb - sa * cb) > sin_turn
                    or max(abs(ca * dy - sa * dx), abs(cb * dy - sb * dx)) > across_m
                ):
                    continue
                first, second = _root(parent, a), _root(parent, b)
                parent[max(first, second)] = min(first, second)
    groups = np.empty(n, np.int32)
    count = np.int32(0)
    for k in range(n):
        root = _root(parent, k)
        if root == k:
            groups[k] = count
            count += np.int32(1)
        else:
            groups[k] = groups[root]
    return groups
