"""Measure the cost of loop closure and of lost scans relative to tracking alone, on a simulated office floor.

    python benchmarks/office.py [--scans N] [--laps N] [--length METRES]

The laser drives several laps of a ring corridor with rooms on its outer side, and visits every third room. The same
scans are tracked without loop closure, with loop closure, and with intervals of scans from another place, after which
the laser is relocalized. Times are CPU times, without the generation of the scans.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import process_time

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav.config.loading import load_config
from mavnav.config.models import Config
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.relocalization import around, everywhere, lowest
from mavnav.slam.methods.robust import Robust
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.tracker import track
from support.synthetic import along, box, polyline, scan_at

SPEC = LaserSpec(-np.pi * 3 / 4, np.pi / 120, 181, 0.1, 12.0)
WIDE_M, DEPTH_M, ROOM_M, DOOR_M, PERIOD_S, SPEED_M_S = 2.0, 12.0, 5.0, 1.0, 0.1, 0.8
FALSE_M, FALSE_RAD = 0.3, np.radians(5.0)
LOST_EVERY, LOST_SCANS = 400, 60
"""Period and length, in scans, of the intervals after the first lap whose scans come from another place."""

ELSEWHERE = polyline((0, 0), (2.2, 0), (3.1, 1.4), (1.2, 2.6), (-0.4, 1.6), closed=True)
"""A room that is not on the map."""


def floor(length_m: float) -> np.ndarray:
    """Return walls (n, 4): a ring corridor, with rooms of two or three boxes along both long sides."""
    rng = np.random.default_rng(0)
    core = WIDE_M, WIDE_M, length_m - WIDE_M, DEPTH_M - WIDE_M
    walls = [polyline((core[0], core[1]), (core[2], core[1]), (core[2], core[3]), (core[0], core[3]), closed=True)]
    walls += [polyline((x, 0.0), (x, DEPTH_M)) for x in (0.0, length_m)]
    for y_m, out in ((0.0, -1.0), (DEPTH_M, 1.0)):
        walls.append(polyline((0.0, y_m + out * 4.0), (length_m, y_m + out * 4.0)))
        for x_m in np.arange(0.0, length_m - 0.1, ROOM_M):
            door_m = x_m + door_of(x_m, out)
            walls += [polyline((x_m, y_m), (x_m, y_m + out * 4.0)), polyline((x_m, y_m), (door_m, y_m))]
            walls.append(polyline((door_m + DOOR_M, y_m), (x_m + ROOM_M, y_m)))
            for _ in range(int(rng.integers(2, 4))):
                at = x_m + rng.uniform(0.5, 4.5), y_m + out * rng.uniform(2.6, 3.8)
                walls.append(box(*at, *rng.uniform(0.3, 1.2, 2), rng.uniform(-0.5, 0.5)))
    walls += [
        box(*at, 0.4, 0.3) for at in zip(rng.uniform(3, length_m - 3, 12), rng.choice((1.9, 10.1), 12), strict=True)
    ]
    return np.vstack(walls)


def door_of(x_m: float, out: float) -> float:
    """Return the offset of the door in its room, m, which differs between rooms."""
    return float(np.random.default_rng([int(x_m), int(out) + 1]).uniform(0.3, 3.6))


def drive(length_m: float, laps: int) -> Trajectory:
    """Return the true poses: laps of the corridor with visits to every third room."""
    ways: list[tuple[float, float]] = [(1.0, 1.0)]
    for lap in range(laps):
        for x_m in np.arange(0.0, length_m - 0.1, ROOM_M)[1 + lap % 3 : -1 : 3]:
            door_m = x_m + door_of(x_m, -1.0) + 0.5 * DOOR_M
            ways += [(door_m, 0.9), (door_m, -1.5), (door_m + 0.1, 0.9)]
        ways += [(length_m - 1.0, 1.0), (length_m - 1.0, DEPTH_M - 1.0), (1.0, DEPTH_M - 1.0), (1.0, 1.0)]
    return along(ways, PERIOD_S, SPEED_M_S, 2.0)


def recorded(walls: np.ndarray, truth: Trajectory) -> list[Scan]:
    """Return a scan from every pose, with range noise of 0.3 %."""
    rng, middle, scans = np.random.default_rng(1), (walls[:, :2] + walls[:, 2:]) / 2, []
    half_m = np.hypot(*(walls[:, :2] - walls[:, 2:]).T) / 2
    for k in range(len(truth)):
        near = walls[np.hypot(*(middle - truth.xyyaw[k, :2]).T) < SPEC.range_max_m + half_m]
        scans.append(scan_at(near, truth[k], SPEC, stamp_ns=int(truth.stamps_ns[k]), noise=0.003, rng=rng))
    return scans


def with_lost_stretches(scans: list[Scan], laps: int) -> list[Scan]:
    """Replace intervals of scans after the first lap by scans of a room that is not on the map."""
    pose = along([(0.8, 0.8), (1.6, 1.4)])[0]
    out = list(scans)
    for first in range((len(scans) // laps // LOST_EVERY + 1) * LOST_EVERY, len(scans) - LOST_EVERY // 2, LOST_EVERY):
        for k in range(first, first + LOST_SCANS):
            out[k] = scan_at(ELSEWHERE, pose, SPEC, stamp_ns=scans[k].stamp_ns, noise=0.003)
    return out


def timed(name: str, scans: list[Scan], reference_s: float = 0.0, **options: str) -> tuple[SlamResult, float]:
    """Run SLAM; print the time per scan, and its ratio to that of the reference."""
    began_s = process_time()
    found = run_slam(lambda: scans, load_config(overrides=options), PERIOD_S)
    spent_s = process_time() - began_s
    ratio = f"  {spent_s / reference_s:5.2f} of the reference" if reference_s else "  the reference"
    loops = f"{len(found.loops.closed)} closures, {found.loops.refused} refused"
    print(
        f"{name:14} {spent_s / len(scans) * 1e3:6.2f} ms a scan{ratio}  {found.tracked_share:.1%} tracked, {loops}",
        flush=True,
    )
    return found, spent_s


def off_m(found: SlamResult, truth: Trajectory) -> np.ndarray:
    """Return the position errors in the frame of the first pose, (n,), m."""
    rows = np.searchsorted(truth.stamps_ns, found.trajectory.stamps_ns)
    true = truth.seen_from(truth[0].inverse()).xyyaw[rows]
    error: np.ndarray = np.hypot(*(found.trajectory.xyyaw - true)[:, :2].T)
    return error


def false_closures(found: SlamResult, truth: Trajectory) -> int:
    """Return the number of loop closures whose relative pose has an error over 0.3 m or 5 deg."""
    rows, false = np.searchsorted(truth.stamps_ns, found.trajectory.stamps_ns), 0
    for loop in found.loops.closed:
        true = truth[int(rows[loop.start])].between(truth[int(rows[loop.end])])
        off_m, off_rad = true.gap(loop.start_T_end)
        false += off_m > FALSE_M or off_rad > FALSE_RAD
    return false


def searches(scans: list[Scan]) -> None:
    """Print the time of the pruned correlative search relative to the exhaustive one, which finds the same minima."""
    method = Robust(Config())
    last = list(track(scans, method, Motion(PERIOD_S)))[-1].match.map_T_laser
    few = method.match_points(scans[-1])[:100]
    regions = {"disc of 2.5 m": around(last, 2.5, np.pi), "drift of 4 m": around(last, 4.0, np.pi / 6)}
    for name, region in (regions | {"whole map": everywhere(method.known)}).items():
        spent_s = []
        for exhaustive in (False, True):
            for _ in range(2):  # the first one computes the bounds
                began_s = process_time()
                found = lowest(few, method.lines, region, 0.15, 6, exhaustive=exhaustive)
                end_s = process_time()
            spent_s.append((end_s - began_s, found))
        (pruned_s, a), (exhaustive_s, b) = spent_s
        poses, same = len(region[0]) * len(region[1]), "the same minima" if a == b else "OTHER MINIMA"
        print(
            f"{name:14} {poses:9} poses  {pruned_s * 1e3:7.1f} ms, {pruned_s / exhaustive_s:.3f} of exhaustive, {same}"
        )


def main() -> None:
    """Simulate the floor, track the scans, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--length", type=float, default=40.0)
    parser.add_argument("--laps", type=int, default=3)
    parser.add_argument("--scans", type=int)
    args = parser.parse_args()
    truth, walls = drive(args.length, args.laps), floor(args.length)
    scans = recorded(walls, truth)[: args.scans]
    print(f"{len(scans)} scans, {truth.length_m:.0f} m")
    run_slam(lambda: scans[:5], Config(), PERIOD_S)
    plain, plain_s = timed("loops off", scans, loop_closure="off")
    looped, _ = timed("loops on", scans, plain_s)
    lost_scans = with_lost_stretches(scans, args.laps)
    run_slam(lambda: with_lost_stretches(scans, 1000)[: LOST_EVERY + 2 * LOST_SCANS], Config(), PERIOD_S)  # kernels
    lost, lost_s = timed("lost stretches", lost_scans, plain_s, loop_closure="off")
    scan_s, n = plain_s / len(scans), len(scans) - len(lost.trajectory)
    print(f"a lost scan costs {(lost_s - scan_s * len(lost.trajectory)) / max(n, 1) / scan_s:.1f} tracked ones")
    print(f"{false_closures(looped, truth)} of the closures are false")
    searches(scans)
    for name, found in (("loops off", plain), ("loops on", looped), ("lost stretches", lost)):
        error_m = off_m(found, truth)
        print(f"{name}: {np.median(error_m) * 1e3:.0f} mm off (median), {error_m.max() * 1e3:.0f} mm at most")


if __name__ == "__main__":
    main()
