"""A run made up from a synthetic room: known poses, real map, no search."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec import Struct, field
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.logs import Damage, Odometry, ScanCounts, Topic
from mavnav.mapping.occupancy_grid import GridBuilder, measured_area
from mavnav.metrics.journey import Journey
from mavnav.metrics.map_quality import measure_map
from mavnav.outputs.documents.provenance import Typed, provenance
from mavnav.outputs.run import RunResult, Timing
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.slam.matching.scan_matching import Match
from mavnav.slam.matching.steps import LostInterval, Step, Steps
from mavnav.slam.result import SlamResult
from support.synthetic import along, furnished_rooms, scan_at

LOST = (10, 11)
"""Scans without a pose."""


class FabricatedLog(Struct, frozen=True):
    """The interface of ``mavnav.logs.Log`` over scans in memory."""

    recorded: tuple
    path: Path = Path("room [1].mcap")
    more: tuple = ()
    format: str = "mcap"
    size_bytes: int = 1234
    sha256: str = "0" * 64
    topics: tuple = (Topic("/scan", "sensor_msgs/msg/LaserScan", "cdr", 20),)
    topic: str = "/scan"
    frame_id: str = "/laser"
    counts: ScanCounts = field(default_factory=lambda: ScanCounts(22, 20, {"stamp repeats": 2}))
    cleaning: dict = None
    start_s: float = 0.0
    period_s: float = 0.1
    gaps: tuple = ()
    stamp_source: str = "header"
    base_T_laser: Pose | None = field(default_factory=lambda: Pose(0.1, -0.02, 0.3))
    mounting_source: str | None = "tf_static"
    base_frame: str | None = "base_footprint"
    odometry: Odometry | None = None
    imu: None = None
    attitude: None = None
    truth: None = None
    damage: tuple[Damage, ...] = ()
    warnings: tuple[str, ...] = ("a warning",)

    def __len__(self) -> int:
        return len(self.recorded)

    @property
    def mid_sweep_s(self) -> float:
        return 0.0

    @property
    def first_ns(self) -> int:
        return self.recorded[0].stamp_ns

    @property
    def last_ns(self) -> int:
        return self.recorded[-1].stamp_ns

    @property
    def duration_s(self) -> float:
        return (self.last_ns - self.first_ns) * 1e-9

    @property
    def sensor(self):
        return self.recorded[0].spec

    def scans(self):
        return iter(self.recorded)


def fabricate(scans: int = 20, noise: float = 0.005) -> RunResult:
    walls, rng = furnished_rooms(), np.random.default_rng(7)
    truth = along([(1.0, 1.0), (3.0, 1.0), (4.6, 3.0), (4.6, 5.5)], period_s=0.5)
    pick = np.linspace(0, len(truth) - 1, scans).round().astype(int)
    stamps = [int(truth.stamps_ns[0]) + 500_000_007 * k for k in range(scans)]
    recorded = tuple(
        scan_at(walls, truth[int(i)], stamp_ns=t, noise=noise, rng=rng) for i, t in zip(pick, stamps, strict=True)
    )
    poses = [truth[0].between(truth[int(i)]) for i in pick]  # map: the first laser pose
    return run_of(recorded, poses)


def run_of(recorded, poses, cell_m: float = 0.02) -> RunResult:
    tally, steps = GridBuilder(cell_m), []
    for k, (scan, pose) in enumerate(zip(recorded, poses, strict=True)):
        tracked = k not in LOST
        if tracked:
            tally.insert(pose, transform_points(pose, scan.points()))
        match = Match(pose, 1e-4 if tracked else np.inf, 600, 0.9 if tracked else 0.1, 960 + k, 8, tracked)
        steps.append(Step(k, scan.stamp_ns, match, tracked))
    kept = [s for s in steps if s.tracked]
    trajectory = Trajectory.of([s.stamp_ns for s in kept], [s.match.map_T_laser for s in kept])
    lost = (LostInterval(recorded[LOST[0]].stamp_ns, recorded[LOST[-1]].stamp_ns, len(LOST), recovered=True),)
    grid = tally.by_rows()
    journey = Journey(trajectory, lambda: iter(recorded), len(kept) / len(steps))
    measured = measure_map(measured_area(grid), journey)
    log = FabricatedLog(recorded, cleaning={"valid": 600, "zero": 7})
    result = SlamResult(Steps(steps), trajectory, grid, lost)
    typed = Typed(("mavnav", "replay", "room [1].mcap"), folder="/logs")
    now = provenance(typed, ["mavnav", "replay", "/logs/room [1].mcap"])
    made = replace(now, started="2026-01-31T12:00:00Z")
    return RunResult(log, Config(), result, measured, Timing(2.0, 1.5, 0.5, scans_s=(0.125, 0.25, 0.75)), made)


@pytest.fixture(scope="session")
def run() -> RunResult:
    return fabricate()


@pytest.fixture(scope="session")
def change():
    """Return a function that makes a run with another log: ``change(run, damage=...)``."""
    return lambda run, **log: replace(run, log=replace(run.log, **log))
