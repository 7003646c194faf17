"""How far is a calibration off, and how often does the truth lie inside its 95 % intervals?

    python benchmarks/calibrate.py [--first 1000] [--logs 40] [--quality good|fair|poor]
    python benchmarks/calibrate.py --log LOG ...

Logs of simulated robots are written and calibrated: mountings, time offsets of up to 0.3 s, wheel scales of 0.9 to 1.1,
lasers upside down, at rest or moving during a sweep, beams fired forwards or backwards, wheels that slip, stamps that
jitter, rooms of 5 to 10 m. With ``--log`` the results, processor time and peak memory of real logs are printed instead.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

import mavnav
from mavnav.pose import Pose

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.robots import Robot, written
from support.synthetic import DEG

QUALITIES = {"good": 0.5, "fair": 1.0, "poor": 2.0}
"""Odometry -> noise of its steps, as multiples of 10 mm and 1 deg for the root of a meter."""

UNITS = np.array((1.0, 1.0, 1 / DEG, 1.0, 1.0, 1.0, 1 / DEG))


def robot_of(seed: int, quality: str) -> Robot:
    """Draw a robot."""
    rng = np.random.default_rng([seed, 2])
    mounting = Pose(rng.uniform(-0.2, 0.3), rng.uniform(-0.15, 0.15), rng.uniform(-np.pi, np.pi))
    moving = bool(rng.random() < 0.5)
    return Robot(
        mounting,
        offset_s=rng.uniform(-0.3, 0.3),
        distance_scale=rng.uniform(0.9, 1.1),
        turn_scale=rng.uniform(0.9, 1.1),
        veer_rad_m=rng.uniform(-2, 2) * DEG,
        mirrored=bool(rng.random() < 0.3),
        moving=moving,
        backwards=moving and bool(rng.random() < 0.4),
        drive=int(rng.integers(3)),
        speed_m_s=rng.uniform(0.25, 0.6),
        turn_rad_s=rng.uniform(0.5, 1.2),
        odom_period_s=float(rng.choice((0.02, 0.05, 0.1))),
        length_noise=0.01 * QUALITIES[quality],
        yaw_noise=DEG * QUALITIES[quality],
        slips=0.002 * QUALITIES[quality],
        jitter_s=0.01,
        size=rng.uniform(0.8, 1.6),
    )


def calibrated(seed: int, quality: str, folder: Path) -> tuple[Robot, dict[str, Any]]:
    """Write the log of a robot, and calibrate it."""
    robot = robot_of(seed, quality)
    return robot, mavnav.calibrate(written(robot, seed, folder / "robot.mcap"))


def simulated(first: int, logs: int, quality: str) -> None:
    """Print errors, intervals and what was refused."""
    errors, widths = np.full((logs, 7), np.nan), np.full((logs, 7), np.nan)
    sides: Counter[str] = Counter()
    names: list[str] = []
    began_s = process_time()
    with TemporaryDirectory() as folder:
        for k in range(logs):
            robot, found = calibrated(first + k, quality, Path(folder))
            rows = found["quantities"]
            names = [row["name"] for row in rows]
            given = np.array([np.nan if row["refused"] else row["value"] for row in rows])
            errors[k] = given - robot.truth * UNITS
            errors[k, 2] = (errors[k, 2] + 180) % 360 - 180
            widths[k] = [np.nan if row["refused"] else row["ci95"] for row in rows]
            sides[f"upside down {robot.mirrored}, found {found['upside_down']['value']}"] += 1
            order = robot.backwards if robot.moving else "not shown"
            sides[f"beams reversed {order}, found {found['beams_reversed']['value']}"] += 1
            outside = [n for n, e, w in zip(names, errors[k], widths[k], strict=True) if abs(e) > w]
            print(f"{first + k}: {', '.join(outside) or 'all inside'} {found['refused'] or ''}", flush=True)
    print(f"{'':16}{'median error':>14}{'rms error':>12}{'worst':>10}{'median +-':>12}{'inside':>12}{'refused':>9}")
    for n, e, w in zip(names, errors.T, widths.T, strict=True):
        known = np.isfinite(e)
        off, inside = np.abs(e[known]), int((np.abs(e[known]) <= w[known]).sum())
        figures = f"{np.median(off):14.4f}{np.sqrt(np.mean(off**2)):12.4f}{off.max():10.4f}{np.median(w[known]):12.4f}"
        print(f"{n:16}{figures}{inside:>6} of {known.sum():<3}{logs - known.sum():>8}")
    known = np.isfinite(errors)
    print(f"inside in all: {(np.abs(errors[known]) <= widths[known]).mean():.1%} of {known.sum()}")
    print(*(f"{text}: {number}" for text, number in sorted(sides.items())), sep="\n")
    print(f"{(process_time() - began_s) / logs:.1f} CPU-s a log, with its simulation")


def recorded(log: str) -> None:
    """Print the result of a log, and what it cost in a process of its own."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "mavnav", "calibrate", log, "--json", "-q"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"{log}: exit code {done.returncode}, {cpu_s:.2f} CPU-s, peak of all so far {after.ru_maxrss / 1024:.0f} MB")
    print(done.stderr, end="")
    for row in json.loads(done.stdout or '{"quantities": []}')["quantities"]:
        text = row["refused"] or f"{row['value']} +- {row['ci95']} {row['unit']}, log {row['in_log']}: {row['agrees']}"
        print(f"  {row['name']:16}{text}")


def main() -> None:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--quality", choices=QUALITIES, default="fair")
    parser.add_argument("--log", nargs="*", default=[])
    given = parser.parse_args()
    for log in given.log:
        recorded(log)
    if not given.log:
        simulated(given.first, given.logs, given.quality)


if __name__ == "__main__":
    main()
