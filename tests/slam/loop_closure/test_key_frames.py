"""The bound of the drift: it grows with the shortest way that leads across places where the track holds."""

from __future__ import annotations

import heapq

import numpy as np
import pytest

from mavnav.slam.loop_closure.key_frames import Paths


def shortest(joints: list[tuple[float, float]], a_m: float, b_m: float) -> float:
    """Dijkstra over all pairs of ends."""
    ends = [a_m, b_m, *(end for joint in joints for end in joint)]
    ways, queue = dict.fromkeys(range(len(ends)), np.inf), [(0.0, 0)]
    while queue:
        path_m, k = heapq.heappop(queue)
        if path_m >= ways[k]:
            continue
        ways[k] = path_m
        for m, end in enumerate(ends):
            joined = k >= 2 and m >= 2 and k // 2 == m // 2
            heapq.heappush(queue, (path_m + (0.0 if joined else abs(end - ends[k])), m))
    return ways[1]


@pytest.mark.parametrize("seed", range(20))
def test_the_shortest_way_is_dijkstras(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints = [(float(a), float(b)) for a, b in rng.uniform(0, 100, (rng.integers(0, 8), 2))]
    ways = Paths()
    for joint in joints:
        ways.join(*joint)
    a_m, b_m = rng.uniform(0, 100, 2).tolist()
    assert ways.between(a_m, b_m) == pytest.approx(shortest(joints, a_m, b_m), abs=1e-6)
    assert ways.between(b_m, a_m) == pytest.approx(ways.between(a_m, b_m), abs=1e-6)
