"""The remedy for lost and doubtful tracks: when it is tried, when it is used, and what is reported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Pose, Trajectory
from mavnav.slam.doubt.features import DISAGREEMENT, FEATURES
from mavnav.slam.doubt.model import probability
from mavnav.slam.findings import NOT_PLANAR, Doubt, Reason
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import first_match, no_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.retries import beam_order, remedy
from mavnav.slam.retries.remedy import (
    FINER,
    INHERENT,
    MORE_MISSED,
    MOST_DISAGREEMENT,
    MOST_DOUBT,
    missed_so_far,
    until_disagreeing,
    until_missed,
    with_remedy,
)
from mavnav.slam.retries.resampled_track import FEW_POINTS
from mavnav.slam.track import Track

THIN = slice(5, None, 8)

START = Track(list, Config(), Motion(0.1), make_method(Config()))


Remedied = Callable[[Track, Track], tuple[Track, list[Track], list[Track]]]


def track(probability: float, tracked: int = 20, reason: str = "slip", scans: int = 20, points: int = 100) -> Track:
    """Return a judged track; scans without a pose come last."""
    matches = [first_match(points) if k < tracked else no_match(Pose()) for k in range(scans)]
    steps = Steps(Step(k, k * 100_000_000, match, tracked=k < tracked) for k, match in enumerate(matches))
    reasons = (Reason(reason, 0, 1, 2.0),) if probability > 0.1 else ()
    return replace(START, steps=steps, doubt=Doubt(probability, reasons))


@pytest.fixture
def remedied(monkeypatch: pytest.MonkeyPatch) -> Remedied:
    """Return what becomes of a track, the starts from which another one was tracked, and those that were judged."""

    def run(first: Track, other: Track) -> tuple[Track, list[Track], list[Track]]:
        starts: list[Track] = []
        judged: list[Track] = []

        def again(start: Track, limit: object) -> Track:
            starts.append(start)
            return replace(other, doubt=None)

        def judge(some: Track) -> Track:
            judged.append(some)
            return other

        monkeypatch.setattr(remedy, "with_good_beginning", again)
        return with_remedy(first, START, lambda some: some, judge), starts, judged

    return run


@pytest.mark.parametrize(
    ("first", "other"),
    [(track(0.9), track(0.1)), (track(0.05, tracked=12), track(0.05)), (track(0.6, tracked=18), track(0.2))],
    ids=["doubtful", "lost", "doubtful and lost"],
)
def test_a_track_of_little_doubt_replaces_a_lost_or_doubtful_one(
    first: Track, other: Track, remedied: Remedied
) -> None:
    found, (start,), _ = remedied(first, other)
    assert found.steps is other.steps
    assert found.doubt is other.doubt
    assert found.remedies == (("finer voxels", first.doubt.probability, other.doubt.probability, True),)
    assert start.config.robust.voxel_mm == FINER * START.config.robust.voxel_mm


def test_another_track_that_is_as_doubtful_is_reported_and_not_used(remedied: Remedied) -> None:
    first = track(0.9)
    found, _, _ = remedied(first, track(0.3))
    assert found.steps is first.steps
    assert found.remedies == (("finer voxels", 0.9, 0.3, False),)


@pytest.mark.parametrize(
    "other",
    [track(0.1, tracked=12), track(0.1, tracked=19), track(0.1, tracked=10, scans=10)],
    ids=["lost", "with a pose for fewer scans", "ended early"],
)
def test_another_track_that_cannot_replace_the_first_is_given_up(other: Track, remedied: Remedied) -> None:
    first = track(0.9)
    found, _, judged = remedied(first, other)
    assert found.steps is first.steps
    assert found.remedies[0][:2] == ("finer voxels", 0.9)
    assert np.isnan(found.remedies[0].doubt_after)
    assert not found.remedies[0].used
    assert judged == []


@pytest.mark.parametrize(
    "first",
    [
        track(0.5),
        *(track(0.9, reason=reason) for reason in (*INHERENT, NOT_PLANAR)),
        track(0.05, tracked=3),
        track(0.9, points=FEW_POINTS - 1),
        track(0.05, tracked=12, points=FEW_POINTS - 1),
        replace(track(0.9), doubt=None),
    ],
)
def test_no_remedy_is_tried_where_none_is_needed_or_helps(first: Track, remedied: Remedied) -> None:
    assert remedied(first, track(0.1)) == (first, [], [])


def test_what_was_found_about_the_input_is_kept(remedied: Remedied) -> None:
    poses = np.zeros((20, 3))
    first = replace(track(0.9), odometry_contradicts=True, resampled=poses, motion=Motion(0.3), on_step=print)
    first = first.with_warning(beam_order.WARNING)
    _, (start,), _ = remedied(first.with_warning("something about the track"), track(0.1))
    assert (start.odometry_contradicts, start.motion, start.warnings) == (True, Motion(0.3), first.warnings)
    assert start.resampled is poses


@pytest.mark.parametrize(
    ("tracked", "missed"),
    [("1111", [0, 0, 0, 0]), ("10110", [0, 1, 1, 1, 1]), ("0010100", [1, 2, 2, 3, 3, 3, 3]), ("000", [0, 0, 0])],
)
def test_scans_after_the_last_pose_do_not_count_as_missed(tracked: str, missed: list[int]) -> None:
    assert missed_so_far(np.array(list(tracked)) == "1").tolist() == missed


def tracked_at(*poses: int, scans: int = 200) -> Steps:
    """Return the steps of a log of which some scans have a pose."""
    matches = [first_match(100)] * scans
    return Steps(Step(k, k * 100_000_000, match, tracked=k in poses) for k, match in enumerate(matches))


def test_the_tracks_from_several_beginnings_end_when_they_have_missed_too_many_scans_in_all() -> None:
    until, steps = until_missed(np.full(50, 100)), tracked_at(10, 11, 12, scans=50)
    assert [len(list(until(steps))) for _ in range(3)] == [50, 47, 1]


@pytest.mark.parametrize(("most", "missed"), [(0, 0), (2, 2), (9, 3)])
def test_a_track_may_miss_no_more_than_the_first_one_and_than_it_has_poses(most: int, missed: int) -> None:
    assert len(list(until_missed(np.full(200, most))(tracked_at(10, 11, 12)))) == 13 + MORE_MISSED + missed + 1


@pytest.mark.parametrize(("off_m", "yielded"), [(0.04, 60), (0.1, 51), (0.5, 43)])
def test_a_track_ends_where_its_motion_differs_much_from_that_of_the_resampled_track(
    off_m: float, yielded: int
) -> None:
    """From scan 40 on the resampled track moves by ``off_m`` a scan; scan 20 has no pose there."""
    poses = np.zeros((60, 3))
    poses[20], poses[40:, 0] = np.nan, off_m * np.arange(1, 21)
    assert len(list(until_disagreeing(tracked_at(*range(60), scans=60), poses))) == yielded


def test_a_track_that_ends_so_would_be_too_doubtful() -> None:
    values = dict.fromkeys(FEATURES, 0.0) | {DISAGREEMENT: MOST_DISAGREEMENT}
    assert probability(values) > MOST_DOUBT


@pytest.mark.real_logs
def test_a_wrong_track_of_a_thinned_log_is_replaced(real_logs: Path) -> None:
    """One scan in eight of lego_robot4: the first track turns by 90 deg where the arena looks alike."""
    opened = open_log(real_logs / "lego_robot4" / "lego_robot4.mcap", odom="off")
    every = list(opened.scans())
    truth = run_slam(lambda: every, Config(), opened.period_s).trajectory
    found = run_slam(lambda: every[THIN], Config(), 8 * opened.period_s)
    (tried,) = found.remedies
    assert tried.used
    assert tried.doubt_before > 0.9
    assert found.doubt is not None
    assert found.doubt.probability == tried.doubt_after < 0.25
    in_map = Trajectory(truth.stamps_ns[THIN], truth.xyyaw[THIN]).seen_from(truth[THIN.start].inverse())
    assert np.abs(found.trajectory.xyyaw - in_map.xyyaw)[:, :2].max() < 0.05
