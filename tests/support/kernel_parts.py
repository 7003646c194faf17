"""Helpers of kernels made callable from Python for tests; they take arrays instead of named tuples.

``at`` (5,) is the middle of a grid: x, y (m), yaw (rad), and where the centroid was expected, x, y (m). ``window`` (5,)
is half-windows (m, rad), the cost of a squared metre, the truncation (m2), and 1 to prune.
"""

from __future__ import annotations

from mavnav.kernels.line_search.azimuth import turn_sums as _turn_sums
from mavnav.kernels.line_search.azimuth import turns_of
from mavnav.kernels.line_search.cost import Lines, Middle, SearchWindow
from mavnav.kernels.line_search.cost import cost_sum as _cost_sum
from mavnav.kernels.line_search.plane import shift_sums as _shift_sums
from mavnav.kernels.line_search.quadratic_form import quadratic_form as _quadratic_form
from mavnav.kernels.line_search.search import on_mapped_area as _on_mapped_area
from mavnav.kernels.machine.jit import F64_1D, F64_2D, I64_1D, U32_2D, Out, helper, kernel
from mavnav.kernels.scans.points import voxel_means as _voxel_means


@helper
def _middle(at):
    x, y, yaw, expected_x, expected_y = at
    return Middle(x, y, yaw, expected_x, expected_y)


@helper
def _window(window):
    half_m, half_rad, prior, truncate_m2, prune = window
    return SearchWindow(half_m, half_rad, prior, truncate_m2, prune > 0.0)


@helper
def _lines(nearest, lines, geometry):
    origin_x_m, origin_y_m, cell_m, _, _, _ = geometry
    return Lines(nearest, lines, origin_x_m, origin_y_m, cell_m)


@kernel
def voxel_means(points: F64_2D, voxel_m: float, out: Out[F64_2D]) -> int:
    return _voxel_means(points, voxel_m, out)


@kernel
def cost_sum(
    x: F64_1D, y: F64_1D, to_x: float, to_y: float, truncate_m2: float, nearest: U32_2D, lines: F64_2D, geometry: F64_1D
) -> float:
    return _cost_sum(x, y, to_x, to_y, truncate_m2, _lines(nearest, lines, geometry), float("inf"))


@kernel
def turn_sums(
    points: F64_2D, at: F64_1D, window: F64_1D, sums: Out[F64_1D], nearest: U32_2D, lines: F64_2D, geometry: F64_1D
) -> None:
    turns = turns_of(_window(window).half_rad, len(sums))
    _turn_sums(points, _middle(at), _window(window), turns, sums, _lines(nearest, lines, geometry))


@kernel
def shift_sums(
    points: F64_2D, at: F64_1D, window: F64_1D, sums: Out[F64_2D], nearest: U32_2D, lines: F64_2D, geometry: F64_1D
) -> None:
    _shift_sums(points, _middle(at), _window(window), sums, _lines(nearest, lines, geometry))


@kernel
def quadratic_form(
    points: F64_2D,
    at: F64_1D,
    window: F64_1D,
    form: Out[F64_2D],
    loose: Out[I64_1D],
    nearest: U32_2D,
    lines: F64_2D,
    geometry: F64_1D,
) -> int:
    return _quadratic_form(points, _middle(at), _window(window), form, loose, _lines(nearest, lines, geometry))


@kernel
def on_mapped_area(
    points: F64_2D, at: F64_1D, closeness: float, known_points: float, nearest: U32_2D, lines: F64_2D, geometry: F64_1D
) -> F64_2D:
    return _on_mapped_area(points, _middle(at), closeness, known_points, _lines(nearest, lines, geometry))
