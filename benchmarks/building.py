"""Measure the drift in a simulated building of 25 x 18 m: four rounds with left turns, 270 deg, 50 m, no odometry.

    python benchmarks/building.py [--seeds N ...] [--angle SCALE]

A corridor, furnished by boxes, leads round a core. The track is judged in the frame of its first pose, with and without
loop closure. Beams may be farther apart than the scans say, as of a laser whose angle increment is off.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav.config.loading import load_config
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from support.synthetic import along, box, cast, polyline

SPEC = LaserSpec(-np.radians(135.0), np.radians(0.5), 541, 0.1, 50.0)
PERIOD_S, SPEED_M_S, ROUNDS, NOISE_M = 0.1, 1.2, 4, 0.01
CORNERS = [(21.5, 3.5), (21.5, 14.5), (3.5, 14.5), (3.5, 3.5)]


def building(rng: np.random.Generator) -> np.ndarray:
    """Return walls (n, 4): outer walls, a core, and boxes beside the way."""
    walls = [polyline((0, 0), (25, 0), (25, 18), (0, 18), closed=True), box(12.5, 9.0, 11.0, 8.0)]
    for _ in range(14):
        x_m, y_m, wide_m, deep_m = (*rng.uniform((0.5, 0.5), (24.5, 17.5)), *rng.uniform(0.3, 1.2, 2))
        if not (2.2 < x_m < 22.8 and 2.2 < y_m < 15.8):
            walls.append(box(x_m, y_m, wide_m, deep_m, rng.uniform(-0.5, 0.5)))
    return np.vstack(walls)


def recorded(truth: Trajectory, angle_scale: float, seed: int) -> list[Scan]:
    """Return a scan from every pose, with range noise."""
    rng, scans = np.random.default_rng(seed), []
    walls = building(rng)
    for k, (x_m, y_m, yaw_rad) in enumerate(truth.xyyaw.tolist()):
        ranges_m = cast(walls, (x_m, y_m), angle_scale * SPEC.angles_rad + yaw_rad)
        noisy_m = ranges_m + NOISE_M * rng.standard_normal(SPEC.beams)
        scans.append(Scan(int(truth.stamps_ns[k]), noisy_m, SPEC))
    return scans


def describe(result: SlamResult, truth: Trajectory) -> str:
    """Write how far positions and headings are off, the drift of the heading per round, and the loops."""
    rows = np.searchsorted(truth.stamps_ns, result.trajectory.stamps_ns)
    error = result.trajectory.xyyaw - truth.seen_from(truth[0].inverse()).xyyaw[rows]
    off_m, off_deg = np.hypot(*error[:, :2].T), np.degrees((error[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    turns = np.unwrap(truth.xyyaw[rows, 2]) / (2.0 * np.pi)
    per_round = float(np.polyfit(turns - turns[0], off_deg, 1)[0])
    return (
        f"heading {per_round:+.3f} deg a round, at most {np.abs(off_deg).max():.2f} deg off; position "
        f"{np.median(off_m) * 1e3:.0f} mm off (median), {off_m.max() * 1e3:.0f} mm at most; "
        f"{len(result.loops.closed)} closures, {result.loops.refused} refused, "
        f"track {'as it was' if result.loops.map_T_laser is None else 'corrected'}"
    )


def main() -> None:
    """Simulate the rounds, track the scans, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--angle", type=float, default=1.0)
    args = parser.parse_args()
    truth = along([(3.5, 3.5), *ROUNDS * CORNERS], PERIOD_S, SPEED_M_S)
    for seed in args.seeds:
        scans = recorded(truth, args.angle, seed)
        for loops in ("off", "auto"):
            result = run_slam(lambda scans=scans: scans, load_config(overrides={"loop_closure": loops}), PERIOD_S)
            print(f"seed {seed}, loops {loops}: {describe(result, truth)}", flush=True)


if __name__ == "__main__":
    main()
