"""Do pruned and exhaustive search agree, bit for bit, on every match of recorded and random scans?

    python benchmarks/exactness.py [LOG ...] [--random N]

Every search that a replay of the logs asks for is made both ways on 5x5, 10x10, 20x20 and 40x40 points (twice as many
azimuths), and compared in all that it returns: pose, cost, inliers, evaluations, grids. Random scans in random maps are
compared grid by grid. Exit code 1 at the first difference.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from matches import GRIDS, differences, random_problem

from mavnav import matcher, slam
from mavnav.config_file import load_config
from mavnav.kernels import linesearch
from mavnav.logs import open_log

SAMPLE = Path(__file__).parent.parent / "sample_logs" / "corridor.mcap"
HALF_WINDOWS = ((0.35, 0.35), (0.05, 0.09), (0.017, 0.008), (0.006, 0.0015), (0.002, 0.0002))


class Both:
    """Stands for the module of the search: searches both ways and compares."""

    def __init__(self) -> None:
        self.matches = 0
        self.spent_s = {True: 0.0, False: 0.0}

    def search(self, points: Any, start: Any, grid: Any, *rest: Any) -> Any:
        found = {}
        for pruned in (True, False):
            began_s = process_time()
            found[pruned] = linesearch.search(points, start, np.array([*grid[:4], float(pruned)]), *rest)
            self.spent_s[pruned] += process_time() - began_s
        if not np.array_equal(found[True], found[False]):
            sys.exit(f"match {self.matches}: {found[True]} pruned, {found[False]} exhaustive")
        self.matches += 1
        return found[True]


def recorded(path: Path, grid: int) -> int:
    """Replay a log and return the number of matches compared."""
    both = Both()
    matcher.linesearch = both  # type: ignore[assignment]
    config = load_config(None, [], {"grid": f"{grid}x{grid}", "azimuth": 2 * grid, "odom": "off"})
    log = open_log(path, odom="off")
    slam.replay(log.scans, config, log.period_s)
    pruned_s, exhaustive_s = both.spent_s[True], both.spent_s[False]
    print(
        f"{path.name:20} {2 * grid:3} / {grid}x{grid}: {both.matches:5} matches, 0 differences; a match "
        f"{pruned_s / both.matches * 1e3:.2f} ms pruned, {exhaustive_s / both.matches * 1e3:.2f} ms exhaustive, "
        f"{exhaustive_s / pruned_s:.1f} times",
        flush=True,
    )
    return both.matches


def random(count: int) -> int:
    """Compare random problems; return the number of grids compared."""
    for seed in range(count):
        problem = random_problem(seed)
        for half_m, half_rad in HALF_WINDOWS:
            for grid in GRIDS:
                if differ := differences(problem, grid, half_m, half_rad, 0.01 * (seed % 2)):
                    sys.exit(f"random problem {seed}, {grid}x{grid}, {half_m} m: {differ}")
    return count * len(HALF_WINDOWS) * len(GRIDS) * 3


def main() -> None:
    """Compare all that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path, default=[SAMPLE])
    parser.add_argument("--random", type=int, default=20)
    args = parser.parse_args()
    matches = sum(recorded(path, grid) for path in args.logs for grid in GRIDS)
    grids = random(args.random)
    print(f"{matches} matches and {grids} random grids: identical")


if __name__ == "__main__":
    main()
