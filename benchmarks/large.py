"""Measure time and memory for a log of 1 GB and 100,000 scans, and how the time per scan grows with the map.

    python benchmarks/large.py LOG.mcap OUTPUT_DIRECTORY [--scans N] [--plot FILE.png]

A laser drives once through the aisles of a warehouse of 200 m x 200 m. The log is generated if it does not exist: 720
beams with intensities, and a second topic of random bytes. It is replayed with all outputs. The CPU time per scan is
printed by blocks of scans, and the peak memory.
"""

from __future__ import annotations

import argparse
import resource
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numba import njit

from mavnav.config.loading import load_config
from mavnav.logs.messages import cdr, definitions
from mavnav.pipelines.replay import ReplayRequest, replay_log
from mavnav.pose import Pose
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.methods.registry import load_kernels

SPEC = LaserSpec(-np.pi, 2 * np.pi / 720, 720, 0.1, 12.0)
LENGTH_M, AISLES, PITCH_M, WIDE_M, BLOCK = 200.0, 10, 20.0, 3.0, 2000
BLOB_BYTES, WHOLE = 4300, 100_000


def warehouse() -> np.ndarray:
    """Return walls (n, 4): aisles along x, connected at alternate ends, with racks of varying depth."""
    rng, walls = np.random.default_rng(0), []
    for k in range(AISLES):
        y = k * PITCH_M
        for side in (-1, 1):
            opens_right, opens_left = (side > 0) == (k % 2 == 0), (side > 0) == (k % 2 == 1)
            x0 = WIDE_M if opens_left and 0 <= k + side < AISLES else 0.0
            x1 = LENGTH_M - WIDE_M if opens_right and 0 <= k + side < AISLES else LENGTH_M
            x, face = x0, y + side * WIDE_M / 2
            while x < x1:
                end, deep = min(x + rng.uniform(0.8, 2.5), x1), y + side * (WIDE_M / 2 + rng.uniform(0.05, 0.6))
                walls += [(x, deep, end, deep), (end, face, end, deep), (x, face, x, deep)]
                x = end
        walls += [(0.0, y - 2.2, 0.0, y + 2.2), (LENGTH_M, y - 2.2, LENGTH_M, y + 2.2)]
        if k + 1 < AISLES:
            edge = LENGTH_M if k % 2 == 0 else 0.0
            inner = LENGTH_M - WIDE_M if k % 2 == 0 else WIDE_M
            walls += [(x, y + WIDE_M / 2, x, y + PITCH_M - WIDE_M / 2) for x in (edge, inner)]
            for j, dy in enumerate(np.arange(3.0, PITCH_M - 3.0, 2.0)):  # posts along the connections
                out = edge + (-0.3 if k % 2 == 0 else 0.3) * (1 + j % 2)
                walls += [(edge, y + dy, out, y + dy), (out, y + dy, out, y + dy + 0.3)]
    return np.array(walls)


def drive(scans: int) -> np.ndarray:
    """Return the first ``scans`` of `WHOLE` poses, (scans, 3), along all aisles with rounded corners."""
    corners, half = [], WIDE_M / 2
    for k in range(AISLES):
        ends = (half, LENGTH_M - half) if k % 2 == 0 else (LENGTH_M - half, half)
        corners += [(x, k * PITCH_M) for x in ends]
    xy = np.array(corners)
    along = np.concatenate(([0.0], np.hypot(*np.diff(xy, axis=0).T).cumsum()))
    fine = np.arange(0.0, along[-1], 0.01)
    way = np.column_stack([np.interp(fine, along, part) for part in xy.T])
    kernel = np.ones(120) / 120
    way = np.column_stack([np.convolve(np.pad(part, 60, "edge"), kernel, "same")[60:-60] for part in way.T])
    yaw = np.unwrap(np.arctan2(*np.gradient(way, axis=0).T[::-1]))
    yaw = np.convolve(np.pad(yaw, 60, "edge"), kernel, "same")[60:-60]
    rows = np.linspace(0, len(fine) - 1, WHOLE)[:scans]
    return np.column_stack([np.interp(rows, np.arange(len(fine)), part) for part in (*way.T, yaw)])


