"""Compare speed and accuracy of mavnav with other scan matchers on the same scans.

    make bench-peers LOGS="LOG ..."        # or, if kiss-icp and small-gicp are installed:
    python benchmarks/peers.py [LOG ...] [--rounds N]

Loop: all run in this process, in turn, on one core; mavnav's time includes reading the log, the others get points in
memory. Whole process: ``mavnav replay`` and the recipes of ``docs/recipes``, from log to trajectory, with imports,
and the memory of the largest.
Accuracy is mavnav's revisit metric of the poses: the distance between scans of one place at different times. The peers
match 3D points, all of one height; their settings are those of the recipes.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from mavnav.config.loading import load_config
from mavnav.ground_truth.tables import read_trajectory
from mavnav.logs import open_log
from mavnav.metrics.journey import Journey, placed_scans
from mavnav.metrics.revisits import Pairs, long_pairs, revisits, short_pairs
from mavnav.pipelines.trajectory_source import Program, run_program
from mavnav.pose import Trajectory
from mavnav.slam.methods.registry import load_kernels
from mavnav.slam.pipeline import run_slam

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from mavnav.logs import Log
    from mavnav.metrics.revisits import Revisits

    Clouds = list[NDArray[np.float64]]

SAMPLE = Path(__file__).parent.parent / "sample_logs" / "corridor.mcap"


def clouds_of(log: Log) -> tuple[NDArray[np.int64], Clouds]:
    """Return the stamps of a log and the end points (n, 3) of its scans, laser frame, m."""
    scans = list(log.scans())
    found = []
    for scan in scans:
        ends = scan.ranges_m[:, None] * scan.spec.directions
        ends = ends[np.isfinite(scan.ranges_m)]
        found.append(np.column_stack((ends, np.zeros(len(ends)))))
    return np.array([scan.stamp_ns for scan in scans]), found


def with_kiss_icp(clouds: Clouds) -> Clouds:
    """Return the pose of each cloud, (4, 4)."""
    from kiss_icp.config import KISSConfig  # noqa: PLC0415  installed by make bench-peers
    from kiss_icp.kiss_icp import KissICP  # noqa: PLC0415

    config = KISSConfig()
    config.data.max_range, config.data.min_range, config.data.deskew = 30.0, 0.0, False
    config.mapping.voxel_size = 0.1
    odometry, poses = KissICP(config), []
    for cloud in clouds:
        odometry.register_frame(cloud, np.zeros(len(cloud)))
        poses.append(np.array(odometry.last_pose))
    return poses


def with_small_gicp(clouds: Clouds) -> Clouds:
    """Return the pose of each cloud, (4, 4), matched to Gaussian voxels of all scans, at first at constant velocity."""
    import small_gicp  # noqa: PLC0415

    model, poses = small_gicp.GaussianVoxelMap(0.2), [np.eye(4), np.eye(4)]
    model.set_lru(horizon=10**6, clear_cycle=10**6)
    for k, points in enumerate(clouds):
        cloud, _ = small_gicp.preprocess_points(points, 0.02, num_neighbors=8, num_threads=1)
        if k:
            guess = poses[-1] @ np.linalg.inv(poses[-2]) @ poses[-1]
            match = small_gicp.align(model, cloud, guess, max_correspondence_distance=0.5, num_threads=1)
            poses.append(planar(match.T_target_source))
        model.insert(cloud, poses[-1])
    return poses[1:]


def planar(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a pose, (4, 4), without roll, pitch and height."""
    yaw = np.arctan2(pose[1, 0], pose[0, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0.0, pose[0, 3]], [sin, cos, 0.0, pose[1, 3]], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])


RECIPES = Path(__file__).parent.parent / "docs" / "recipes"
PROGRAMS = (
    Program(
        "mavnav", f"{sys.executable} -m mavnav replay {{log}} --odom off --outputs trajectory -q --force -o {{out}}.run"
    ),
    Program("kiss-icp", f"{sys.executable} {RECIPES / 'kiss_icp_poses.py'} {{log}} {{out}}"),
    Program("small_gicp", f"{sys.executable} {RECIPES / 'small_gicp_poses.py'} {{log}} {{out}}"),
)
"""Whole processes, from a log to a trajectory."""


