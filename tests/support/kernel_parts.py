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
from mavnav.kernels.machine.jit import helper, kernel
from mavnav.kernels.machine.types import F64_1D, F64_2D, U32_2D, float64, int64, void
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


@kernel(int64(F64_2D, float64, float64[:, ::1]))
def voxel_means(points, voxel_m, out):
    return _voxel_means(points, voxel_m, out)


@kernel(float64(F64_1D, F64_1D, float64, float64, float64, U32_2D, F64_2D, F64_1D))
def cost_sum(x, y, to_x, to_y, truncate_m2, nearest, lines, geometry):
    return _cost_sum(x, y, to_x, to_y, truncate_m2, _lines(nearest, lines, geometry), float("inf"))


@kernel(void(F64_2D, F64_1D, F64_1D, float64[::1], U32_2D, F64_2D, F64_1D))
def turn_sums(points, at, window, sums, nearest, lines, geometry):
    turns = turns_of(_window(window).half_rad, len(sums))
    _turn_sums(points, _middle(at), _window(window), turns, sums, _lines(nearest, lines, geometry))


@kernel(void(F64_2D, F64_1D, F64_1D, float64[:, ::1], U32_2D, F64_2D, F64_1D))
def shift_sums(points, at, window, sums, nearest, lines, geometry):
    _shift_sums(points, _middle(at), _window(window), sums, _lines(nearest, lines, geometry))


@kernel(int64(F64_2D, F64_1D, F64_1D, float64[:, ::1], int64[::1], U32_2D, F64_2D, F64_1D))
def quadratic_form(points, at, window, form, loose, nearest, lines, geometry):
    return _quadratic_form(points, _middle(at), _window(window), form, loose, _lines(nearest, lines, geometry))


@kernel(float64[:, ::1](F64_2D, F64_1D, float64, float64, U32_2D, F64_2D, F64_1D))
def on_mapped_area(points, at, closeness, known_points, nearest, lines, geometry):
    return _on_mapped_area(points, _middle(at), closeness, known_points, _lines(nearest, lines, geometry))
