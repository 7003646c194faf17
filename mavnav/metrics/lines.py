"""Groups of points of one wall: points with a direction, linked along it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from mavnav.kernels.maps.regions import link_groups

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Line(Struct, frozen=True):
    """A straight line through points: its middle in m, direction in rad (0 to pi), length and spread across in m."""

    x_m: float
    y_m: float
    direction_rad: float
    length_m: float
    spread_m: float


def link(
    xy_m: NDArray[np.float64], direction_rad: NDArray[np.float64], *, reach_m: float, across_m: float, turn_rad: float
) -> NDArray[np.int32]:
    """Return the group number of each point (n,); points (n, 2) are linked along their direction.

    Two points are linked within ``reach_m`` if their directions differ by at most ``turn_rad`` (modulo pi) and neither
    lies more than ``across_m`` off the line through the other.
    """
    if len(xy_m) == 0:
        return np.zeros(0, np.int32)
    col, row = np.floor((xy_m - xy_m.min(axis=0)) / reach_m).astype(np.int64).T
    width = col.max() + 3  # so that no neighbour lies in the row before
    squares = row * width + col
    order = np.argsort(squares, kind="stable")
    below = squares[:, None] + width * np.arange(2)  # a pair in two rows is found from the lower one
    first = np.searchsorted(squares[order], below - 1)
    last = np.searchsorted(squares[order], below + 1, side="right")
    return link_groups(
        np.ascontiguousarray(xy_m),
        np.column_stack((np.cos(direction_rad), np.sin(direction_rad))),
        order,
        np.stack((first, last), axis=2),
        reach_m,
        across_m,
        float(np.sin(turn_rad)),
    )


def members(groups: NDArray[np.int32]) -> list[NDArray[np.intp]]:
    """Return the points of each group, as their numbers; ``groups`` (n,) are those of `link`."""
    order = np.argsort(groups, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(groups[order])) + 1) if len(order) else []


def half_turn(angle_rad: float) -> float:
    """Return a line's direction in [0, pi); a rounding error below 0 becomes 0, not pi."""
    angle_rad %= np.pi
    return angle_rad if angle_rad < np.pi - 1e-9 else 0.0


def fit_line(xy_m: NDArray[np.float64], weight: NDArray[np.float64], along_m: float) -> Line:
    """Fit a line to points (n, 2) by weighted total least squares; ``along_m`` is the length that one point covers."""
    middle = np.average(xy_m, axis=0, weights=weight)
    dx, dy = (xy_m - middle).T
    xx, xy, yy = (float(np.average(v, weights=weight)) for v in (dx * dx, dx * dy, dy * dy))
    angle = float(0.5 * np.arctan2(2.0 * xy, xx - yy))
    u, v = np.cos(angle) * dx + np.sin(angle) * dy, np.cos(angle) * dy - np.sin(angle) * dx
    low, high = float(u.min()), float(u.max())
    centre = middle + 0.5 * (low + high) * np.array([np.cos(angle), np.sin(angle)])
    spread = float(np.sqrt(np.average(v * v, weights=weight)))
    return Line(float(centre[0]), float(centre[1]), half_turn(angle), high - low + along_m, spread)
