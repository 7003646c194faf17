"""Measure walls of known thickness, and how the result depends on the duration of the recording.

    python benchmarks/thickness.py rest | rounds | noise | smear | angles | logs LOG [...]

``rest``: a laser at rest, without and with walking people, for 5 to 120 s. ``rounds``: the same room for one round, 6
rounds and 20 minutes. ``noise`` and ``smear``: poses with known errors. ``angles``: known walls at 40 angles. ``logs``:
the first 5, 10, 15, ... seconds of recordings, mapped by the default method.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from pathlib import Path

import numpy as np
from msgspec.structs import replace

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.mapping.occupancy_grid import Grid, GridBuilder, measured_area
from mavnav.metrics.journey import Journey
from mavnav.metrics.map_quality import measure_map
from mavnav.metrics.wall_spread import wall_report
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.scan import Scan
from mavnav.slam.pipeline import run_slam
from support.synthetic import TOUR, URG_04LX, along, box, cast, furnished_rooms, record, room, scan_at
from support.walls import planted_wall, walking_people

FURNITURE = np.vstack((room(), box(1.9, 2.0, 0.7, 0.5, 0.3), box(4.2, 1.9, 0.4, 0.6, -0.2)))
AT = Pose(2.9, 1.0, 1.2)
HEAD = f"{'':34s}{'median':>8s}{'p95':>8s}{'length':>8s}{'share':>7s}{'paper p95':>10s}{'published p95':>14s}"


def show(name: str, grid: Grid, scans: list[Scan], poses: Trajectory, tracked_share: float = 1.0) -> None:
    found = measure_map(grid, Journey(poses, lambda: iter(scans), tracked_share))
    walls = wall_report(found.sections, found.published, found.cuts, grid.cell_m)
    s, paper, published = walls.spread, walls.paper_cells.p95 * grid.cell_m * 1e3, walls.published_map.p95_mm
    verdict = "" if found.quality.meaningful else f"  not meaningful: {'; '.join(found.quality.why)}"
    print(
        f"{name:34s}{s.median_mm:8.1f}{s.p95_mm:8.1f}{s.length_m:8.1f}{s.measured_share:7.2f}"
        f"{paper:10.1f}{published:14.1f}{verdict}",
        flush=True,
    )


def show_slam(name: str, scans: list[Scan], period_s: float = 0.1) -> None:
    outcome = run_slam(lambda: iter(scans), Config(), period_s)
    show(name, measured_area(outcome.grid), scans, outcome.trajectory, outcome.tracked_share)


def at_rest(people: int, seconds: int) -> list[Scan]:
    rng, bearings = np.random.default_rng(people), URG_04LX.angles_rad + AT.yaw_rad
    return [
        Scan(k * 100_000_000, cast(np.vstack((FURNITURE, outline)), (AT.x_m, AT.y_m), bearings) * fuzz, URG_04LX)
        for k, outline in enumerate(walking_people(rng, people, seconds * 10))
        for fuzz in [1.0 + 0.01 * rng.standard_normal(URG_04LX.beams)]
    ]


def rest() -> None:
    for people in (0, 2):
        scans = at_rest(people, 120)
        for seconds in (5, 15, 30, 60, 120):
            show_slam(f"at rest, {people} people, {seconds} s", scans[: seconds * 10])


def rounds() -> None:
    way, rng = along([(1.0, 0.8), (5.0, 0.8), (5.0, 3.2), (3.0, 3.3), (1.0, 3.2), (1.0, 0.8)]), np.random.default_rng(0)
    poses = [Pose(*way.xyyaw[k % len(way)]) for k in range(12_000)]
    at_once = replace(URG_04LX, time_increment_s=0.0)  # these scans are taken at rest
    scans = [scan_at(FURNITURE, p, at_once, stamp_ns=k * 100_000_000, noise=0.01, rng=rng) for k, p in enumerate(poses)]
    for name, count in (("one round", len(way)), ("6 rounds", 6 * len(way)), ("20 minutes", len(scans))):
        show_slam(f"{name}, {count} scans", scans[:count])


def planted(errors: dict[str, np.ndarray], scans: list[Scan], poses: Trajectory) -> None:
    for name, by_m in errors.items():
        wrong = Trajectory(poses.stamps_ns.copy(), poses.xyyaw + np.column_stack((by_m, np.zeros(len(poses)))))
        builder = GridBuilder(0.02)
        for pose, scan in zip(wrong, scans, strict=True):
            builder.insert(pose, transform_points(pose, scan.points()))
        show(name, builder.by_rows(), scans, wrong)


def noise() -> None:
    tour = record(furnished_rooms(), along(TOUR + TOUR[1:], period_s=0.2), noise=0.005)
    drawn = np.random.default_rng(1).standard_normal((len(tour.scans), 2))
    planted({f"pose noise {mm} mm": mm * 1e-3 * drawn for mm in (0, 5, 10, 20, 40)}, tour.scans, tour.map_T_laser)


def smear() -> None:
    tour = record(furnished_rooms(), along(TOUR + TOUR[1:], period_s=0.2), noise=0.005)
    drawn = np.random.default_rng(1).uniform(-0.5, 0.5, (len(tour.scans), 2))
    errors = {f"smeared by {mm} mm": mm * 1e-3 * drawn for mm in (0, 50, 100, 200, 300, 400, 500, 1000, 1500)}
    late = (np.arange(len(tour.scans)) >= len(tour.scans) // 2)[:, None]
    errors |= {f"half smeared by {mm} mm": mm * 1e-3 * drawn * late for mm in (300, 500, 1500)}
    planted(errors, tour.scans, tour.map_T_laser)


def angles() -> None:
    rng = np.random.default_rng(1)
    solid = {f"solid {mm} mm": rng.uniform(-0.5, 0.5, 40_000) * mm * 1e-3 for mm in (1, 20, 60, 100, 200, 300, 400)}
    noisy = {f"sigma {mm} mm": rng.normal(0.0, mm * 1e-3, 40_000) for mm in (5, 10, 20, 40, 80, 120)}
    print(f"{'median at 40 angles, mm':34s}{'least':>8s}{'mean':>8s}{'most':>8s}{'std':>7s}")
    for name, across_m in (solid | noisy).items():
        found = [planted_wall(a, across_m).median_mm for a in np.linspace(0.0, np.pi, 40, endpoint=False)]
        print(f"{name:34s}{min(found):8.1f}{np.mean(found):8.1f}{max(found):8.1f}{np.std(found):7.1f}", flush=True)


def logs(paths: list[str]) -> None:
    for path in paths:
        whole = open_log(Path(path), odom="off")
        last_s = (whole.last_ns - whole.first_ns) * 1e-9
        for end_s in [*(e for e in (5, 10, 15, 20, 30, 60, 120) if e < last_s), None]:
            log = open_log(Path(path), odom="off", end_s=end_s)
            name = f"{Path(path).stem}, {last_s if end_s is None else end_s:.0f} s"
            show_slam(name, list(log.scans()), log.period_s)


def main() -> None:
    parser = ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("what", choices=["rest", "rounds", "noise", "smear", "angles", "logs"])
    parser.add_argument("logs", nargs="*")
    args = parser.parse_args()
    if args.what != "angles":
        print(HEAD)
    logs(args.logs) if args.what == "logs" else globals()[args.what]()


if __name__ == "__main__":
    main()
