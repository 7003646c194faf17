"""Believed at once, believed when the next scans agree, or not at all."""

from __future__ import annotations

import pytest

from mavnav.pose import Pose
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.relocalization import AGREEING_SCANS
from mavnav.slam.matching.scan_matching import MatchVerdict
from mavnav.slam.tracker import TrackState

MS = 1_000_000
HERE, THERE = Pose(1.0, 0.0, 0.0), Pose(4.0, 2.0, 1.0)


@pytest.fixture
def belief() -> TrackState:
    return TrackState(Motion(0.1).started_at(Pose(), 0))


def test_a_sure_match_moves_the_belief(belief: TrackState) -> None:
    after = belief.after(MatchVerdict.SURE, HERE, 100 * MS)
    assert (after.motion.map_T_laser, after.missed) == (HERE, 0)


def test_a_refused_match_leaves_it_where_it_was(belief: TrackState) -> None:
    after = belief.after(MatchVerdict.REFUSED, HERE, 100 * MS).after(MatchVerdict.REFUSED, HERE, 200 * MS)
    assert (after.motion, after.missed) == (belief.motion, 2)


def test_a_place_found_again_is_believed_when_the_next_scans_agree(belief: TrackState) -> None:
    trial = belief.after(MatchVerdict.PROBABLE, THERE, 0)
    for k in range(1, AGREEING_SCANS):
        assert trial.here.map_T_laser == THERE
        assert trial.motion == belief.motion
        trial = trial.after(MatchVerdict.SURE, THERE, k * 100 * MS)
    assert trial.motion.map_T_laser == THERE
    assert (trial.trial, trial.missed) == (None, 0)


def test_a_trial_that_fails_leaves_the_old_belief(belief: TrackState) -> None:
    after = belief.after(MatchVerdict.PROBABLE, THERE, 0).after(MatchVerdict.REFUSED, THERE, 100 * MS)
    assert (after.here, after.confirmations, after.missed) == (belief.motion, 0, 2)
