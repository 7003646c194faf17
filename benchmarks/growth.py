"""Check that the time per scan stays constant while the map grows: a drive along a hall of 200 m, by blocks of scans.

python benchmarks/growth.py [LENGTH_M]
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from time import process_time

import numpy as np

from mavnav.slam.pipeline import run_slam

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav.config.models import Config
from mavnav.pose import Pose
from mavnav.scan import LaserSpec, Scan
from support.synthetic import box, polyline, scan_at

SPEC = LaserSpec(-np.pi, np.pi / 180, 360, 0.1, 12.0)
STEP_M, BLOCK, NEAR_M = 0.1, 200, 15.0


def hall(length_m: float) -> np.ndarray:
    """Return the walls (n, 4) of a hall with a box about every 3 m, alternately left and right."""
    rng = np.random.default_rng(0)
    boxes = [
        box(x + rng.uniform(-1, 1), 1.0 + 4.0 * (k % 2), *rng.uniform(0.3, 1.2, 2), rng.uniform(-0.5, 0.5))
        for k, x in enumerate(np.arange(3.0, length_m, 3.0))
    ]
    return np.vstack((polyline((0, 0), (length_m, 0), (length_m, 6), (0, 6), closed=True), *boxes))


def main() -> None:
    """Track, and print the CPU time of each block without the generation of its scans."""
    length_m = float(sys.argv[1]) if len(sys.argv) > 1 else 200.0
    walls, generation_s, rng = hall(length_m), 0.0, np.random.default_rng(1)

    def scans() -> Iterator[Scan]:
        nonlocal generation_s
        for k in range(int((length_m - 4.0) / STEP_M)):
            began_s, x = process_time(), 2.0 + k * STEP_M
            near = walls[
                (np.minimum(walls[:, 0], walls[:, 2]) < x + NEAR_M)
                & (np.maximum(walls[:, 0], walls[:, 2]) > x - NEAR_M)
            ]
            scan = scan_at(near, Pose(x, 3.0, 0.0), SPEC, stamp_ns=(k + 1) * 100_000_000, noise=0.01, rng=rng)
            generation_s += process_time() - began_s
            yield scan

    def print_block(phase: str, done: int) -> None:
        nonlocal spent_s
        if done % BLOCK == 0:
            now_s = process_time() - generation_s
            memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f"{phase:10} {done:6} scans  {(now_s - spent_s) / BLOCK * 1e3:.2f} ms a scan  {memory_mb:.0f} MB",
                flush=True,
            )
            spent_s = now_s

    spent_s = process_time()
    config = Config()
    found = run_slam(scans, config, 0.1, on_step=print_block)
    end = found.trajectory.xyyaw[-1]
    print(f"end at {end[0]:.2f} m of {int((length_m - 4.0) / STEP_M - 1) * STEP_M:.2f} m, map {found.grid.hits.shape}")


if __name__ == "__main__":
    main()
