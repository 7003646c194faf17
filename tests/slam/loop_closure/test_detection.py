"""Loops: found and closed where the way came back, never where another place looks the same, never to a worse map."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import hypot
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec import Struct
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.findings import Loop, Loops
from mavnav.slam.loop_closure import detection
from mavnav.slam.loop_closure.closure import KeyClosure
from mavnav.slam.loop_closure.detection import LOOP_M, detect_closures, find_loops, predicts_better, rows_aside
from mavnav.slam.loop_closure.key_frames import (
    KEPT,
    PART_M,
    RAYS_M,
    KeyFrame,
    KeyFrameMap,
    LocalMaps,
    Visibility,
    drift_bound,
    key_rows,
)
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.robust import Robust
from mavnav.slam.pipeline import finish
from mavnav.slam.track import Track
from support.matches import voxel_means
from support.synthetic import DEG, Segments, along, box, polyline, scan_at

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.slam.loop_closure.detection import Frames

LASER = LaserSpec(-120 * DEG, DEG, 241, 0.05, 5.6)
WRONG_M = 0.3


def doors(ax: float, ay: float, bx: float, by: float, pitch_m: float) -> list[tuple[float, float]]:
    """Return the corners of a wall from a to b, with the same recess of 0.9 x 0.2 m every ``pitch_m``, right-hand."""
    length = hypot(bx - ax, by - ay)
    ux, uy = (bx - ax) / length, (by - ay) / length
    points = [(ax, ay)]
    for at in np.arange(0.5 * pitch_m, length - 1.0, pitch_m):
        for t, d in ((at, 0.0), (at, 0.2), (at + 0.9, 0.2), (at + 0.9, 0.0)):
            points.append((ax + ux * t + uy * d, ay + uy * t - ux * d))
    return points


def ring() -> Segments:
    """Return a ring corridor of 8 x 6 m, 1.6 m wide, no side of which looks like another."""
    outer = [(0, 0), (2.6, 0), (2.6, -0.2), (3.5, -0.2), (3.5, 0), (5.4, 0), (5.4, 0.25), (5.7, 0.25), (5.7, 0), (8, 0),
             (8, 2.2), (8.3, 2.2), (8.3, 3.4), (8, 3.4), (8, 6), (3.1, 6), (3.1, 5.75), (2.8, 5.75), (2.8, 6), (0, 6),
             (0, 2.3), (0.2, 2.3), (0.2, 2), (0, 2)]  # fmt: skip
    return np.vstack(
        (polyline(*outer, closed=True), polyline((1.6, 1.6), (6.4, 1.6), (6.4, 4.4), (1.6, 4.4), closed=True))
    )


def ring_of_doors() -> Segments:
    """Return a square ring corridor, all four sides the same, with the same door every 1.6 m."""
    corners = [(0, 0), (8, 0), (8, 8), (0, 8), (0, 0)]
    outer = [p for a, b in pairwise(corners) for p in doors(*a, *b, 1.6)]
    return np.vstack(
        (polyline(*outer, closed=True), polyline((1.6, 1.6), (6.4, 1.6), (6.4, 6.4), (1.6, 6.4), closed=True))
    )


def corridor_of_doors() -> Segments:
    """Return a dead end of 14 m with the same door every 2 m on both sides."""
    return polyline(*doors(0, 0, 14, 0, 2.0), (14, 0), *doors(14, 1.8, 0, 1.8, 2.0), (0, 1.8), closed=True)


def twin_rooms() -> Segments:
    """Return two identical furnished rooms on a corridor with a door of its own."""
    outline = [(0, 0), (4, 0), (4, 3), (2.4, 3), (2.4, 3.1), (8.6, 3.1), (8.6, 3), (7, 3), (7, 0), (11, 0), (11, 3),
               (9.5, 3), (9.5, 3.1), (11, 3.1), (11, 4.5), (6.2, 4.5), (6.2, 4.7), (5.3, 4.7), (5.3, 4.5), (0, 4.5),
               (0, 3.1), (1.5, 3.1), (1.5, 3), (0, 3)]  # fmt: skip
    boxes = [box(x + dx, y, w, d) for x in (0, 7) for dx, y, w, d in ((0.6, 0.5, 0.6, 0.5), (3.3, 0.4, 0.9, 0.6))]
    return np.vstack((polyline(*outline, closed=True), *boxes))


def plain_ring() -> Segments:
    """Return a ring of plain corridors, 1.6 m wide; once round its middle are 55.6 m."""
    sides = [((0, 0), (18, 13)), ((1.6, 1.6), (16.4, 11.4))]
    return np.vstack([polyline((x, y), (u, y), (u, v), (x, v), closed=True) for (x, y), (u, v) in sides])


ROUND = [(0.8, 0.8), (7.2, 0.8), (7.2, 5.2), (0.8, 5.2), (0.8, 0.9), (2.5, 0.8)]
ROUND_DOORS = [(0.8, 0.8), (7.2, 0.8), (7.2, 7.2), (0.8, 7.2), (0.8, 0.9), (2.5, 0.8)]
THERE_AND_BACK = [(1.0, 0.9), (12.8, 0.9), (12.7, 0.8), (1.2, 0.9)]
ROUND_PLAIN = [(9, 0.8), (17.2, 0.8), (17.2, 12.2), (0.8, 12.2), (0.8, 0.8), (9.5, 0.8)]
ROOM_TO_ROOM = [(2, 1.5), (1.95, 3.8), (9.05, 3.8), (9, 1.5), (9.1, 3.7), (1.95, 3.8), (2, 1.5)]


class Walk(Struct, frozen=True):
    """A true path through a world, and the scans that belong to it; frame of the first pose."""

    walls: Segments
    world_T_laser: Trajectory

    @property
    def truth(self) -> Trajectory:
        return self.world_T_laser.seen_from(self.world_T_laser[0].inverse())

    def points_of(self, seed: int, rows: list[int]) -> list[np.ndarray]:
        rng = np.random.default_rng(seed)
        scans = [scan_at(self.walls, self.world_T_laser[row], LASER, noise=0.01, rng=rng) for row in rows]
        return [voxel_means(scan.points(), 0.03) for scan in scans]

    def drifted(self, step: Pose, seed: int | None = None) -> Trajectory:
        """Return a track of the path in which every step is off by a motion, or by random shares of it."""
        rng, truth = np.random.default_rng(seed or 0), self.truth
        poses = [truth[0]]
        bias = rng.standard_normal(3) if seed is not None else np.ones(3)
        for k in range(1, len(truth)):
            off = bias * step.as_array()
            poses.append(poses[-1] @ truth[k - 1].between(truth[k]) @ Pose(*map(float, off)))
        return Trajectory.of(truth.stamps_ns.tolist(), poses)

    def sheared(self, off_m: tuple[float, float]) -> Trajectory:
        """Return a track that is off by a translation at its end, and before in proportion to the path."""
        truth = self.truth
        share = np.concatenate(([0.0], np.hypot(*np.diff(truth.xyyaw[:, :2], axis=0).T).cumsum()))
        xyyaw = truth.xyyaw.copy()
        xyyaw[:, :2] += np.outer(share / share[-1], off_m)
        return Trajectory(truth.stamps_ns.copy(), xyyaw)

    def closed(self, tracked: Trajectory, seed: int = 0) -> Loops:
        return find_loops(tracked, lambda rows: self.points_of(seed, rows), observable, Config())

    def wrong(self, loops: Loops) -> list[float]:
        """Return how far off the closures are that join different places, m."""
        off = [self.truth[c.start].between(self.truth[c.end]).between(c.start_T_end).distance_m for c in loops.closed]
        return [m for m in off if m > WRONG_M]


def observable(points: np.ndarray, _pose: Pose) -> np.ndarray:
    """Return the information of points on walls of all directions."""
    return 0.5 * len(points) * np.array([1.0, 0.0, 1.0, 0.0, 0.0, 1.0])


@cache
def walk(name: str) -> Walk:
    walls, way = {
        "ring": (ring(), ROUND),
        "plain ring": (plain_ring(), ROUND_PLAIN),
        "ring of doors": (ring_of_doors(), ROUND_DOORS),
        "corridor of doors": (corridor_of_doors(), THERE_AND_BACK),
        "twin rooms": (twin_rooms(), ROOM_TO_ROOM),
    }[name]
    return Walk(walls, along(way, period_s=0.4, turn_rad_s=1.5))


def rmse_m(a: Trajectory, b: Trajectory) -> float:
    return float(np.sqrt((np.hypot(*(a.xyyaw - b.xyyaw)[:, :2].T) ** 2).mean()))


def test_a_ring_is_closed() -> None:
    ring_walk = walk("ring")
    tracked = ring_walk.drifted(Pose(0.0, 0.0, 0.12 * DEG))
    loops = ring_walk.closed(tracked)
    assert len(loops.closed) >= 2
    assert not ring_walk.wrong(loops)
    assert max(c.correction.distance_m for c in loops.closed) > 0.3
    assert loops.map_T_laser is not None
    assert rmse_m(loops.map_T_laser, ring_walk.truth) < 0.35 * rmse_m(tracked, ring_walk.truth)


@pytest.mark.slow
def test_a_loop_is_closed_across_a_plain_corridor_and_left_as_tracked_along_it() -> None:
    ring_walk = walk("plain ring")
    tracked = ring_walk.sheared((0.2, 0.63))
    loops = ring_walk.closed(tracked)
    assert len(loops.closed) >= 3
    assert all(abs(c.correction.y_m + 0.62) < 0.05 for c in loops.closed)
    assert all(abs(c.correction.x_m) < 0.05 for c in loops.closed)
    assert loops.map_T_laser is not None
    end, truth, before = (t.xyyaw[-1] for t in (loops.map_T_laser, ring_walk.truth, tracked))
    assert abs(end[1] - truth[1]) < 0.06
    assert abs(end[0] - before[0]) < 0.05


def test_a_good_track_round_plain_corridors_stays_as_it_is() -> None:
    ring_walk = walk("plain ring")
    assert ring_walk.closed(ring_walk.truth).map_T_laser is None


def test_a_good_track_stays_as_it_is() -> None:
    ring_walk = walk("ring")
    loops = ring_walk.closed(ring_walk.truth)
    assert len(loops.closed) >= 2
    assert loops.map_T_laser is None


def test_only_a_track_that_sparse_searches_do_not_confirm_is_searched_densely(monkeypatch: pytest.MonkeyPatch) -> None:
    back, searched = walk("corridor of doors"), list[tuple[float, ...]]()

    def counting(keys: list[KeyFrame], known: list, local: LocalMaps, config: Config, *least_m: float) -> Iterator:
        searched.append(least_m)
        return detect_closures(keys, known, local, config, *least_m)

    monkeypatch.setattr(detection, "detect_closures", counting)
    assert len(back.closed(back.truth).closed) >= 2
    assert searched == [(detection.FAR_SEARCH_M,)]
    back.closed(back.sheared((0.1, 0.2)))
    assert searched[1:3] == [(detection.FAR_SEARCH_M,), ()]


def test_a_path_that_never_comes_back_reads_no_scan() -> None:
    n = 60
    straight = Trajectory.of(list(range(n)), [Pose(0.5 * k, 0.0, 0.0) for k in range(n)])

    def points_of(rows: list[int]) -> list[np.ndarray]:
        raise AssertionError(rows)

    assert find_loops(straight, points_of, observable, Config()) == Loops()


def test_no_pose_and_one_pose_are_no_loop() -> None:
    assert find_loops(Trajectory.of([], []), lambda _: [], observable, Config()) == Loops()
    assert find_loops(Trajectory.of([0], [Pose()]), lambda _: [], observable, Config()) == Loops()


def test_a_run_that_is_stopped_before_its_loops_are_found_has_none() -> None:
    ring_walk = walk("ring")
    drifted = ring_walk.drifted(Pose(0.0, 0.0, 0.12 * DEG))
    assert find_loops(drifted, lambda rows: ring_walk.points_of(0, rows[:3]), observable, Config()) == Loops()


def closures_without_a_wrong_one(name: str, seed: int) -> int:
    """Close loops after a random drift, some of it beyond what is allowed for."""
    there = walk(name)
    loops = there.closed(there.drifted(Pose(0.006, 0.0, 0.1 * DEG), seed), seed)
    assert not there.wrong(loops)
    return len(loops.closed)


@pytest.mark.parametrize("name", ["ring of doors", "corridor of doors", "twin rooms"])
def test_no_closure_joins_places_that_look_the_same(name: str) -> None:
    assert sum(closures_without_a_wrong_one(name, seed) for seed in (0, 1)) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ring of doors", "corridor of doors", "twin rooms"])
def test_no_closure_joins_places_that_look_the_same_in_20_seeds(name: str) -> None:
    assert sum(closures_without_a_wrong_one(name, seed) for seed in range(20)) > 20


def test_key_frames_follow_path_and_turning() -> None:
    still = np.zeros((50, 3))
    assert key_rows(still) == ([0], [0.0])
    turning = np.column_stack((np.zeros((10, 2)), np.arange(10) * 10 * DEG))
    assert key_rows(turning)[0] == [0, 2, 4, 6, 8]
    moving = np.column_stack((np.arange(10) * 0.2, np.zeros((10, 2))))
    rows, paths_m = key_rows(moving)
    assert rows == [0, 2, 4, 6, 8]
    np.testing.assert_allclose(paths_m, [0, 0.4, 0.8, 1.2, 1.6])


def test_the_reference_key_frame_saw_the_same_walls_even_from_farther_away() -> None:
    wall = np.column_stack((np.linspace(3.0, 5.0, 30), np.full(30, 1.0)))
    other = wall + np.array([0.0, 3.0])
    seen = [(Pose(-1.0, 0.0, 0.0), wall), (Pose(0.1, 0.0, 0.0), other), (Pose(-2.0, 0.0, 0.0), wall)]
    keys = [KeyFrame(k, float(k), xy_m - (pose.x_m, pose.y_m), pose) for k, (pose, xy_m) in enumerate(seen)]
    seen_by = Visibility(keys, LocalMaps(keys, Config()))
    seen_by.grow(3)
    assert seen_by.reference(KeyFrame(9, 30.0, wall, Pose())) == 0


def test_the_bound_of_the_drift_grows_and_ends() -> None:
    bounds = np.array([drift_bound(path_m) for path_m in (LOOP_M, 20.0, 50.0, 500.0)])
    assert (np.diff(bounds, axis=0) >= 0).all()
    np.testing.assert_array_equal(bounds[-1], drift_bound(1e6))


def track_of(walk: Walk, tracked: Trajectory, rows: range) -> tuple[list[Scan], list[Step], Robust]:
    """Draw a map of scans at the poses of a trajectory, as a tracker that drifted would have."""
    method = Robust(Config())
    scans = [scan_at(walk.walls, walk.world_T_laser[k], LASER, stamp_ns=int(tracked.stamps_ns[k])) for k in rows]
    steps = Steps()
    for index, (row, scan) in enumerate(zip(rows, scans, strict=True)):
        method.insert(scan, tracked[row], Motion(0.4))
        match = first_match(241)._replace(map_T_laser=tracked[row])
        steps.append(Step(index, scan.stamp_ns, match, tracked=True))
    return scans, steps, method


def test_the_map_is_drawn_anew_with_the_loop_closed() -> None:
    ring_walk = walk("ring")
    drifted = ring_walk.drifted(Pose(0.0, 0.0, 0.12 * DEG))
    rows = range(len(drifted))
    scans, steps, method = track_of(ring_walk, drifted, rows)
    drawn = method.grid.hits.sum()
    on = finish(Track(lambda: scans, Config(), Motion(0.4), method, steps))
    off = finish(Track(lambda: scans, Config(loop_closure="off"), Motion(0.4), method, steps))
    assert on.loops.closed
    assert not off.loops.closed
    assert rmse_m(on.trajectory, ring_walk.truth) < 0.35 * rmse_m(off.trajectory, ring_walk.truth)
    assert np.count_nonzero(on.grid.hits) < 0.9 * np.count_nonzero(off.grid.hits)
    assert on.grid.hits.sum() == drawn


def key_frames_of(walk: Walk, tracked: Trajectory, aside: bool = False) -> list[KeyFrame]:
    rows, paths_m = key_rows(tracked.xyyaw)
    some = sorted(rows_aside(rows)) if aside else rows
    parts = zip(some, np.interp(some, rows, paths_m).tolist(), walk.points_of(0, some), strict=True)
    return [KeyFrame(row, path_m, points, tracked[row]) for row, path_m, points in parts]


def at_poses_of(frames: Frames, path: Trajectory) -> Frames:
    keys, others = ([replace(frame, map_T_laser=path[frame.row]) for frame in some] for some in frames)
    return keys, others


def test_a_closed_loop_predicts_the_scans_that_took_no_part_and_a_bent_one_does_not() -> None:
    ring_walk = walk("ring")
    tracked = ring_walk.drifted(Pose(0.0, 0.0, 0.12 * DEG))
    drifted = key_frames_of(ring_walk, tracked), key_frames_of(ring_walk, tracked, aside=True)
    right, local = at_poses_of(drifted, ring_walk.truth), LocalMaps(drifted[0], Config())
    assert predicts_better(drifted, right, local, Config())
    assert not predicts_better(right, drifted, local, Config())
    assert not predicts_better(right, right, local, Config())


def test_no_scan_that_tests_the_closures_is_a_key_frame_unless_there_is_no_other() -> None:
    assert rows_aside([0, 4, 5, 8]) == {2, 6}
    assert rows_aside([0, 1, 2, 3, 4]) == {1, 3}
    ring_walk = walk("ring")
    tracked = ring_walk.drifted(Pose(0.0, 0.0, 0.12 * DEG))
    aside, loops = rows_aside(key_rows(tracked.xyyaw)[0]), ring_walk.closed(tracked)
    assert loops.graph is not None
    assert not aside.intersection(loops.graph.rows)


def test_a_correction_that_predicts_worse_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ring_walk = walk("ring")
    keys = key_frames_of(ring_walk, ring_walk.truth)
    bent = [replace(key, map_T_laser=key.map_T_laser @ Pose(0.0, 0.01 * k, 0.0)) for k, key in enumerate(keys)]
    wrong, right = (
        KeyClosure(0, 60, keys[0].map_T_laser.between(some[60].map_T_laser), first_match(9), np.ones(6))
        for some in (bent, keys)
    )
    monkeypatch.setattr(detection, "find_closures", lambda *_: (bent, [wrong, wrong, right], 3))
    loops = ring_walk.closed(ring_walk.truth)
    assert loops.map_T_laser is None
    assert loops.refused == 5
    assert [loop.correction.distance_m for loop in loops.closed] == pytest.approx([0.0])  # confirms the track


def test_a_search_that_fits_nowhere_is_no_refused_loop() -> None:
    ring_walk, other = walk("ring"), walk("twin rooms")
    half = len(ring_walk.truth) // 2

    def points_of(rows: list[int]) -> list[np.ndarray]:
        seen = ring_walk.points_of(0, rows)
        elsewhere = other.points_of(0, [row % 20 for row in rows])
        return [there if row > half else here for row, here, there in zip(rows, seen, elsewhere, strict=True)]

    loops = find_loops(ring_walk.truth, points_of, observable, Config())
    assert loops.graph is not None  # loops were searched
    assert (loops.closed, loops.refused) == ((), 0)


def test_a_local_map_is_that_of_its_part_of_the_path_wherever_the_path_lies() -> None:
    ring_walk = walk("ring")
    keys = key_frames_of(ring_walk, ring_walk.truth)
    moved = [replace(key, map_T_laser=Pose(3.0, -2.0, 0.7) @ key.map_T_laser) for key in keys]
    middle, part = LocalMaps(keys, Config()).part_at(20)
    again, same = LocalMaps(moved, Config()).part_at(20)
    assert middle == again
    assert abs(keys[middle].path_m - keys[20].path_m) <= PART_M
    near = [key for key in keys if abs(key.path_m - keys[middle].path_m) <= 1.5 * PART_M]
    slow = KeyFrameMap(Config())
    slow.grow([replace(k, map_T_laser=keys[middle].map_T_laser.between(k.map_T_laser)) for k in near], len(near))
    assert part.lines.count == slow.lines.count
    start = keys[middle].map_T_laser.between(keys[20].map_T_laser).as_array()
    costs = [some.lines.costs(keys[20].points, start[None, :2], start[2:], 0.15)[0, 0] for some in (part, same, slow)]
    assert costs[0] == costs[2]
    assert costs[1] == pytest.approx(costs[0], abs=2e-5)


def test_few_local_maps_are_kept_and_drawn_again_when_needed() -> None:
    ring_walk = walk("ring")
    keys = key_frames_of(ring_walk, ring_walk.truth)
    far = [replace(key, path_m=50.0 * k) for k, key in enumerate((2 * keys)[: KEPT + 1])]
    local = LocalMaps(far, Config())
    first = local.part_at(0)[1]
    assert local.part_at(0)[1] is first
    for k in range(len(far)):
        local.part_at(k)
    assert local.part_at(0)[1] is not first
    assert local.part_at(0)[1].lines.count == first.lines.count


def test_local_maps_draw_free_space_up_to_a_range() -> None:
    wall = KeyFrame(0, 0.0, np.array([[RAYS_M - 0.5, 0.0], [0.0, RAYS_M + 0.5]]), Pose())
    part = LocalMaps([wall], Config()).part_at(0)[1]
    assert part.lines.count == 1 + 2
    assert part.grid.hits.sum() == 1


def test_a_run_that_is_stopped_while_its_map_is_drawn_anew_keeps_the_old_one(monkeypatch: pytest.MonkeyPatch) -> None:
    ring_walk = walk("ring")
    rows = range(0, len(ring_walk.truth), 4)
    scans, steps, method = track_of(ring_walk, ring_walk.drifted(Pose(0.0, 0.0, 0.12 * DEG)), rows)
    right = Trajectory.of([s.stamp_ns for s in scans], [ring_walk.truth[row] for row in rows])
    monkeypatch.setattr(
        detection, "find_loops", lambda *_: Loops((Loop(0, 5, Pose(), Pose(0.5, 0, 0), 0.9),), 3, right)
    )
    before = method.grid.by_rows()
    outcome = finish(Track(lambda: scans[:5], Config(), Motion(0.4), method, steps))
    assert outcome.loops == Loops()
    np.testing.assert_array_equal(outcome.grid.passes, before.passes)
    assert len(outcome.trajectory) == len(scans)
    assert outcome.steps is steps  # of a long log two would take twice the memory
