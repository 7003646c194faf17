"""Connected regions of cells, and groups of points that are linked along their direction (union-find)."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import BOOL_2D, F64_2D, I32_1D, I64_1D, I64_3D, helper, kernel


@helper
def _root(parent: I32_1D, k: int) -> int:
    """Return the first member of the group of a member, and shorten the path to it (union-find)."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@helper
def _union(parent: I32_1D, a: int, b: int) -> int:
    """Merge the regions of two labels and return its first label; -1 is no label."""
    if a < 0 or b < 0:
        return max(a, b)
    a, b = _root(parent, a), _root(parent, b)
    first = min(a, b)
    parent[max(a, b)] = first
    return first


@kernel
def region_sizes(mask: BOOL_2D, diagonal: bool) -> I64_1D:
    """Return the number of cells of each region of a mask (rows, cols), (regions,), in the order of their first cells.

    Cells of a region touch at an edge, or with ``diagonal`` at a corner. Only the labels of two rows are kept, and
    memory is allocated only for regions that exist.
    """
    rows, cols = mask.shape
    parent = np.empty(rows * ((cols + 1) // 2), np.int32)
    sizes = np.empty(len(parent), np.int64)
    above, here = np.full(cols + 2, -1, np.int32), np.full(cols + 2, -1, np.int32)
    labels = 0
    for r in range(rows):
        for c in range(cols):
            here[c + 1] = -1
            if not mask[r, c]:
                continue
            label = _union(parent, here[c], above[c + 1])
            if diagonal:
                label = _union(parent, _union(parent, label, above[c]), above[c + 2])
            if label < 0:
                label = labels
                parent[labels], sizes[labels] = labels, 0
                labels += 1
            here[c + 1] = label
            sizes[label] += 1
        above, here = here, above
    regions = 0
    for label in range(labels):  # a region's first label is the least of its labels
        root = _root(parent, label)
        if root != label:
            sizes[root] += sizes[label]
            sizes[label] = 0
    for label in range(labels):
        if sizes[label]:
            sizes[regions] = sizes[label]
            regions += 1
    return sizes[:regions].copy()


@kernel
def link_groups(
    xy_m: F64_2D, directions: F64_2D, order: I64_1D, spans: I64_3D, reach_m: float, across_m: float, sin_turn: float
) -> I32_1D:
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
