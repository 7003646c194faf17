"""Connected regions of cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels.machine.jit import helper, kernel
from mavnav.kernels.machine.types import BOOL_2D, boolean, int64

if TYPE_CHECKING:
    from numpy.typing import NDArray


@helper
def _root(parent: NDArray[np.int32], label: int) -> int:
    """Return the first label of the region of a label, and shorten the path to it."""
    while parent[label] != label:
        parent[label] = parent[parent[label]]
        label = parent[label]
    return label


@helper
def _union(parent: NDArray[np.int32], a: int, b: int) -> int:
    """Merge the regions of two labels and return its first label; -1 is no label."""
    if a < 0 or b < 0:
        return max(a, b)
    a, b = _root(parent, a), _root(parent, b)
    first = min(a, b)
    parent[max(a, b)] = first
    return first


@kernel(int64[::1](BOOL_2D, boolean))
def region_sizes(mask: NDArray[np.bool_], diagonal: bool) -> NDArray[np.int64]:
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
