"""The budget of work of the searches for a lost laser: counted, not timed, and never more than was earned."""

from __future__ import annotations

from collections import Counter
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam import tracker
from mavnav.slam.matching.budget import (
    CELLS,
    POSES,
    RARELY_SCANS,
    WHOLE_EACH,
    WHOLE_FIRST,
    WIDE_EACH,
    WIDE_FIRST,
    Budget,
    search_work,
)
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.relocalization import STEP_M, around, within_reach, within_reach_of
from mavnav.slam.matching.scan_matching import MatchVerdict
from mavnav.slam.matching.steps import Step
from mavnav.slam.methods.robust import Robust
from mavnav.slam.tracker import TrackState
from support.synthetic import TOUR, along, furnished_rooms, polyline, record, scan_at

ELSEWHERE = polyline((0, 0), (2.2, 0), (3.1, 1.4), (1.2, 2.6), (-0.4, 1.6), closed=True)
LOST = 150


def test_a_search_spends_the_credit_of_scans() -> None:
    budget = Budget(each_scan=2.0, first=5.0, most=20.0)
    assert not budget.spend(8.0)
    assert not budget.is_ready
    budget.earn()
    budget.earn()
    assert budget.is_ready
    assert budget.spend(8.0)
    assert budget.credit == 1.0


def test_a_search_above_the_maximum_credit_leaves_a_negative_one() -> None:
    budget = Budget(each_scan=30.0, first=0.0, most=20.0)
    assert not budget.spend(50.0)
    budget.earn()
    assert budget.credit == 20.0
    assert budget.spend(50.0)
    assert budget.credit == -30.0
    budget.earn()
    assert not budget.spend(1.0)


def test_what_is_lent_comes_back_if_the_scan_is_found() -> None:
    budget = Budget(each_scan=2.0, first=50.0, most=60.0)
    for _ in range(9):
        assert budget.spend(20.0, refundable=True)
        budget.earn(found=True)
    assert budget.credit == 60.0
    assert budget.spend(20.0)
    budget.earn(found=True)
    assert budget.spend(20.0, refundable=True)
    budget.earn()
    budget.earn(found=True)
    assert budget.credit == 26.0


def test_work_is_counted_in_local_searches() -> None:
    assert search_work(0, 0, 6) == 6
    assert search_work(3 * POSES, 2 * CELLS, 1) == 6


def test_discs_about_several_poses_are_searched_once_where_they_overlap() -> None:
    poses = Pose(1.03, 2.0, 0.5), Pose(1.5, 2.31, 0.7), Pose(1.03, 2.0, 0.5)
    xy_m, yaws_rad = within_reach_of(poses, 0.9)
    parts = [within_reach(pose, 0.9) for pose in poses]
    assert len(parts[0][0]) < len(xy_m) < 1.5 * len(parts[0][0])
    assert len(np.unique(np.round(xy_m / STEP_M, 3), axis=0)) == len(xy_m)
    assert (np.diff(xy_m[:, 1]) > -1e-9).all()  # row by row
    for part, _ in parts:
        assert np.hypot(*(part[:, None] - xy_m).T).min(axis=0).max() < STEP_M
    assert yaws_rad.min() <= min(q.min() for _, q in parts) + 1e-9
    assert yaws_rad.max() >= max(q.max() for _, q in parts) - 1e-9


@cache
def lost_steps() -> tuple[list[Step], Counter[str], Robust]:
    """Track a laser that is carried into a room that is not on the map; count the searches there by kind."""
    scans = record(furnished_rooms(), along(TOUR[:3], speed_m_s=0.8)).scans
    counts, method = Counter[str](), Robust(Config())
    stamps_ns = scans[-1].stamp_ns + 100_000_000 * np.arange(1, LOST + 1)
    other = [scan_at(ELSEWHERE, Pose(0.8, 0.8, 0.1e-9 * t), stamp_ns=t) for t in stamps_ns.tolist()]
    wide, whole = method._search_wide, method.relocalize
    method._search_wide = lambda *args: counts.update(wide=1) or wide(*args)  # type: ignore[method-assign]
    method.relocalize = lambda *args: counts.update(whole=1) or whole(*args)  # type: ignore[method-assign]
    return list(tracker.track([*scans, *other], method, Motion(0.1))), counts, method


