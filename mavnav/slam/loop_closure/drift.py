"""Bound of the drift of the track between two key frames, which increases with the path between them."""

from __future__ import annotations

import numpy as np

from mavnav.units import DEG

DRIFT_M, DRIFT_RAD = (0.3, 0.06, 4.0), (5 * DEG, 0.8 * DEG, 30 * DEG)
"""Drift bound: constant, increase per metre of path, and maximum."""

TIE_M = 1e-9
"""Tolerance for rounding errors of path lengths."""


def drift_bound(path_m: float) -> tuple[float, float]:
    """Return the drift bound after a path of this length, m and rad."""
    (first_m, more_m, most_m), (first_rad, more_rad, most_rad) = DRIFT_M, DRIFT_RAD
    return min(first_m + more_m * path_m, most_m), min(first_rad + more_rad * path_m, most_rad)


class Paths:
    """Shortest paths between points of the track; closures that confirm the track shorten them."""

    def __init__(self) -> None:
        """Start with the track alone."""
        self._across: list[tuple[float, float]] = []

    def join(self, a_m: float, b_m: float) -> None:
        """Connect two points, given by their path lengths, at no distance: a closure shows no drift between them."""
        self._across.append((a_m, b_m))

    def between(self, a_m: float, b_m: float) -> float:
        """Return the length of the shortest path, m.

        The paths to all connected points are relaxed until none gets shorter: across a connection, then along the track
        forwards and backwards.
        """
        if not self._across:
            return abs(b_m - a_m)
        ends_m = np.array(self._across).ravel()
        order = np.argsort(ends_m)
        other = np.argsort(order)[order ^ 1]
        ends_m = ends_m[order]
        paths_m, before_m = np.abs(ends_m - a_m), np.full(len(ends_m), np.inf)
        while (paths_m < before_m).any():
            before_m, across_m = paths_m, np.minimum(paths_m, paths_m[other])
            ahead_m = np.minimum.accumulate(across_m - ends_m) + ends_m
            back_m = np.minimum.accumulate((across_m + ends_m)[::-1])[::-1] - ends_m
            paths_m = np.minimum(before_m, np.minimum(ahead_m, back_m) + TIE_M)
        return float(min(abs(b_m - a_m), (paths_m + np.abs(ends_m - b_m)).min()))
