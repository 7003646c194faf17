"""How far the track may be off between two key frames: a bound that grows with the way between them."""

from __future__ import annotations

from heapq import heappop, heappush

from mavnav.units import DEG

DRIFT_M, DRIFT_RAD = (0.3, 0.06, 4.0), (5 * DEG, 0.8 * DEG, 30 * DEG)
"""Bounds of the drift: at first, more a metre of way, at most."""


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
        """Return the length of the shortest way (Dijkstra), m."""
        ends = [end for pair in self._across for end in pair]
        best, queue = abs(b_m - a_m), [(abs(end - a_m), k) for k, end in enumerate(ends)]
        queue.sort()
        done: set[int] = set()
        while queue and queue[0][0] < best:
            way_m, k = heappop(queue)
            if k in done:
                continue
            other = k ^ 1
            done |= {k, other}
            best = min(best, way_m + abs(b_m - ends[other]))
            for m, end in enumerate(ends):
                if m not in done:
                    heappush(queue, (way_m + abs(end - ends[other]), m))
        return best