def whole_process(path: Path, rounds: int) -> None:
    """Print what the programs take for a log, with start, imports and reading, the accuracy of their poses beside."""
    log = open_log(path, odom="off")
    with TemporaryDirectory() as folder:
        for program in PROGRAMS:
            out = Path(folder, f"{program.name}.tum")
            costs = [run_program(program, path, out, 3600.0) for _ in range(rounds)]
            poses = Path(f"{out}.run", "trajectory.tum") if program.name == "mavnav" else out
            if not poses.is_file():
                sys.stdout.write(f"  {program.name:<11} failed: {costs[-1].problem}\n")
                continue
            cpu_s, memory_mb = (float(np.median([getattr(cost, name) for cost in costs])) for name in MEASURED)
            path_of = read_trajectory(poses)
            if len(path_of) == len(log.stamps_ns):  # stamps in a text file may be rounded
                path_of = Trajectory(log.stamps_ns, path_of.xyyaw)
            there = measured(log, path_of)
            sys.stdout.write(
                f"  {program.name:<11}{cpu_s:>7.2f} CPU-s, {memory_mb:>4.0f} MB, revisits {there.nn_l_mm:.2f} mm, "
                f"neighbours {there.nn_s_mm:.2f} mm\n"
            )


MEASURED = ("cpu_s", "peak_memory_mb")

PEERS: dict[str, Callable[[Clouds], Clouds]] = {"kiss-icp": with_kiss_icp, "small_gicp": with_small_gicp}


def measured(log: Log, map_T_laser: Trajectory) -> Revisits:
    """Return the revisit metric of poses."""
    pairs = Pairs(short_pairs(map_T_laser.stamps_ns), long_pairs(map_T_laser))
    scans = placed_scans(Journey(map_T_laser, log.scans, 1.0), np.unique(np.concatenate(pairs)))
    return revisits(map_T_laser, pairs, scans)


def compare(path: Path, rounds: int) -> None:
    """Print a table of one log."""
    log, config = open_log(path, odom="off"), load_config()
    load_kernels(config, lambda *_: None)
    stamps, clouds = clouds_of(log)
    spent: dict[str, list[float]] = {}
    tracks: dict[str, Trajectory] = {}
    for _ in range(rounds):
        began_s = process_time()
        tracks["mavnav"] = run_slam(log.scans, config, log.period_s).trajectory
        spent.setdefault("mavnav", []).append(process_time() - began_s)
        for name, peer in PEERS.items():
            began_s = process_time()
            poses = peer(clouds)
            spent.setdefault(name, []).append(process_time() - began_s)
            tracks[name] = Trajectory(
                stamps, np.array([(p[0, 3], p[1, 3], np.arctan2(p[1, 0], p[0, 0])) for p in poses])
            )
    sys.stdout.write(f"{path.name}: {len(clouds)} scans, median of {rounds} rounds\n")
    for name, seconds in spent.items():
        took_s, found = float(np.median(seconds)), measured(log, tracks[name])
        ratio = took_s / float(np.median(spent["mavnav"]))
        sys.stdout.write(
            f"  {name:<11}{len(clouds) / took_s:>7.0f} scans/CPU-s, time {ratio:>5.2f} of mavnav's, "
            f"revisits {found.nn_l_mm:.2f} mm, neighbours {found.nn_s_mm:.2f} mm\n"
        )


def main() -> None:
    """Compare mavnav with the installed peers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="*", type=Path, default=[SAMPLE])
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    try:
        import kiss_icp  # noqa: F401, PLC0415
        import small_gicp  # noqa: F401, PLC0415
    except ImportError as error:
        sys.exit(f"{error}; 'make bench-peers' installs kiss-icp and small-gicp with pip, which needs a network once")
    for path in options.logs:
        compare(path, options.rounds)
        sys.stdout.write("  whole process:\n")
        whole_process(path, options.rounds)


if __name__ == "__main__":
    main()
