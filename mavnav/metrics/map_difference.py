"""Changes between two maps: walls that are gone and walls that are new, where the other map saw free space.

A wall cell is a change only if the other map saw the area around it free, with no wall near. So areas unknown to one of
the maps are no change, nor are walls that are displaced a little by an error of the poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import FREE, OCCUPIED, Grid, cell_centres, known_area, occupancy
from mavnav.mapping.tiled_arrays import bands, farther
from mavnav.pose import Pose, transform_points

TOLERANCE_M = 0.15
"""Largest distance to a wall of the other map at which a wall is no change."""

CLEAR_M = 0.06
"""Radius around a change within which all cells are free in the other map."""

LEAST_PASSES = 2
"""Minimum number of beams that crossed a free cell: one may be a false reading."""

JOIN_M = 0.1
"""Largest distance between cells of one change."""

LEAST_M2, LEAST_LENGTH_M = 0.004, 0.12
"""Minimum area and length of a change: smaller ones may be noise of the laser."""

MOVED_M, ALIKE = 1.5, 2.0
"""Largest distance, and largest ratio of lengths, between a wall that is gone and the new one of a moved object."""

Kind = Literal["gone", "new"]


class Change(Struct, frozen=True):
    """A connected part of walls that is gone or new: its centre in the frame of the first map, m.

    ``m2`` is the area of its cells, ``length_m`` the diagonal of its bounding box. ``moved_with`` is the number of the
    other change if an object seems to have moved.
    """

    kind: Kind
    x_m: float
    y_m: float
    m2: float
    length_m: float
    moved_with: int | None = None


class Difference(Struct, frozen=True):
    """The changes, the largest first, the centres of their cells (n, 2) in the first map's frame, m, and totals.

    ``compared_m2`` is the area that both maps know. ``same_share`` is the share of the walls of both maps that the
    other map has too, among those around which that is known.
    """

    changes: tuple[Change, ...]
    gone_xy_m: NDArray[np.float64]
    new_xy_m: NDArray[np.float64]
    compared_m2: float
    same_share: float

    def m2(self, kind: Kind) -> float:
        """Return the area of all changes of a kind."""
        return sum(change.m2 for change in self.changes if change.kind == kind)


class View:
    """Masks of a map, each (rows, cols): walls, cells near a wall, cells with free surroundings, and known cells."""

    def __init__(self, grid: Grid) -> None:
        """Compute the masks from the counts of a grid."""
        self.grid = known_area(grid)
        cells = occupancy(self.grid)
        self.walls = cells == OCCUPIED
        self.known = cells >= FREE
        free = (cells == FREE) & (self.grid.passes >= LEAST_PASSES)
        self.near = ~farther(~self.walls, TOLERANCE_M, grid.cell_m, outside=True)
        self.clear = farther(free, CLEAR_M, grid.cell_m, outside=False)

    def middles(self, cells: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the centres of the cells of a mask (rows, cols), in row-major order, (n, 2) in m."""
        return cell_centres(self.grid, *np.nonzero(cells))

    def at(self, cells: NDArray[np.bool_], xy_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return the values of a mask (rows, cols) at points (n, 2), m; False outside."""
        col, row = np.floor((xy_m - self.grid.origin_xy_m) / self.grid.cell_m).astype(np.int64).T
        rows, cols = cells.shape
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        return np.asarray(cells[np.where(inside, row, 0), np.where(inside, col, 0)] & inside)


def difference(a: View, b: View, a_T_b: Pose) -> Difference:
    """Return the difference of two maps; ``a_T_b`` is the pose of the second one's frame in the first one's."""
    gone, gone_xy_m = _changes("gone", a, b, a_T_b.inverse(), Pose())
    new, new_xy_m = _changes("new", b, a, a_T_b, a_T_b)
    changes = sorted([*gone, *new], key=lambda change: -change.m2)
    sides = (a, transform_points(a_T_b, b.middles(b.walls))), (b, transform_points(a_T_b.inverse(), a.middles(a.walls)))
    same = sum(np.count_nonzero(view.at(view.near & view.known, walls_xy_m)) for view, walls_xy_m in sides)
    unlike = sum(np.count_nonzero(view.at(view.clear & ~view.near, walls_xy_m)) for view, walls_xy_m in sides)
    return Difference(
        changes=tuple(pair_changes(changes)),
        gone_xy_m=gone_xy_m,
        new_xy_m=new_xy_m,
        compared_m2=_known_to_both(a, b, a_T_b.inverse()) * a.grid.cell_m**2,
        same_share=float(same / max(same + unlike, 1)),
    )


def _known_to_both(a: View, b: View, b_T_a: Pose) -> int:
    """Return the number of cells of the first map that the second one knows too."""
    cells = 0
    for _, _, band in bands(a.known.shape):
        xy_m = cell_centres(a.grid, *(np.argwhere(a.known[band]) + np.array([band.start, 0])).T)
        cells += int(np.count_nonzero(b.at(b.known, transform_points(b_T_a, xy_m))))
    return cells


def _changes(
    kind: Kind, having: View, other: View, other_T_having: Pose, a_T_having: Pose
) -> tuple[list[Change], NDArray[np.float64]]:
    """Return the walls that only one map has, and the centres of their cells (n, 2)."""
    from scipy.ndimage import binary_dilation, find_objects, label  # noqa: PLC0415  takes 0.1 s to load

    cells, cell_m = having.walls.copy(), having.grid.cell_m
    there_m = transform_points(other_T_having, having.middles(cells))
    cells[cells] = other.at(other.clear & ~other.near, there_m)
    reach = max(1, round(JOIN_M / cell_m / 2))
    labels, _ = label(binary_dilation(cells, np.ones((3, 3), bool), iterations=reach), np.ones((3, 3), int))
    changes: list[Change] = []
    places = [np.zeros((0, 2))]
    for number, box in enumerate(find_objects(labels), start=1):
        row, col = np.nonzero(cells[box] & (labels[box] == number))
        xy_m = transform_points(a_T_having, cell_centres(having.grid, row + box[0].start, col + box[1].start))
        (x_m, y_m), spans_m = xy_m.mean(axis=0).tolist(), np.ptp(xy_m, axis=0) + cell_m
        change = Change(kind, x_m, y_m, len(xy_m) * cell_m**2, float(np.hypot(*spans_m)))
        if change.m2 >= LEAST_M2 and change.length_m >= LEAST_LENGTH_M:
            changes.append(change)
            places.append(xy_m)
    return changes, np.concatenate(places)


def pair_changes(changes: Sequence[Change]) -> list[Change]:
    """Pair walls that are gone with new ones, as objects that moved: the nearest first, each change once."""
    from scipy.spatial import KDTree  # noqa: PLC0415  takes 0.1 s to load

    pairs = []
    for pair in KDTree([(each.x_m, each.y_m) for each in changes]).query_pairs(MOVED_M) if changes else ():
        i, j = sorted(pair, key=lambda number: changes[number].kind)
        a, b = changes[i], changes[j]
        if a.kind != b.kind and 1 / ALIKE <= a.length_m / b.length_m <= ALIKE:
            pairs.append((float(np.hypot(a.x_m - b.x_m, a.y_m - b.y_m)), i, j))
    partners: dict[int, int] = {}
    for _, i, j in sorted(pairs):
        if not partners.keys() & {i, j}:
            partners |= {i: j, j: i}
    return [replace(change, moved_with=partners.get(number)) for number, change in enumerate(changes)]
