"""Poses in a given map that its walls contradict are given up, or a warning says so."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, transform_points
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.prior_map import PriorMap, prior_map_of
from mavnav.slam.matching.scan_matching import first_match, no_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import CHECKING, after
from mavnav.slam.refinement.contradicted import contradicted_stretches, drop_contradicted
from mavnav.slam.track import Track
from support.synthetic import LDS_01, TOUR, Recording, along, furnished_rooms, record

ELSEWHERE = Pose(0.7, 0.5, 0.4)
"""Motion in the map from a right pose to a wrong one."""


@cache
def tour() -> Recording:
    return record(furnished_rooms(), along(TOUR, period_s=0.5), LDS_01)


@cache
def known() -> PriorMap:
    grid = GridBuilder(0.05)
    for k, scan in enumerate(tour().scans):
        pose = tour().world_T_laser[k]
        grid.insert(pose, transform_points(pose, scan.points()))
    return prior_map_of(grid.by_rows(), Pose())


def localised(wrong: range, lost: range) -> Track:
    """Return a track with the true poses, but in ``wrong``, and none in ``lost``."""
    steps = Steps()
    for k, scan in enumerate(tour().scans):
        pose = tour().world_T_laser[k]
        match = no_match(Pose()) if k in lost else first_match(300)._replace(map_T_laser=pose)
        match = match._replace(map_T_laser=ELSEWHERE @ pose) if k in wrong else match
        steps.append(Step(k, scan.stamp_ns, match, tracked=k not in lost))
    method = make_method(Config(), known())
    return Track(lambda: tour().scans, Config(), Motion(0.5), method, steps, known())


def checked(track: Track) -> Track:
    assert track.refiner
    return drop_contradicted(track, track.refiner)


def poses(track: Track) -> list[int]:
    return np.flatnonzero(track.steps.column("tracked")).tolist()


def test_poses_after_a_gap_that_the_map_contradicts_are_given_up() -> None:
    count = len(tour().scans)
    track = checked(localised(wrong=range(30, count), lost=range(20, 30)))
    assert poses(track) == list(range(20))
    (warning,) = track.findings.warnings
    assert warning.startswith(f"the given map contradicts {count - 30} scans (15.0 to ")
    right = localised(wrong=range(0), lost=range(0)).method
    for k, scan in enumerate(tour().scans[:20]):
        right.insert(scan, tour().world_T_laser[k], Motion(0.5))
    np.testing.assert_array_equal(track.method.grid.by_rows().hits, right.grid.by_rows().hits)


def test_a_laser_at_the_right_place_is_left_as_it_is() -> None:
    track = localised(wrong=range(0), lost=range(20, 30))
    assert checked(track) is track


def test_where_the_map_contradicts_all_scans_a_warning_says_so() -> None:
    track = localised(wrong=range(len(tour().scans)), lost=range(20, 30))
    (warning,) = checked(track).findings.warnings
    assert warning.startswith(f"the poses of {len(tour().scans) - 10} scans (0.0 to 9.5 s, 15.0 to ")
    assert poses(checked(track)) == poses(track)


@pytest.mark.parametrize(("share", "found"), [(0.04, ([], [])), (0.08, ([], [1])), (0.12, ([1], [])), (0.2, ([1], []))])
def test_a_stretch_is_given_up_by_its_conflicts(share: float, found: tuple[list[int], list[int]]) -> None:
    assert contradicted_stretches([np.full(30, 0.01), np.full(40, share)]) == found


def test_a_stretch_is_compared_with_the_longest_clean_one() -> None:
    assert contradicted_stretches([np.full(30, 0.045), np.full(5, 0.12)]) == ([], [1])
    assert contradicted_stretches([np.full(9, 0.0), np.full(40, 0.12)]) == ([], [1])


def test_a_laser_that_was_never_lost_is_believed() -> None:
    """A map with noise, or a room full of people, contradicts right poses too."""
    track = localised(wrong=range(len(tour().scans)), lost=range(0))
    assert checked(track) is track


def test_every_run_in_a_given_map_is_checked() -> None:
    track = after(localised(wrong=range(30, len(tour().scans)), lost=range(20, 30)), CHECKING)
    assert poses(track) == list(range(20))