def test_a_lost_laser_is_searched_as_its_scans_earn() -> None:
    steps, counts, method = lost_steps()
    assert not any(step.tracked for step in steps[-LOST:])
    discs = search_work(len(around(Pose(), 2.5, np.pi)[0]) * 91, 0, 6)
    assert 4 < counts["wide"] < (WIDE_FIRST + WIDE_EACH * len(steps)) / discs + 8  # the first ones are small
    assert 1 <= counts["whole"] <= (WHOLE_FIRST + WHOLE_EACH * len(steps)) / method._whole_budget.work
    assert method._wide_budget.credit >= 0
    assert method._whole_budget.credit >= 0


def test_a_laser_lost_for_long_is_searched_only_when_its_budget_allows() -> None:
    steps = lost_steps()[0][-LOST:]
    searched = [bool(step.match.evaluations) for step in steps]
    assert all(searched[:RARELY_SCANS])
    rarely = searched[RARELY_SCANS + 1 :]
    assert 2 < sum(rarely) < len(rarely) / 4


def test_a_laser_lost_for_long_is_found_at_the_next_search() -> None:
    scans = record(furnished_rooms(), along(TOUR[:3], speed_m_s=0.8)).scans
    stamps_ns = (scans[-1].stamp_ns + 100_000_000 * np.arange(1, LOST + 31)).tolist()
    other = [scan_at(ELSEWHERE, Pose(0.8, 0.8, 0.1e-9 * t), stamp_ns=t) for t in stamps_ns[:LOST]]
    back = [replace(scans[-1], stamp_ns=t) for t in stamps_ns[LOST:]]
    steps = list(tracker.track([*scans, *other, *back], Robust(Config()), Motion(0.1)))
    found = [k for k, step in enumerate(steps[-len(back) :]) if step.tracked]
    assert found[0] < 16
    last = steps[len(scans) - 1].match.map_T_laser
    assert all(last.gap(step.match.map_T_laser)[0] < 0.02 for step in steps[-len(back) :] if step.tracked)


@pytest.mark.slow
def test_with_odometry_every_scan_of_a_laser_lost_for_long_is_searched() -> None:
    scans = record(furnished_rooms(), along(TOUR[:3], speed_m_s=0.8)).scans
    stamps_ns = scans[-1].stamp_ns + 100_000_000 * np.arange(1, LOST + 1)
    other = [scan_at(ELSEWHERE, Pose(0.8, 0.8, 0.1e-9 * t), stamp_ns=t) for t in stamps_ns.tolist()]
    steps = list(tracker.track([*scans, *other], Robust(Config()), Motion(0.1, lambda _: Pose())))
    assert all(step.match.evaluations for step in steps[-LOST:])


def test_without_credit_the_whole_map_is_not_searched() -> None:
    method, scan = Robust(Config()), scan_at(furnished_rooms(), Pose(1.0, 1.0))
    method.insert(scan, Pose(1.0, 1.0), Motion(0.1))
    assert method.reserve_whole_map_search(scan)
    method._whole_budget.credit = 0.0
    assert not method.reserve_whole_map_search(scan)
    blank = Scan(0, np.full(scan.spec.beams, np.nan), scan.spec)
    method._whole_budget.credit = 1e9
    assert not method.reserve_whole_map_search(blank)
    assert not Robust(Config())._whole_budget.spend(1e9)


@pytest.mark.parametrize(
    ("verdict", "missed", "odometry", "expected"),
    [
        (MatchVerdict.PROBABLE, 0, True, True),
        (MatchVerdict.PROBABLE, 9, True, False),
        (MatchVerdict.PROBABLE, 9, False, True),
        (MatchVerdict.REFUSED, 9, False, False),
        (MatchVerdict.REFUSED, 0, False, False),
        (MatchVerdict.REFUSED, 16, True, True),
        (MatchVerdict.REFUSED, 128, False, True),
        (MatchVerdict.SURE, 16, False, False),
    ],
)
def test_when_the_whole_map_is_searched(verdict: MatchVerdict, missed: int, odometry: bool, expected: bool) -> None:
    motion = Motion(0.1, (lambda _: Pose()) if odometry else None)
    assert tracker.needs_whole_map_search(verdict, TrackState(motion, missed=missed)) is expected
