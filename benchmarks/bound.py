"""Measure what limits the speed of the search: ns per point of a full evaluation, of its lookups, of its arithmetic.

    python benchmarks/bound.py [LOG]

For each point, an evaluation reads its position (16 bytes), the index of the cell's line (4) and the line (40), and
does about 20 operations. Both parts are timed separately, on the same points of a finished map, in one run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
from numba import njit

from mavnav.config.loading import load_config
from mavnav.kernels.line_search.cost import Lines, cost_sum
from mavnav.kernels.maps.layout import NEAR
from mavnav.logs import open_log
from mavnav.pose import transform_points
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.methods.registry import make_method
from mavnav.slam.methods.robust import Robust
from mavnav.slam.track import Track

SAMPLE = Path(__file__).parent.parent / "sample_logs" / "corridor.mcap"
REPEATS = 300


@njit(error_model="numpy")
def look_ups(slots: np.ndarray, lines: np.ndarray) -> float:
    total = 0.0
    for k in range(len(slots)):
        line = np.uint64(slots[k])
        total += lines[line, 0] + lines[line, 1] + lines[line, 2] + lines[line, 3] + lines[line, 4]
    return total


@njit(error_model="numpy")
def arithmetic(x: np.ndarray, y: np.ndarray, line: np.ndarray, geometry: np.ndarray) -> float:
    total, inverse = 0.0, 1.0 / geometry[2]
    for k in range(len(x)):
        fx, fy = (x[k] - geometry[0]) * inverse, (y[k] - geometry[1]) * inverse
        dx, dy = x[k] - line[0], y[k] - line[1]
        d2 = dx * dx * line[2] + 2.0 * dx * dy * line[3] + dy * dy * line[4]
        total += min(d2, 0.0225) + 0.0 * (int(fx) + int(fy))
    return total


@njit(error_model="numpy")
def evaluation(x: np.ndarray, y: np.ndarray, nearest: np.ndarray, lines: np.ndarray, geometry: np.ndarray) -> float:
    line_map = Lines(nearest, lines, geometry[0], geometry[1], geometry[2])
    return cost_sum(x, y, 0.0, 0.0, 0.0225, line_map, np.inf)


def nanoseconds(work: Callable[[], object], points: int) -> float:
    """Return the minimum time of ten runs, in ns per point."""
    work()
    best = np.inf
    for _ in range(10):
        began_s = process_time()
        for _ in range(REPEATS):
            work()
        best = min(best, process_time() - began_s)
    return best / REPEATS / points * 1e9


def main() -> None:
    """Time the parts on the last scan of a log."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else SAMPLE
    log, config = open_log(path, odom="off"), load_config(None, [], {"odom": "off"})
    track = Track(log.scans, config, Motion(log.period_s), make_method(config)).over(log.scans())
    method, steps = track.method, track.steps
    assert isinstance(method, Robust)
    lines, scan = method.lines, list(log.scans())[-1]
    xy = np.tile(transform_points(steps[-1].match.map_T_laser, method.match_points(scan)), (8, 1))
    x, y = np.ascontiguousarray(xy.T)
    cells = np.floor((xy - lines.geometry[:2]) / lines.cell_m).astype(int)
    slots = lines.nearest[cells[:, 1], cells[:, 0]] // NEAR
    arrays = (lines.nearest, lines.lines, lines.geometry)
    whole = nanoseconds(lambda: evaluation(x, y, *arrays), len(x))
    loads = nanoseconds(lambda: look_ups(slots, lines.lines), len(x))
    sums = nanoseconds(lambda: arithmetic(x, y, lines.lines[slots[0]], lines.geometry), len(x))
    print(f"{path.name}: {whole:.1f} ns a point; look-ups alone {loads:.1f}, arithmetic alone {sums:.1f}")
    print(f"60 bytes a point: {60 / whole:.1f} GB/s")


if __name__ == "__main__":
    main()
