"""The whole loop on synthetic and real recordings: tracked, honest when lost, repeatable."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.loading import load_config
from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Pose, Trajectory
from mavnav.scan import Scan
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods import registry
from mavnav.slam.methods.registry import METHODS, RARE_KERNELS
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult, jump_warnings
from mavnav.slam.retries import odometry
from support.marks import slow
from support.synthetic import LDS_01, TOUR, Recording, along, drifting_odometry, furnished_rooms, record, room, scan_at

PERIOD_S = 0.1


@pytest.fixture(scope="module")
def tour() -> Recording:
    return record(furnished_rooms(), along(TOUR), noise=0.01)


def every_other(recording: Recording) -> Recording:
    path = recording.world_T_laser
    return Recording(recording.scans[::2], Trajectory(path.stamps_ns[::2], path.xyyaw[::2]))


def replay(scans: list[Scan], odom: Trajectory | None = None, **config: object) -> SlamResult:
    return run_slam(lambda: scans, load_config(overrides=config), PERIOD_S, odom)


def errors_m(outcome: SlamResult, recording: Recording) -> np.ndarray:
    """Distances of the tracked poses to the truth; both begin at the first laser pose, nothing is aligned."""
    truth = {
        int(t): xy for t, xy in zip(recording.world_T_laser.stamps_ns, recording.map_T_laser.xyyaw[:, :2], strict=True)
    }
    here = outcome.trajectory
    return np.array([np.hypot(*(here.xyyaw[k, :2] - truth[int(t)])) for k, t in enumerate(here.stamps_ns)])


@pytest.mark.parametrize("grid", ["10x10", slow("5x7")])
def test_robust_follows_the_tour(tour: Recording, grid: str) -> None:
    tour = every_other(tour)
    outcome = run_slam(lambda: tour.scans, load_config(overrides={"grid": grid}), 2 * PERIOD_S)
    assert len(outcome.trajectory) == len(tour.scans)
    assert not outcome.lost
    assert np.sqrt((errors_m(outcome, tour) ** 2).mean()) < 0.04
    assert outcome.grid.hits.sum() > 0.9 * sum(np.isfinite(s.ranges_m).sum() for s in tour.scans)


def test_on_line_leaves_the_final_pass_out(tour: Recording) -> None:
    passes: list[str] = []
    scans = tour.scans[:30]
    on_line = run_slam(lambda: scans, Config(final_pass=False), PERIOD_S, None, lambda name, _: passes.append(name))
    assert set(passes) == {"track", "final pass"}  # which judges, and changes nothing
    both = replay(scans)
    assert sum(s.match.evaluations for s in both.steps) > sum(s.match.evaluations for s in on_line.steps)


def test_odometry_leads_where_the_laser_moves_too_far_to_be_followed(tour: Recording) -> None:
    sparse = Recording(tour.scans[::12], Trajectory(tour.world_T_laser.stamps_ns[::12], tour.world_T_laser.xyyaw[::12]))
    with_odometry = run_slam(lambda: sparse.scans, Config(), 1.2, drifting_odometry(tour.world_T_laser))
    assert len(with_odometry.trajectory) == len(sparse.scans)
    assert errors_m(with_odometry, sparse).max() < 0.15


def test_the_same_scans_give_the_same_numbers(tour: Recording) -> None:
    a, b = replay(tour.scans[:40]), replay(tour.scans[:40])
    np.testing.assert_array_equal(a.trajectory.xyyaw, b.trajectory.xyyaw)
    np.testing.assert_array_equal(a.grid.hits, b.grid.hits)
    np.testing.assert_array_equal(a.grid.passes, b.grid.passes)


def test_full_turn_scanner_with_clockwise_beams_is_followed() -> None:
    from msgspec.structs import replace

    spec = replace(LDS_01, angle_min_rad=np.pi, angle_step_rad=-LDS_01.angle_step_rad)
    recording = record(room(3.0, 2.5), along([(0.6, 0.6), (2.2, 0.7), (2.2, 1.8)], period_s=0.2), spec, noise=0.01)
    outcome = run_slam(lambda: recording.scans, Config(), 0.2)
    assert len(outcome.trajectory) == len(recording.scans)
    assert errors_m(outcome, recording).max() < 0.05


def test_paper_follows_a_slow_quiet_laser() -> None:
    recording = record(room(3.0, 2.4), along([(1.0, 1.0), (1.8, 1.2)], speed_m_s=0.15), noise=0.003)
    outcome = replay(recording.scans, method="paper")
    assert not outcome.lost
    assert len(outcome.trajectory) > 0.95 * len(recording.scans)
    assert errors_m(outcome, recording).max() < 0.05


def test_paper_moves_neither_map_nor_pose_with_a_scan_that_does_not_match() -> None:
    here, elsewhere = Pose(1.0, 1.0), Pose(3.4, 5.5)
    scans = [scan_at(room(3.0, 2.4), here, stamp_ns=k) for k in range(3)]
    scans += [scan_at(furnished_rooms(), elsewhere, stamp_ns=3 + k) for k in range(2)]
    scans += [scan_at(room(3.0, 2.4), here, stamp_ns=5)]
    outcome = replay(scans, method="paper")
    assert [s.tracked for s in outcome.steps] == [True, True, True, False, False, True]
    assert outcome.grid.hits.sum() == 4 * np.isfinite(scans[0].ranges_m).sum()
    assert outcome.steps[-1].match.map_T_laser.distance_m < 0.01


def blank(scan: Scan) -> Scan:
    return Scan(scan.stamp_ns, np.full(scan.spec.beams, np.nan), scan.spec)


@pytest.mark.parametrize("method", ["robust", "paper"])
def test_blank_scans_are_no_poses(method: str) -> None:
    still = [scan_at(room(3.0, 2.4), Pose(1.0, 1.0), stamp_ns=k * 100_000_000) for k in range(30)]
    blanks = {0, 1, 10, 11, *range(15, 22), 29}
    outcome = replay([blank(s) if k in blanks else s for k, s in enumerate(still)], method=method)
    assert {s.index for s in outcome.steps if not s.tracked} == blanks
    assert [(lost.scans, lost.recovered) for lost in outcome.lost] == [(7, True)]
    assert not outcome.lost_for_good


@pytest.mark.parametrize(("blind", "lost"), [(5, False), (6, True)])
def test_a_log_with_poses_for_fewer_than_half_of_its_scans_is_lost_though_it_ends_well(blind: int, lost: bool) -> None:
    still = [scan_at(room(3.0, 2.4), Pose(1.0, 1.0), stamp_ns=k * 100_000_000) for k in range(10)]
    outcome = replay([blank(scan) if 1 <= k <= blind else scan for k, scan in enumerate(still)])
    assert [(found.scans, found.recovered) for found in outcome.lost] == [(blind, True)]
    assert outcome.tracked_share == 1 - blind / 10
    assert outcome.lost_for_good is lost


def test_a_log_of_one_scan_has_no_period_and_one_pose() -> None:
    outcome = run_slam(lambda: [scan_at(room(), Pose(1, 1))], Config(), 0.0)
    np.testing.assert_allclose(outcome.trajectory.xyyaw, [[0.0, 0.0, 0.0]], atol=0.005)  # the final pass may nudge it
    assert not outcome.lost


@pytest.mark.slow
def test_a_part_beyond_the_reach_of_any_vehicle_is_not_joined() -> None:
    drive = record(furnished_rooms(), along(TOUR[:4], speed_m_s=0.8))
    froze = [replace(drive.scans[20], stamp_ns=scan.stamp_ns) for scan in drive.scans[21:46]]
    scans = [*drive.scans[:21], *froze, *drive.scans[46:]]
    found = run_slam(lambda: scans, Config(), 0.1)
    assert [(part.scans, part.joined) for part in found.parts] == [(46, False), (48, True)]
    (warning,) = found.warnings
    assert warning.startswith("46 scans from 0.0 to 4.5 s do not match the later ones and are left out")
    assert run_slam(lambda: drive.scans, Config(), 0.1).warnings == ()


def test_a_path_that_jumps_across_lost_scans_is_told() -> None:
    def warnings(x_m: float) -> list[str]:
        poses = [Pose(0.1 * k + (x_m if k >= 10 else 0.0), 0.0) for k in range(20)]
        steps = [Step(k, k * 10**8, first_match(100)._replace(map_T_laser=p), k != 10) for k, p in enumerate(poses)]
        return list(jump_warnings(Steps(steps)))

    (text,) = warnings(2.0)
    assert text.startswith("the path jumps faster than any vehicle (1.1 s after the first scan): ")
    assert not warnings(0.3)


def test_a_log_of_blank_scans_is_lost() -> None:
    outcome = replay([blank(scan_at(room(), Pose(1, 1), stamp_ns=k)) for k in range(3)])
    assert outcome.lost_for_good
    assert len(outcome.trajectory) == 0


def test_a_laser_carried_off_is_lost_for_good() -> None:
    """After the jump the laser stands in another building."""
    at_home = [scan_at(room(3.0, 2.4), Pose(1.0, 1.0), stamp_ns=k * 100_000_000) for k in range(10)]
    away = [
        scan_at(furnished_rooms() * 1.7, Pose(6.0, 9.0, 0.3 * k), stamp_ns=(10 + k) * 100_000_000, noise=0.01)
        for k in range(10)
    ]
    outcome = replay(at_home + away)
    assert outcome.lost_for_good
    assert outcome.lost[-1].start_ns == away[0].stamp_ns
    assert outcome.trajectory.stamps_ns[-1] == at_home[-1].stamp_ns


def test_motion_faster_than_any_vehicle_is_not_believed() -> None:
    scans = [scan_at(room(3.0, 2.4), Pose(1.0, 1.0), stamp_ns=k * 100_000_000) for k in range(5)]
    scans.append(scan_at(room(3.0, 2.4), Pose(1.4, 1.0), stamp_ns=500_000_000))
    assert not replay(scans).steps[-1].tracked
    assert replay(scans, **{"robust.max_speed_m_s": 5.0}).steps[-1].tracked


# ---- real logs ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def judge(real_logs: Path) -> ModuleType:
    """The scorer that lies beside the real recordings."""
    path = real_logs.parent / "judge" / "judge.py"
    spec = importlib.util.spec_from_file_location("judge", path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules["judge"] = module
    spec.loader.exec_module(module)
    return module


def scored(judge: ModuleType, real_logs: Path, name: str, mask: int) -> tuple[object, list[object], float]:
    """Replay a real log without odometry; return the judge's log, the placed views and the coverage."""
    path = real_logs / name / f"{name}.mcap"
    log = open_log(path, odom="off")
    outcome = run_slam(log.scans, Config(odom="off"), log.period_s)
    assert not outcome.lost
    judged = judge.read_log(path, "/scan", 0.1, None, mask)
    stamps = outcome.trajectory.stamps_ns * 1e-9
    views, coverage = judge.place(judged, name, stamps, outcome.trajectory.xyyaw, 0.02)
    return judged, views, coverage


