"""Check that pruned and exhaustive search agree bit for bit on every match of recorded and random scans.

    python benchmarks/exactness.py [LOG ...] [--method robust|paper] [--random N]

Every search in a replay of the logs is run both ways on 5x5, 10x10, 20x20 and 40x40 points (twice as many yaw samples),
and all results are compared: pose, cost, inliers or beams, evaluations, grids. Random scans in random maps are compared
level by level (robust) or by whole searches (paper). Exit code 1 at the first difference.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from mavnav.slam.pipeline import run_slam

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav.config.loading import load_config
from mavnav.kernels import polar_search as polar_kernels
from mavnav.kernels.line_search import search as line_search
from mavnav.kernels.polar_search import search as polar_search
from mavnav.logs import open_log
from mavnav.slam.matching import scan_matching
from support.matches import GRIDS, LASERS, differences, polar_problem, random_problem

SAMPLE = Path(__file__).parent.parent / "sample_logs" / "corridor.mcap"
HALF_WINDOWS = ((0.35, 0.35), (0.05, 0.09), (0.017, 0.008), (0.006, 0.0015), (0.002, 0.0002))

READINGS = ((1.0, 0.1, 0.0, 0.0), (0.7, 0.06, 1.0, 1.0))
"""Variants of the paper's method: occlusion threshold fixed or shrinking, rotation about the centroid or the laser,
convergence of both or either.
"""


class Both:
    """Replacement for the module of a search, which runs both searches and compares them."""

    def __init__(self, kernel: Any) -> None:
        self.kernel, self.matches = kernel, 0
        self.spent_s = {True: 0.0, False: 0.0}

    def search(self, one: Any, other: Any, grid: Any, *rest: Any) -> Any:
        found = {}
        for pruned in (True, False):
            began_s = process_time()
            found[pruned] = self.kernel.search(one, other, np.array([*grid[:4], float(pruned)]), *rest)
            self.spent_s[pruned] += process_time() - began_s
        if not np.array_equal(found[True], found[False]):
            sys.exit(f"match {self.matches}: {found[True]} pruned, {found[False]} exhaustive")
        self.matches += 1
        return found[True]


def recorded(path: Path, method: str, grid: int) -> int:
    """Replay a log and return the number of matches compared."""
    both = Both({"robust": line_search, "paper": polar_search}[method])
    if method == "robust":
        scan_matching.line_search = both  # type: ignore[assignment]
    else:
        polar_kernels.search = both  # type: ignore[assignment]
    config = load_config(None, [], {"method": method, "grid": f"{grid}x{grid}", "azimuth": 2 * grid, "odom": "off"})
    log = open_log(path, odom="off")
    run_slam(log.scans, config, log.period_s)
    pruned_s, exhaustive_s = both.spent_s[True], both.spent_s[False]
    print(
        f"{path.name:20} {2 * grid:3} / {grid}x{grid}: {both.matches:5} matches, 0 differences; a match "
        f"{pruned_s / both.matches * 1e3:.2f} ms pruned, {exhaustive_s / both.matches * 1e3:.2f} ms exhaustive, "
        f"{exhaustive_s / pruned_s:.1f} times",
        flush=True,
    )
    return both.matches


def random_grids(count: int) -> int:
    """Compare the grids of random problems of the robust method; return the number of grids."""
    for seed in range(count):
        problem = random_problem(seed)
        for half_m, half_rad in HALF_WINDOWS:
            for grid in GRIDS:
                if differ := differences(problem, grid, half_m, half_rad, 0.01 * (seed % 2)):
                    sys.exit(f"random problem {seed}, {grid}x{grid}, {half_m} m: {differ}")
    return count * len(HALF_WINDOWS) * len(GRIDS) * 2


def random_searches(count: int) -> int:
    """Compare random searches of the paper's method; return the number of searches."""
    both = Both(polar_search)
    for seed in range(count):
        for spec in LASERS:
            virtual, points, limits, _ = polar_problem(seed, spec)
            for grid in GRIDS:
                half_m, half_rad = HALF_WINDOWS[seed % len(HALF_WINDOWS)]
                schedule = np.array([half_m, half_rad, 0.3, 1.0, 1e-5, 1e-4, np.inf, *READINGS[seed % len(READINGS)]])
                both.search(virtual, points, np.array([2.0 * grid, grid, grid, 2, 1.0]), schedule, limits)
    return both.matches


def main() -> None:
    """Run the comparisons of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path, default=[SAMPLE])
    parser.add_argument("--method", choices=("robust", "paper"), default="robust")
    parser.add_argument("--random", type=int, default=20)
    args = parser.parse_args()
    matches = sum(recorded(path, args.method, grid) for path in args.logs for grid in GRIDS)
    if args.method == "robust":
        print(f"{matches} matches and {random_grids(args.random)} random grids: identical")
    else:
        print(f"{matches} matches and {random_searches(args.random)} random ones: identical")


if __name__ == "__main__":
    main()
