"""How doubtful a track is: each reason where it is planted, none on a clean one, more doubt the more there is of it."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Rotation
from mavnav.slam.doubt import judge
from mavnav.slam.doubt.features import DISAGREEMENT, FEATURES, WRONG_M, TrackEvidence
from mavnav.slam.doubt.judge import contributions, doubt_of, probability
from mavnav.slam.findings import NOT_PLANAR, SECOND_MOTION, Doubt, Reason
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.refinement.refine import refine_poses, remove_dynamic_cells
from mavnav.slam.track import Track
from mavnav.units import DEG
from support.marks import slow
from support.synthetic import LDS_01, along, furnished_rooms, polyline, record

N, PERIOD_NS = 60, 100_000_000
AT = slice(30, 33)


def clean(*, compared: bool = False, **changes: object) -> TrackEvidence:
    """Return what a good track shows, with some of it changed; a second track is the same."""
    time_s = 0.1 * np.arange(N)
    xyyaw = np.column_stack((0.5 * time_s, np.sin(time_s), 0.3 * np.sin(time_s)))
    good = TrackEvidence(
        period_s=0.1,
        unmeasured=np.ones(N),
        stamps_ns=np.arange(N, dtype=np.int64) * PERIOD_NS,
        xyyaw=xyyaw,
        points=np.full(N, 300),
        observed=np.full(N, 0.1),
        conflicts=np.zeros(N),
        resampled=xyyaw.copy() if compared else np.full((N, 3), np.nan),
        wheels=np.full((N, 3), np.nan),
        tilt_rad=np.zeros(N),
        second_motion=np.zeros(N),
        by_odometry_m=np.zeros(N),
        beside_gap=np.zeros(N),
    )
    return replace(good, **changes)


def jumped(x_m: float = 0.0, yaw_deg: float = 0.0) -> np.ndarray:
    """Return the poses with a jump in the middle."""
    poses = clean().xyyaw.copy()
    poses[AT.start :] += (x_m, 0.0, yaw_deg * DEG)
    return poses


def some(value: float, usual: float) -> np.ndarray:
    """Return a number for each scan, another one for those in the middle."""
    out = np.full(N, usual)
    out[AT] = value
    return out


def missed() -> np.ndarray:
    """Return the poses of a second track that lost the laser in the middle."""
    poses = clean().xyyaw.copy()
    poses[N // 4 : -N // 4] = np.nan
    return poses


PLANTED = {
    "slip": clean(xyyaw=jumped(x_m=0.4)),
    "two tracks disagree": clean(resampled=jumped(x_m=0.4)),
    "weakly constrained pose": clean(observed=np.full(N, 0.001)),
    "sampling too sparse for the motion": clean(xyyaw=clean().xyyaw * (8.0, 1.0, 1.0)),
    "a second track is lost": clean(resampled=missed()),
    NOT_PLANAR: clean(conflicts=np.full(N, 0.08), tilt_rad=np.full(N, 0.2)),
    "too few beams": clean(points=np.full(N, 50)),
    SECOND_MOTION: clean(second_motion=some(0.4, 0.0)),
    "placed by odometry alone": clean(by_odometry_m=some(0.3, 0.0)),
    "may have been carried": clean(beside_gap=some(1.0, 0.0)),
    "odometry contradicts": clean(wheels=jumped(x_m=1.0)),
}


def test_all_reasons_are_planted() -> None:
    assert {feature.reason for feature in FEATURES.values()} == set(PLANTED)


@pytest.mark.parametrize("reason", PLANTED)
def test_a_reason_is_found_where_it_is_planted(reason: str) -> None:
    compared = np.isfinite(PLANTED[reason].resampled).any()
    found = doubt_of(PLANTED[reason])
    assert found.probability > doubt_of(clean(compared=bool(compared))).probability
    stretch = next(r for r in found.reasons if r.name == reason)
    stamps_ns = PLANTED[reason].stamps_ns
    assert stretch.start_ns <= stamps_ns[AT.start] <= stretch.end_ns
    assert stretch.value >= 1.0


@pytest.mark.parametrize("compared", [False, True])
def test_a_clean_track_shows_none(compared: bool) -> None:
    found = doubt_of(clean(compared=compared))
    assert found.reasons == ()
    assert found.probability < 0.1


def test_weak_geometry_counts_where_the_laser_moves_without_odometry() -> None:
    weak = PLANTED["weakly constrained pose"]
    for known in (replace(weak, unmeasured=np.zeros(N)), replace(weak, xyyaw=np.zeros((N, 3)))):
        assert doubt_of(weak).probability > doubt_of(known).probability


def test_a_slide_of_two_seconds_in_a_minute_shows() -> None:
    time_s = 0.1 * np.arange(600)
    slide = clean(
        unmeasured=np.ones(600),
        stamps_ns=np.arange(600, dtype=np.int64) * PERIOD_NS,
        xyyaw=np.column_stack((0.5 * time_s, np.zeros((600, 2)))),
        observed=np.where((time_s >= 30.0) & (time_s < 32.0), 0.001, 0.1),
    )
    shown = FEATURES["weakly_constrained"].of(slide)
    assert shown.max() == pytest.approx(1.0 / WRONG_M)
    assert np.flatnonzero(shown)[[0, -1]].tolist() == [300, 319]


def test_conflicts_count_where_the_laser_moves() -> None:
    standing = clean(xyyaw=np.zeros((N, 3)), conflicts=np.full(N, 0.2))
    assert not FEATURES["not_planar"].of(standing).any()
    assert FEATURES["not_planar"].of(replace(standing, xyyaw=clean().xyyaw)).min() > 1.0


def test_odometry_may_err_by_a_share_of_the_motion() -> None:
    poses = clean().xyyaw
    little, much = (
        FEATURES["odometry_disagrees"].of(clean(wheels=poses * (factor, factor, 1.0))).max() for factor in (1.05, 2.0)
    )
    assert little < 1.0 < much


@pytest.mark.parametrize("name", FEATURES)
@pytest.mark.parametrize("second", [np.nan, 0.3])
def test_the_doubt_grows_with_each_feature(name: str, second: float) -> None:
    values = {**dict.fromkeys(FEATURES, 0.3), DISAGREEMENT: second}
    if name not in contributions(values):
        assert (np.isnan(second) and not FEATURES[name].alone) or (np.isfinite(second) and not FEATURES[name].compared)
        return
    doubts = [probability({**values, name: value}) for value in np.geomspace(0.01, 100.0, 30)]
    assert (np.diff(doubts) >= 0.0).all()
    assert doubts[-1] > doubts[0]


def test_stretches_that_are_apart_are_told_apart() -> None:
    conflicts = np.zeros(N)
    conflicts[:10] = conflicts[-10:] = 0.2
    found = [r for r in doubt_of(clean(conflicts=conflicts)).reasons if r.name == NOT_PLANAR]
    assert [(r.start_ns // PERIOD_NS, r.end_ns // PERIOD_NS) for r in found] == [(0, 9), (N - 10, N - 1)]


def test_only_a_high_doubt_marks_scans() -> None:
    stamps_ns = clean().stamps_ns
    here = Reason("slip", int(stamps_ns[AT.start]), int(stamps_ns[AT.stop]), 2.0)
    everywhere = Reason("too few beams", 0, int(stamps_ns[-1]), 2.0)
    assert not Doubt(0.4, (here,)).marks(stamps_ns).any()
    assert Doubt(0.9, (everywhere, here)).marks(stamps_ns).sum() == 4
    assert Doubt(0.9, (everywhere,)).marks(stamps_ns).all()


def test_a_second_track_is_tried_only_where_the_first_is_in_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = record(furnished_rooms(), along([(0.8, 0.7), (1.6, 0.7)]))
    found = run_slam(lambda: drive.scans, Config(), 0.1)
    assert found.doubt is not None
    assert found.doubt.tried == found.doubt.reasons == ()
    assert found.doubt.probability < judge.UNDECIDED[0]
    monkeypatch.setattr(judge, "UNDECIDED", judge.ALWAYS)
    again = run_slam(lambda: drive.scans, Config(), 0.1)
    assert again.doubt is not None
    assert again.doubt.tried == (judge.RESAMPLED,)
    assert not again.doubt.high
    assert np.array_equal(again.trajectory.xyyaw, found.trajectory.xyyaw)
    monkeypatch.setattr(judge, "LEAST_SHARE", 1.01)
    few = run_slam(lambda: drive.scans, Config(), 0.1)
    assert few.doubt == found.doubt


def test_a_causal_track_is_judged() -> None:
    drive = record(furnished_rooms(), along([(0.8, 0.7), (1.6, 0.7)]))
    causal = run_slam(lambda: drive.scans, Config(final_pass=False), 0.1)
    assert causal.doubt is not None
    assert causal.doubt.probability < judge.UNDECIDED[0]


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_a_track_of_another_method_is_judged_by_its_map(scale: float) -> None:
    drive, config = record(furnished_rooms(), along([(0.8, 0.7), (1.6, 0.7)])), Config(method="paper")
    poses = [pose._replace(x_m=scale * pose.x_m) for pose in drive.map_T_laser]
    matches = [first_match(300)._replace(map_T_laser=pose) for pose in poses]
    steps = (Step(k, scan.stamp_ns, matches[k], tracked=True) for k, scan in enumerate(drive.scans))
    track = Track(lambda: drive.scans, config, Motion(0.1), make_method(config), Steps(steps))
    judged = judge.judge_redrawn(track)
    assert judged.findings.doubt is not None
    assert judged.findings.doubt.tried == (judge.RESAMPLED,)
    assert judged.findings.doubt.high == (scale > 1.0)
    assert [step.match.map_T_laser for step in judged.steps] == poses


@pytest.mark.parametrize("commanded", [False, True])
def test_wheels_measure_motion_and_commands_do_not(*, commanded: bool) -> None:
    """Seven of eight vehicles that commands carried along a hallway were 0.26 to 0.63 m off, at a doubt of 0.03."""
    walls = polyline((0.0, -1.2), (40.0, -1.2), (40.0, 1.2), (0.0, 1.2), closed=True)
    drive = record(walls, along([(15.0, 0.0), (21.0, 0.0)]), LDS_01)
    truth = drive.map_T_laser
    motion = Motion(0.1, partial(truth.at, max_gap_ns=10**9), commanded=commanded)
    method = make_method(Config())
    track = Track(lambda: drive.scans, Config(), motion, method).over(drive.scans, "track")
    refiner = track.refiner
    assert refiner is not None
    judged = judge.judge(refine_poses(remove_dynamic_cells(track, refiner), refiner), refiner, judge.ALWAYS)
    assert judged.findings.doubt is not None
    assert judged.findings.doubt.high == commanded


def test_a_track_of_nothing_is_not_judged() -> None:
    drive = record(furnished_rooms(), along([(0.8, 0.7), (1.0, 0.7)]))
    blind = [replace(scan, ranges_m=np.full(scan.spec.beams, np.nan)) for scan in drive.scans]
    assert run_slam(lambda: blind, Config(final_pass=False), 0.1).doubt is None


def test_the_tilt_of_an_inertial_sensor_is_a_reason() -> None:
    drive = record(furnished_rooms(), along([(0.8, 0.7), (1.0, 0.7)]))
    stamps_ns = np.array([scan.stamp_ns for scan in drive.scans])
    level = Rotation(stamps_ns.copy(), np.zeros(len(stamps_ns)), np.zeros(len(stamps_ns)))
    tilted = replace(level, tilt_rad=np.full(len(stamps_ns), 30 * DEG))
    plain, same, other = (run_slam(lambda: drive.scans, Config(), 0.1, rotation=r).doubt for r in (None, level, tilted))
    assert plain == same
    assert plain is not None and other is not None
    assert [r.name for r in other.reasons if r.name not in {r.name for r in plain.reasons}] == [NOT_PLANAR]
    assert other.probability > plain.probability


@pytest.mark.real_logs
@pytest.mark.parametrize(
    "log", [slow("kev_urg/kev_urg.bag"), "ccny_demo/ccny_demo.mcap", slow("lego_robot4/lego_robot4.mcap")]
)
def test_the_doubt_of_recorded_logs(real_logs: Path, log: str) -> None:
    opened = open_log(real_logs / log)
    scans = list(opened.scans())
    odometry = opened.odometry.odom_T_laser if opened.odometry else None
    found = run_slam(lambda: scans, Config(), opened.period_s, odometry)
    assert found.doubt is not None
    tilted = log.startswith("kev")
    assert found.doubt.high == tilted
    assert found.planar != tilted
