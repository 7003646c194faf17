"""What pictures show: a rectangle of the map in metres, at most so many cells of it; and the colours of them all."""

from __future__ import annotations

from functools import partial
from math import ceil, pi, prod
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import Grid
from mavnav.mapping.tiled_arrays import where
from mavnav.outputs.run import Walls
from mavnav.pose import Pose, transform_points

DPI: Final = 150
LEAST_IN, MOST_IN = 3.0, 11.0
"""A long narrow map is shown larger, until its shorter side has the one or its longer side the other, in inches."""

STRAY_SHARE: Final = 5e-4
FAR_SHARE: Final = 0.01
WORTH_IT: Final = 0.4
"""Share of the area below which a picture shows the well seen part of a map alone."""

ARC_STEP_RAD: Final = pi / 90.0
START_BLUE, GOAL_RED, POSE_MAGENTA, TRUE_ORANGE = "#0033ff", "#e00000", "#d6009a", "#ff6a00"
MEASURED_BLUE = "#0077bb"
DOUBT_RED = "#d62728"
INK, MUTED, FREE_GREY, WALL_GREY, PATH_GREY = "#222222", "#666666", "#eef1f4", "#b9bec4", "#8a929a"


class Viewport(Struct, frozen=True):
    """A rectangle in metres, of the map turned about its origin by ``turn_rad``: what a picture shows."""

    x0_m: float
    x1_m: float
    y0_m: float
    y1_m: float
    turn_rad: float = 0.0

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        return self.x1_m - self.x0_m, self.y1_m - self.y0_m

    def ends_in_map(self) -> NDArray[np.float64]:
        """Return the least and the greatest x and y in the map, (2, 2)."""
        corners = np.array([(x, y) for x in (self.x0_m, self.x1_m) for y in (self.y0_m, self.y1_m)])
        xy_m = transform_points(Pose(yaw_rad=-self.turn_rad), corners)
        return np.array((xy_m.min(axis=0), xy_m.max(axis=0)))

    def cells_of(self, grid: Grid) -> tuple[int, int, int, int]:
        """Return the first and the end column, and the first and the end row, of the grid's cells inside.

        At least one of each: of a grid beside the window, the nearest.
        """
        (x0, y0), (rows, cols), ends_m = grid.origin_xy_m, grid.hits.shape, self.ends_in_map()
        ends = [(x - x0, cols) for x in ends_m[:, 0]] + [(y - y0, rows) for y in ends_m[:, 1]]
        a, b, c, d = (min(max(int(distance / grid.cell_m), 0), count) for distance, count in ends)
        a, c = min(a, cols - 1), min(c, rows - 1)
        return a, max(b, a + 1), c, max(d, c + 1)

    def size_pixels(self, longest_in: float, least_in: float = 0.0) -> tuple[int, int]:
        """Return width and height in pixels that show the rectangle undistorted.

        The shorter side has ``least_in``, if the longer one has no more than `MOST_IN` by that.
        """
        width, height = self.size_m
        scale = max(longest_in / max(width, height), min(least_in / min(width, height), MOST_IN / max(width, height)))
        return round(width * scale * DPI), round(height * scale * DPI)

    def widen(self, least_share: float) -> Viewport:
        """Return it with the shorter side at least this share of the longer, about the same middle."""
        width, height = self.size_m
        dx, dy = (max(0.0, least_share * max(width, height) - side) / 2 for side in (width, height))
        return Viewport(self.x0_m - dx, self.x1_m + dx, self.y0_m - dy, self.y1_m + dy, self.turn_rad)


def window_of(grid: Grid, xy_m: NDArray[np.float64], turn_rad: float = 0.0) -> Viewport:
    """Frame the hit cells and the points ``xy_m`` (n, 2) of a map, turned about its origin, with a margin.

    On each side the outermost `STRAY_SHARE` of the cells may fall outside: single far returns through a window
    would otherwise shrink the map to a spot. If that saves much, so may the half of the cells that was hit least, and
    `FAR_SHARE` of the others.
    """
    hit = where(grid.hits, lambda hits: hits > 0)
    counts = grid.hits[tuple(hit.T)]
    seen = hit[counts >= np.median(counts)] if len(hit) else hit
    whole, near = (
        _window(grid, cells, share, xy_m, turn_rad) for cells, share in ((hit, STRAY_SHARE), (seen, FAR_SHARE))
    )
    return near if prod(near.size_m) < WORTH_IT * prod(whole.size_m) else whole


def _window(grid: Grid, cells: NDArray[np.intp], share: float, xy_m: NDArray[np.float64], turn_rad: float) -> Viewport:
    """Frame points and cells (n, 2) as row and column, of which a share may fall outside on each side."""
    turn = partial(transform_points, Pose(yaw_rad=turn_rad))
    corners = [turn(xy_m if len(xy_m) or len(cells) else np.array([grid.origin_xy_m]))]
    if len(cells):
        at = turn(cells[:, ::-1] + 0.5 + np.array(grid.origin_xy_m) / grid.cell_m)
        ends = np.quantile(at, (share, 1.0 - share), axis=0, method="nearest")
        ends[0], ends[1] = ends[0] - 0.5, ends[1] + 0.5  # whole cells
        corners.append(ends * grid.cell_m)
    return window_around(np.vstack(corners), 5 * grid.cell_m, turn_rad)


def window_around(xy_m: NDArray[np.float64], least_margin_m: float, turn_rad: float = 0.0) -> Viewport:
    """Frame points (n, 2) of the turned map, with a margin."""
    (x0, y0), (x1, y1) = xy_m.min(axis=0), xy_m.max(axis=0)
    margin = max(0.04 * max(x1 - x0, y1 - y0), least_margin_m)
    return Viewport(float(x0 - margin), float(x1 + margin), float(y0 - margin), float(y1 + margin), turn_rad)


def wall_lines(walls: Walls) -> list[NDArray[np.float64]]:
    """Return the true walls as lines (k, 2) in the map frame, m; arcs in steps of `ARC_STEP_RAD` at most."""
    return [*walls.segments_map.reshape(-1, 2, 2), *map(_arc_line, walls.arcs_map)]


def _arc_line(arc: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, radius, start, sweep = arc.tolist()
    angles = start + np.linspace(0.0, sweep, max(2, ceil(abs(sweep) / ARC_STEP_RAD) + 1))
    return np.column_stack((x + radius * np.cos(angles), y + radius * np.sin(angles)))
