"""How far the track may be off between two key frames: a bound that grows with the way between them."""

from __future__ import annotations

import numpy as np

from mavnav.units import DEG

DRIFT_M, DRIFT_RAD = (0.3, 0.06, 4.0), (5 * DEG, 0.8 * DEG, 30 * DEG)
"""Bounds of the drift: at first, more a metre of way, at most."""

TIE_M = 1e-9
"""A way is no shorter than another by what rounding leaves."""


def drift_bound(way_m: float) -> tuple[float, float]:
    """Return how far a track may be off after so much way, m and rad."""
    (first_m, more_m, most_m), (first_rad, more_rad, most_rad) = DRIFT_M, DRIFT_RAD
    return min(first_m + more_m * way_m, most_m), min(first_rad + more_rad * way_m, most_rad)


class Ways:
    """The shortest way between two points of the track, which leads across places where the track is known to hold."""

    def __init__(self) -> None:
        """Begin with the track alone."""
        self._across: list[tuple[float, float]] = []

    def join(self, a_m: float, b_m: float) -> None:
        """Note that the track holds between two points, named by the way up to them: there is no way between them."""
        self._across.append((a_m, b_m))

    def between(self, a_m: float, b_m: float) -> float:
        """Return the length of the shortest way, m.

        Ways to all joined points are shortened until none is: across a joint, then along the track either way.
        """
        if not self._across:
            return abs(b_m - a_m)
        ends_m = np.array(self._across).ravel()
        order = np.argsort(ends_m)
        other = np.argsort(order)[order ^ 1]
        ends_m = ends_m[order]
        ways_m, before_m = np.abs(ends_m - a_m), np.full(len(ends_m), np.inf)
        while (ways_m < before_m).any():
            before_m, across_m = ways_m, np.minimum(ways_m, ways_m[other])
            ahead_m = np.minimum.accumulate(across_m - ends_m) + ends_m
            back_m = np.minimum.accumulate((across_m + ends_m)[::-1])[::-1] - ends_m
            ways_m = np.minimum(before_m, np.minimum(ahead_m, back_m) + TIE_M)
        return float(min(abs(b_m - a_m), (ways_m + np.abs(ends_m - b_m)).min()))