@njit(cache=True)
def _cast(walls: np.ndarray, pose: np.ndarray, angles: np.ndarray) -> np.ndarray:
    out = np.full(len(angles), np.inf)
    for i in range(len(angles)):
        dx, dy = np.cos(angles[i] + pose[2]), np.sin(angles[i] + pose[2])
        for k in range(len(walls)):
            ax, ay = walls[k, 0] - pose[0], walls[k, 1] - pose[1]
            ex, ey = walls[k, 2] - walls[k, 0], walls[k, 3] - walls[k, 1]
            denominator = dx * ey - dy * ex
            if denominator != 0.0:
                r, u = (ax * ey - ay * ex) / denominator, (ax * dy - ay * dx) / denominator
                if 0.0 < r < out[i] and 0.0 <= u <= 1.0:
                    out[i] = r
    return out


def make(path: Path, scans: int) -> None:
    """Write the log."""
    walls, rng, write = warehouse(), np.random.default_rng(1), cdr.scans("laser")
    middle, period_ns = (walls[:, :2] + walls[:, 2:]) / 2, 100_000_000
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="benchmark")
        laser = writer.register_schema(definitions.SCAN, "ros2msg", definitions.definition(definitions.SCAN).encode())
        blob = writer.register_schema("std_msgs/msg/UInt8MultiArray", "ros2msg", b"uint8[] data")
        channels = [writer.register_channel(t, "cdr", s) for t, s in (("/scan", laser), ("/blob", blob))]
        for k, pose in enumerate(drive(scans)):
            near = np.ascontiguousarray(walls[np.hypot(*(middle - pose[:2]).T) < SPEC.range_max_m + 12.0])
            ranges = _cast(near, pose, SPEC.angles_rad) + rng.normal(0.0, 0.005, SPEC.beams)
            ranges[~(ranges < SPEC.range_max_m)] = np.nan
            stamp_ns = (k + 1) * period_ns
            intensities = np.int32(SPEC.beams).tobytes() + np.full(SPEC.beams, 100.0, np.float32).tobytes()
            writer.add_message(channels[0], stamp_ns, write(Scan(stamp_ns, ranges, SPEC))[:-4] + intensities, stamp_ns)
            writer.add_message(channels[1], stamp_ns, rng.bytes(BLOB_BYTES), stamp_ns)
        writer.finish()


def main() -> None:
    """Generate the log, replay it, and print times and memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--scans", type=int, default=WHOLE)
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    if not args.log.exists():
        with ProcessPoolExecutor(1) as other:  # so that the memory of the generation does not count
            other.submit(make, args.log, args.scans).result()
    seen: dict[str, list[tuple[int, float]]] = {}

    def progress(phase: str, done: int, _: int | None) -> None:
        if phase in ("track", "final pass") and done % BLOCK == 0:
            seen.setdefault(phase, [(0, began_s)]).append((done, process_time()))
            if done % (5 * BLOCK) == 0:
                print(
                    f"{phase:10} {done:7} scans  {_ms(seen[phase])[-1]:.2f} ms a scan  {_peak_mb():.0f} MB", flush=True
                )

    began_s = process_time()
    config = load_config(None, [], {"odom": "off"})
    load_kernels(config, lambda *_: None)
    run, _ = replay_log(ReplayRequest(args.log, args.output, config, force=True), progress, 0.0)
    rows, cols = run.known.hits.shape
    end = run.slam.trajectory[len(run.slam.trajectory) - 1]
    truth = Pose(*drive(args.scans)[0].tolist()).between(Pose(*drive(args.scans)[-1].tolist()))
    size_m = run.known.cell_m * np.array((cols, rows))
    print(f"{args.log.stat().st_size / 1e9:.2f} GB, {len(run.slam.steps)} scans, {len(run.slam.trajectory)} tracked")
    print(f"map {size_m[0]:.0f} m x {size_m[1]:.0f} m, end {end.between(truth).distance_m:.2f} m off")
    print(f"peak {_peak_mb():.0f} MB, {process_time() - began_s:.0f} s of processor time")
    if args.plot:
        plot(seen, args.plot)


def _ms(times: list[tuple[int, float]]) -> np.ndarray:
    done, spent_s = np.array(times).T
    return np.diff(spent_s) / np.diff(done) * 1e3


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def plot(seen: dict[str, list[tuple[int, float]]], path: Path) -> None:
    """Plot the CPU time per scan over the scans."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    fig: Any = Figure(figsize=(7, 3), layout="constrained")
    axes = fig.subplots()
    for phase, times in seen.items():
        axes.plot([done for done, _ in times[2:]], _ms(times)[1:], label=phase)
    axes.set(xlabel="scans", ylabel="processor time of a scan [ms]", ylim=(0, None))
    axes.legend(loc="center right", bbox_to_anchor=(1.0, 0.35))
    fig.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
