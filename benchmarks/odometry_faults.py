"""A corridor of 40 m with good odometry and one fault at a time: how long the path becomes.

Along a plain corridor the walls show no motion: the path is as long as the odometry says. Doors 0.12 m deep show it
a little, cupboards show it. ``python benchmarks/odometry_faults.py`` prints a table: the fault, the length of the path
as a share of the true one, the largest error, the doubt, and what was said.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav.config.models import Config
from mavnav.logs.odometry_chains import without_jumps
from mavnav.pose import Pose, Trajectory, correct_path
from mavnav.slam.pipeline import run_slam
from mavnav.units import DEG
from support.synthetic import Recording, corridor, past_cupboards

MS, RATE_NS = 10**6, 50_000_000
FRAME = Pose(4.0, -1.0, 0.6)


def odometry_of(truth: Trajectory, seed: int = 0) -> Trajectory:
    """Return odometry of 20 Hz with errors of 1 % of each step."""
    rng, stamps_ns = np.random.default_rng(seed), np.arange(truth.stamps_ns[0], truth.stamps_ns[-1], RATE_NS)
    true = [truth.at(int(stamp_ns), 10**9) for stamp_ns in stamps_ns]
    poses = [Pose()]
    for a, b in itertools.pairwise(true):
        step = a.between(b)
        x, y, yaw = 1.0 + 0.01 * rng.standard_normal(3)
        poses.append(poses[-1] @ Pose(step.x_m * x, step.y_m * y, step.yaw_rad * yaw))
    return Trajectory.of(stamps_ns.tolist(), poses)


def moved(path: Trajectory, rows: slice | np.ndarray, by: Pose) -> Trajectory:
    """Return a path of which some poses are seen in another frame."""
    xyyaw = path.xyyaw.copy()
    xyyaw[rows] = Trajectory(path.stamps_ns[rows], path.xyyaw[rows]).seen_from(by).xyyaw
    return Trajectory(path.stamps_ns, xyyaw)


def without(path: Trajectory, rows: slice) -> Trajectory:
    """Return a path without some poses."""
    kept = np.delete(np.arange(len(path)), rows)
    return Trajectory(path.stamps_ns[kept], path.xyyaw[kept])


def turning(path: Trajectory, angle_rad: float) -> Trajectory:
    """Return a path whose heading jumps half way: the rest is driven in another direction."""
    half = len(path) // 2
    return moved(path, slice(half, None), path[half] @ Pose(0.0, 0.0, angle_rad) @ path[half].inverse())


def jittering(path: Trajectory) -> Trajectory:
    """Return a path with stamps up to 40 ms early or late."""
    jitter = np.random.default_rng(2).integers(-40 * MS, 40 * MS, len(path))
    return Trajectory(np.sort(path.stamps_ns + jitter), path.xyyaw)


def slipping(path: Trajectory, factor: float, rows: slice) -> Trajectory:
    """Return a path of which some steps are longer or shorter than they were."""
    poses = [path[0]]
    for k in range(len(path) - 1):
        x, y, yaw = path[k].between(path[k + 1])
        share = factor if rows.start <= k < rows.stop else 1.0
        poses.append(poses[-1] @ Pose(x * share, y * share, yaw))
    return Trajectory.of(path.stamps_ns.tolist(), poses)


FAULTS = {
    "none": lambda path: path,
    "reset to zero": lambda path: moved(path, slice(150, None), path[150].inverse()),
    "reset near the start": lambda path: moved(path, slice(45, None), path[45].inverse()),
    "jump of 0.6 m": lambda path: moved(path, slice(200, None), Pose(0.6)),
    "jump of 5 m sideways": lambda path: moved(path, slice(200, None), Pose(0.0, 5.0)),
    "heading jumps by 60 deg": lambda path: turning(path, 60 * DEG),
    "heading jumps by 10 deg": lambda path: turning(path, 10 * DEG),
    "one wrong pose": lambda path: moved(path, slice(220, 221), Pose(3.0)),
    "two publishers": lambda path: moved(path, np.arange(0, len(path), 2), FRAME),
    "two publishers, one rare": lambda path: moved(path, np.arange(0, len(path), 5), FRAME),
    "jump there and back after 2 s": lambda path: moved(path, slice(200, 240), Pose(1.0, 0.3, 0.1)),
    "restart after a gap of 0.4 s": lambda path: moved(without(path, slice(250, 257)), slice(250, None), FRAME),
    "gap of 2 s": lambda path: without(path, slice(250, 290)),
    "0.3 s late": lambda path: correct_path(path, 300 * MS),
    "stamps jitter by 40 ms": jittering,
    "centimeters": lambda path: Trajectory(path.stamps_ns, path.xyyaw * (100.0, 100.0, 1.0)),
    "wheels slip for 0.5 s": lambda path: slipping(path, 3.0, slice(200, 210)),
    "stall for 0.4 s": lambda path: slipping(path, 0.0, slice(200, 208)),
    "heading drifts by 1 deg/s": lambda path: correct_path(path, 0, veer_rad_m=1.1 * DEG),
}
"""What is wrong with the odometry."""

ERRING = {
    "wheels slip for 1 s": lambda path: slipping(path, 3.0, slice(200, 220)),
    "wheels stand still for 10 s": lambda path: slipping(path, 0.0, slice(200, 400)),
    "distances times 1.4 after 15 s": lambda path: slipping(path, 1.4, slice(300, len(path))),
}
"""What is wrong with the odometry past cupboards; all but the last also where bare walls follow."""

SCALES = (0.5, 0.7, 0.9, 1.0, 1.1, 1.3, 2.0)
"""Factors on the distances of the odometry past doors."""


def replayed(drive: Recording, recorded: Trajectory) -> tuple[float, float, float, tuple[str, ...]]:
    """Return path as a share of the true one, largest error, m, doubt, and warnings."""
    odometry, left_out = without_jumps(recorded)
    run = run_slam(lambda: drive.scans, Config(), 0.1, odometry)
    true = drive.map_T_laser.xyyaw[np.isin(drive.map_T_laser.stamps_ns, run.trajectory.stamps_ns)]
    off_m = float(np.hypot(*(run.trajectory.xyyaw - true)[:, :2].T).max())
    said = ((left_out.text,) if left_out else ()) + run.warnings
    share = run.trajectory.travelled_m / drive.map_T_laser.travelled_m
    return share, off_m, run.doubt.probability if run.doubt else np.nan, said


def main() -> None:
    """Print the table."""
    plain, shallow, deep = corridor(), corridor(np.arange(1.5, 39.0, 2.7)), past_cupboards()
    print(f"path of {plain.map_T_laser.travelled_m:.1f} m, {len(plain.scans)} scans")
    good, past_doors = odometry_of(plain.world_T_laser), odometry_of(shallow.world_T_laser)
    runs = [(fault, plain, make(good)) for fault, make in FAULTS.items()]
    runs += [(f"distances times {k}, doors", shallow, correct_path(past_doors, 0, k)) for k in SCALES]
    runs += [(f"{fault}, cupboards", deep, make(odometry_of(deep.world_T_laser))) for fault, make in ERRING.items()]
    bare = past_cupboards(bare_m=24.0)
    along_bare = odometry_of(bare.world_T_laser)
    runs += [(f"{fault}, cupboards, bare walls", bare, make(along_bare)) for fault, make in list(ERRING.items())[:-1]]
    for fault, drive, recorded in runs:
        share, off_m, doubt, said = replayed(drive, recorded)
        words = said[0][:70] if said else ""
        print(f"{fault:52} {100 * share:6.1f} %  {off_m:6.2f} m  doubt {doubt:.2f}  {words}", flush=True)


if __name__ == "__main__":
    main()
