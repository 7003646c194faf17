"""What changed between two maps: planted changes are found where they are, and nothing else is."""

from __future__ import annotations

from math import hypot

import pytest

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import Grid, known_area, occupied_xy_m
from mavnav.metrics.map_difference import Change, View, difference, pair_changes
from mavnav.pose import Pose
from mavnav.sessions.map_alignment import align
from mavnav.slam.matching.prior_map import PriorMap
from support.changed_rooms import DOOR, MOVED, POSES, TURNED, WALL, mapped, other_room, rooms
from support.synthetic import room


@pytest.fixture(scope="module")
def before() -> Grid:
    return mapped(rooms())


def known(grid: Grid) -> PriorMap:
    return PriorMap(known_area(grid), occupied_xy_m(known_area(grid)))


def places(changes: tuple[Change, ...], where: tuple[float, float]) -> list[tuple[str, bool]]:
    return [(change.kind, hypot(change.x_m - where[0], change.y_m - where[1]) < 0.8) for change in changes]


def test_the_same_map_has_not_changed(before) -> None:
    found = difference(View(before), View(mapped(rooms(), seed=1)), Pose())
    assert found.changes == ()
    assert found.same_share > 0.99
    assert found.compared_m2 == pytest.approx(6 * 4 + 3.5 * 2.5, rel=0.15)


@pytest.mark.parametrize("off", [Pose(), Pose(0.04, -0.03, 0.01)], ids=["aligned", "off"])
def test_planted_changes_are_found(before, off) -> None:
    def kinds(where: tuple[float, float], poses: object = POSES, **change: object) -> list[tuple[str, bool]]:
        after = mapped(rooms(**change), seed=1, poses=poses)
        return sorted(places(difference(View(before), View(after), off).changes, where))

    assert kinds(MOVED, moved_m=0.3) == [("gone", True), ("new", True)]
    assert kinds(WALL, wall=True) == [("new", True)]
    assert kinds(DOOR, door=True, poses=[*POSES[:4], *POSES[7:]]) == [("new", True)]


def test_the_share_of_walls_that_are_the_same_is_of_both_maps() -> None:
    empty, full = mapped(room(6.0, 4.0), poses=POSES[:4]), other_room(23)
    shares = [difference(View(a), View(b), Pose()).same_share for a, b in ((empty, full), (full, empty))]
    assert shares[0] == pytest.approx(shares[1], abs=1e-3)


def test_what_one_map_does_not_know_is_no_change(before) -> None:
    """The second room is unknown to the first map, and the wall that was built hides nothing that is gone."""
    few = mapped(rooms(), poses=[POSES[0], POSES[8]])
    assert difference(View(few), View(before), Pose()).changes == ()
    assert difference(View(before), View(few), Pose()).changes == ()
    nothing = Grid(0.02)
    assert difference(View(before), View(nothing), Pose()).changes == ()


def test_a_moved_object_is_one_that_is_gone_and_one_that_is_new() -> None:
    gone, near, far = (Change(k, x, 0.0, 0.1, length, None) for k, x, length in
                       (("gone", 0.0, 1.0), ("new", 0.5, 1.1), ("new", 0.3, 3.0)))  # fmt: skip
    assert [change.moved_with for change in pair_changes([gone, near, far])] == [1, 0, None]
    assert [change.moved_with for change in pair_changes([gone, far])] == [None, None]


def test_maps_of_other_frames_are_aligned_despite_changes(before) -> None:
    after = mapped(rooms(moved_m=0.3, wall=True), TURNED, seed=1)
    alignment, searched_all = align(known(before), known(after), Config())
    assert alignment is not None and searched_all
    off = TURNED.between(alignment.a_T_b)
    assert off.distance_m < 0.01
    assert abs(off.yaw_rad) < 0.005
    changes = difference(View(before), View(after), alignment.a_T_b).changes
    assert sorted(change.kind for change in changes) == ["gone", "new", "new"]
    assert sum(change.moved_with is not None for change in changes) == 2


@pytest.mark.slow
def test_another_room_is_not_aligned(before) -> None:
    other = mapped(room(9.0, 2.2), TURNED, poses=[(1.0, 1.1), (4.0, 1.1), (8.0, 1.0)])
    assert align(known(before), known(other), Config()) == (None, True)


def test_a_place_that_few_scans_find_is_found_from_the_other_map_too() -> None:
    """Scans along two walls fit in the corner of any other room: six of twelve agreed, and none the other way."""
    assert align(known(other_room(23)), known(other_room(27)), Config()) == (None, True)