@pytest.mark.slow
@pytest.mark.real_logs
def test_ccny_demo_is_crisp_where_it_is_seen_again(judge: ModuleType, real_logs: Path) -> None:
    log, views, coverage = scored(judge, real_logs, "ccny_demo", 0)
    reference = judge.read_tum(real_logs.parent / "judge" / "peers" / "hector_ccny_demo.tum")
    _, long_pairs = judge.draw_pairs(judge.place(log, "hector", *reference, 0.02)[0], log, 0)
    assert coverage == 1.0
    assert judge.pair_distance(log, views, long_pairs, revisit=True)[0] <= 14.0


@pytest.mark.slow
@pytest.mark.real_logs
def test_urg_exp1_keeps_its_heading(judge: ModuleType, real_logs: Path) -> None:
    log, views, coverage = scored(judge, real_logs, "urg_exp1", 70)
    assert coverage == 1.0
    fifths = np.zeros(5, complex)
    for view in views:
        direction, length = judge.wall_chords(log, view)
        fifths[min(4, 5 * view.index // len(log.t))] += (length * np.exp(4j * direction)).sum()
    assert np.abs(np.degrees(np.angle(fifths / fifths[0])) / 4).max() <= 3.5


@pytest.mark.slow
@pytest.mark.real_logs
def test_lego_robot4_lies_on_the_camera_track(judge: ModuleType, real_logs: Path) -> None:
    log = open_log(real_logs / "lego_robot4" / "lego_robot4.mcap", odom="off")
    outcome = run_slam(log.scans, Config(odom="off"), log.period_s)
    truth_t, truth = judge.read_tum(real_logs / "lego_robot4" / "groundtruth.tum")
    look = outcome.trajectory.stamps_ns * 1e-9 - 0.233
    inside = (look >= truth_t[0]) & (look <= truth_t[-1])
    marker = judge.compose(outcome.trajectory.xyyaw[inside], np.array([0.006, -0.002, 0.0]))[:, :2]
    target = np.column_stack([np.interp(look[inside], truth_t, truth[:, k]) for k in (0, 1)])
    error = judge.aligned_error(marker, target, 1.1202)
    assert len(outcome.trajectory) == 278
    assert np.sqrt((error**2).mean()) <= 0.017


@pytest.mark.parametrize("after", [0, 1, 20, 60, 75, 115, 150])
def test_a_run_that_is_stopped_keeps_the_longest_track(
    tour: Recording, after: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever the scans run dry: in the first pass, or in a pass without the odometry that contradicts them.

    The first pass ends where that is plain.
    """
    first = 60
    monkeypatch.setattr(odometry, "FIRST_CHECK", first)
    scans, odom = tour.scans[75:145], tour.map_T_laser
    wrong = Trajectory(odom.stamps_ns, odom.xyyaw * [-1.0, -1.0, -1.0])
    given = -2 * len(scans)  # all are read before, for the floor

    def log_scans() -> Iterator[Scan]:
        nonlocal given
        for scan in scans:
            if given >= after:
                return
            given += 1
            yield scan

    outcome = run_slam(log_scans, Config(), PERIOD_S, wrong)
    assert len(outcome.steps) == (after if after <= first else max(first, min(after - first, len(scans))))
    assert [step.index for step in outcome.steps] == list(range(len(outcome.steps)))
    assert bool(outcome.warnings) == (after - first >= first)


def test_rare_kernels_are_modules_that_no_tracked_scan_needs() -> None:
    for name in RARE_KERNELS:
        import_module(f"mavnav.kernels.{name}")
    assert not {name for method in METHODS.values() for name in method.own_kernels} & set(RARE_KERNELS)


def test_rare_kernels_are_compiled_in_advance_for_a_given_map(monkeypatch: pytest.MonkeyPatch) -> None:
    unused: list[set[str]] = []
    monkeypatch.setattr(registry, "prepare", lambda _, left_out: unused.append(set(left_out)))
    registry.load_kernels(Config(), print)
    registry.load_kernels(Config(), print, rare=True)
    assert unused[0] - unused[1] == set(RARE_KERNELS)
