"""Loop closure: find where the laser returned to a place after a long path, correct the path, and rebuild the map.

Key frames of the track are matched against the old part of the map, which was seen a long path before. A match at
exactly one pose within the drift bound, which agrees with other closures, is a closure (Olson 2009, "Recognizing places
using spectrally clustered local matches", on the consistency of closures). A pose graph then distributes the
corrections over the path (docs/method.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory, blend
from mavnav.profiling import as_stage
from mavnav.slam.findings import Edge, Loop, Loops, PoseGraph
from mavnav.slam.loop_closure.closure import KeyClosure, agreeing_closures, find_closure, is_small
from mavnav.slam.loop_closure.key_frames import (
    KEY_M,
    PART_M,
    KeyFrame,
    KeyFrameMap,
    LocalMaps,
    Visibility,
    drift_bound,
    key_rows,
    shortest_path,
)
from mavnav.slam.loop_closure.pose_graph import InformationOf, optimize, path_edges
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Steps, tracked_trajectory
from mavnav.slam.methods.registry import Refiner, make_method
from mavnav.slam.track import LogScans, Track

PointsOf = Callable[[list[int]], Iterable[NDArray[np.float64]]]
"""Rows of a trajectory -> the match points (n, 2) of their scans, m, laser frame."""
Frames = tuple[Sequence[KeyFrame], Sequence[KeyFrame]]
"""The key frames, and the scans that take no part, at the poses of one track."""


LOOP_M = 8.0
"""Minimum path of a loop: for shorter ones the tracker itself keeps the map consistent."""

FAR_SEARCH_M = 2.5
"""Path between two searches while closures confirm the track or no closure is found."""

MOST_FAILED = 40
"""Number of successive searches without a closure after which they become sparse, or end if they are."""

SIGHT_M = 4.0
"""Largest distance, besides the drift bound, of old key frames that may have seen the same walls."""

SMALL_SHARE, FAR_OFF = 0.95, 3.0
"""The track does not change if this share of its closures is small, and none exceeds the bounds by this factor."""

ROUNDS = 3
"""Maximum number of rounds: a closed loop can bring other closures within the bounds."""


@as_stage("loops")
def find_loops(map_T_laser: Trajectory, points_of: PointsOf, information_of: InformationOf, config: Config) -> Loops:
    """Find the loops of a track, and correct the path between their ends.

    ``map_T_laser`` holds the tracked poses. ``points_of`` returns the match points (n, 2) of the scans of given rows,
    m, laser frame; it is not called if the path never returns. If it returns fewer, because the run is stopped, no loop
    is searched. ``information_of`` returns the information of the track's map about a pose.
    """
    rows, paths_m = key_rows(map_T_laser.xyyaw)
    places = list(zip(map_T_laser.xyyaw[rows, :2], paths_m, strict=True))
    if all(nearest_old(map_T_laser.xyyaw[rows, :2], np.array(paths_m), *place) is None for place in places):
        return Loops()
    aside = rows_aside(rows)
    frames = read_frames(map_T_laser, sorted(aside.union(rows)), (rows, paths_m), points_of)
    if not frames:
        return Loops()
    tracked, testing = ([frame for frame in frames if (frame.row in aside) == tests] for tests in (False, True))
    path, local = path_edges(map_T_laser, tracked, information_of), LocalMaps(tracked, config)
    keys, closures, refused = find_closures(tracked, path, local, config)
    corrected = None if keys is tracked else follow(map_T_laser, tracked, keys)
    if corrected is not None:
        tested = [replace(frame, map_T_laser=corrected[frame.row]) for frame in testing]
        if not predicts_better((tracked, testing), (keys, tested), local, config):
            confirming = [closure for closure in closures if is_small(closure.correction(tracked))]
            corrected, closures, refused = None, confirming, refused + len(closures) - len(confirming)
    closed = tuple(
        Loop(tracked[c.start].row, tracked[c.end].row, c.start_T_end, c.correction(tracked), c.match.inliers)
        for c in closures
    )
    graph = PoseGraph(tuple(key.row for key in tracked), (*path, *edges_of(closures)))
    return Loops(closed, refused, corrected, graph)


def rows_aside(rows: Sequence[int]) -> set[int]:
    """Return the rows of scans that take no part: half-way between key frames, or else every other key frame."""
    return {(a + b) // 2 for a, b in pairwise(rows) if b - a > 1} or set(rows[1::2])


def read_frames(
    map_T_laser: Trajectory, rows: list[int], path_m: tuple[list[int], list[float]], points_of: PointsOf
) -> list[KeyFrame]:
    """Return the scans of some rows; none if the run is stopped. ``path_m`` is the path at the rows of key frames."""
    parts = zip(rows, np.interp(rows, *path_m).tolist(), points_of(rows), strict=False)
    frames = [KeyFrame(row, at_m, points, map_T_laser[row]) for row, at_m, points in parts]
    return frames if len(frames) == len(rows) else []


def find_closures(
    tracked: list[KeyFrame], path: list[Edge], local: LocalMaps, config: Config
) -> tuple[list[KeyFrame], list[KeyClosure], int]:
    """Return the corrected key frames, the closures that agree, and the number of those that are refused.

    Sparse searches come first: most tracks are confirmed by them, or fit nowhere. A key frame keeps the closure of an
    earlier round where the later one, which is sparser, does not search it.
    """
    searches = list(detect_closures(tracked, (), local, config, FAR_SEARCH_M))
    sparse = [closure for closure in searches if closure]
    closures = consistent_closures(sparse, tracked, tracked)
    if (closures or len(searches) >= MOST_FAILED) and track_confirmed([c.correction(tracked) for c in closures]):
        return tracked, closures, len(sparse) - len(closures)
    keys, closures, refused = tracked, list[KeyClosure](), 0
    for _ in range(ROUNDS):
        latest = {c.end: c for c in (*closures, *detect_closures(keys, closures, local, config)) if c}
        agreed = consistent_closures(list(latest.values()), keys, tracked)
        if len(agreed) < len(closures):
            break
        closures, refused = agreed, len(latest) - len(agreed)
        if track_confirmed([closure.correction(keys) for closure in closures]):
            break
        poses = optimize([key.map_T_laser for key in tracked], [*path, *edges_of(closures)])
        keys = [replace(key, map_T_laser=pose) for key, pose in zip(tracked, poses, strict=True)]
    return keys, closures, refused


def consistent_closures(
    closures: Sequence[KeyClosure], keys: Sequence[KeyFrame], tracked: Sequence[KeyFrame]
) -> list[KeyClosure]:
    """Return the closures that agree; weak ones never refute others, and count only if they correct the track."""
    full = agreeing_closures([c for c in closures if c.weak_rad is None], keys)  # constrained in all directions
    weak = agreeing_closures([c for c in closures if c.weak_rad is not None], keys, full)
    return sorted(full + [c for c in weak if not is_small(c.correction(tracked))], key=lambda c: c.end)


def nearest_old(
    xy_m: NDArray[np.float64], paths_m: NDArray[np.float64], at_m: NDArray[np.float64], path_m: float
) -> int | None:
    """Return the old key frame nearest to a position (2,); None if none is near enough to have seen the same walls.

    ``xy_m`` (n, 2) and ``paths_m`` (n,) are the positions of the key frames, and the path up to each.
    """
    old = int(np.searchsorted(paths_m, path_m - LOOP_M))
    if not old:
        return None
    off_m = np.hypot(*(xy_m[:old] - at_m).T)
    i = int(np.argmin(off_m))
    return i if off_m[i] <= SIGHT_M + drift_bound(path_m - float(paths_m[i]))[0] else None


def detect_closures(
    keys: Sequence[KeyFrame], known: Sequence[KeyClosure], local: LocalMaps, config: Config, least_m: float = KEY_M
) -> Iterator[KeyClosure | None]:
    """Search key frames in the old part of the map; yield the closures, also those of no agreement, None without one.

    Searches are ``least_m`` of path apart or more. They are dense at first and sparse where closures confirm the track,
    which also bounds the drift from there on; so do those ``known``. Weak closures confirm nothing, because the drift
    along a corridor stays unknown. Where there can be little drift, local maps are searched, else the map of all.
    """
    old, seen, pace = KeyFrameMap(config), Visibility(keys, local), Pace()
    across = [(keys[each.start].path_m, keys[each.end].path_m) for each in known if each.weak_rad is None]
    xy_m, paths_m = np.array([k.map_T_laser[:2] for k in keys]), np.array([k.path_m for k in keys])
    for j, key in enumerate(keys):
        i = nearest_old(xy_m, paths_m, xy_m[j], key.path_m) if key.path_m >= pace.next_m else None
        if i is None:
            continue
        count = int(np.searchsorted(paths_m, key.path_m - LOOP_M))
        seen.grow(count)
        bound = drift_bound(shortest_path(keys[i].path_m, key.path_m, across))
        if wide := bound[0] > PART_M:
            old.grow(keys, count)
        closure = find_closure(keys, j, old if wide else None, seen, bound, config)
        confirms = closure is not None and closure.weak_rad is None and is_small(closure.correction(keys))
        pace = pace.after(key.path_m, least_m, failed=closure is None, confirms=confirms)
        if closure and confirms:
            across.append((keys[closure.start].path_m, key.path_m))
        yield closure


class Pace(NamedTuple):
    """When to search next: the path length ``next_m``, and the successive failed searches so far."""

    next_m: float = 0.0
    failures: int = 0

    def after(self, path_m: float, least_m: float, *, failed: bool, confirms: bool) -> Pace:
        """Return the pace after a search that failed, or found a closure that confirms the track, or corrects it."""
        failures = self.failures + 1 if failed else 0
        return Pace(path_m + (FAR_SEARCH_M if confirms or failures >= MOST_FAILED else least_m), failures)


def predicts_better(before: Frames, after: Frames, local: LocalMaps, config: Config) -> bool:
    """Return whether scans that took no part fit better to what was seen a long path before, at the poses ``after``."""
    worst_m, gain_m2 = config.robust.expert.truncate_m, 0.0
    for j, i in sorted({*revisits(before, local), *revisits(after, local)}):
        (middle, part), points = local.part_at(i), before[1][j].points
        poses = np.array([keys[middle].map_T_laser.between(others[j].map_T_laser) for keys, others in (before, after)])
        costs = [part.lines.costs(points, pose[None, :2], pose[2:], worst_m)[0, 0] for pose in poses]
        gain_m2 += costs[0] - costs[1]
    return gain_m2 > 0.0


def revisits(frames: Frames, local: LocalMaps) -> Iterator[tuple[int, int]]:
    """Yield the scans that take no part, each with the key frame of a long path before that saw most of the same."""
    keys, others = frames
    xy_m, paths_m = np.array([k.map_T_laser[:2] for k in keys]), np.array([k.path_m for k in keys])
    seen = Visibility(keys, local)
    for j, frame in enumerate(others):
        if nearest_old(xy_m, paths_m, np.array(frame.map_T_laser[:2]), frame.path_m) is not None:
            seen.grow(int(np.searchsorted(paths_m, frame.path_m - LOOP_M)))
            yield j, seen.reference(frame)


def track_confirmed(corrections: Sequence[Pose]) -> bool:
    """Return whether the corrections are so small that the track should not change."""
    few = sum(not is_small(correction) for correction in corrections) <= (1.0 - SMALL_SHARE) * len(corrections)
    return few and all(is_small(correction, FAR_OFF) for correction in corrections)


def edges_of(closures: Sequence[KeyClosure]) -> list[Edge]:
    """Return closures as edges of the pose graph."""
    return [Edge(c.start, c.end, c.start_T_end, c.sqrt_information) for c in closures]


def follow(map_T_laser: Trajectory, tracked: Sequence[KeyFrame], keys: Sequence[KeyFrame]) -> Trajectory:
    """Correct all poses with the key frames: each pose keeps its position relative to the two key frames around it."""
    rows = np.array([key.row for key in tracked])
    poses = []
    for row in range(len(map_T_laser)):
        a = int(np.searchsorted(rows, row, side="right")) - 1
        b = min(a + 1, len(rows) - 1)
        share = (row - rows[a]) / max(rows[b] - rows[a], 1)
        from_a, from_b = (keys[k].map_T_laser @ tracked[k].map_T_laser.between(map_T_laser[row]) for k in (a, b))
        poses.append(blend(from_a, from_b, float(share)))
    return Trajectory.of(map_T_laser.stamps_ns.tolist(), poses)


def close_loops(track: Track, refiner: Refiner) -> Track:
    """Close loops and rebuild the map; the track does not change without loops, or if the run is stopped early."""
    steps, config = track.steps, track.config
    if not refiner.builds_map or config.loop_closure != "auto":
        return track
    if track.on_step:
        track.on_step("close loops", 0)
    points = partial(points_of, track.log_scans, steps, refiner)
    loops = find_loops(tracked_trajectory(steps), points, partial(information_of, refiner), config)
    if loops.map_T_laser is None:
        return track.with_findings(loops=loops)
    rebuilt = rebuild_at(track, loops.map_T_laser)
    return rebuilt.with_findings(loops=loops) if rebuilt else track


def rebuild_at(track: Track, map_T_laser: Trajectory) -> Track | None:
    """Return the track with these poses, and its map drawn at them; None if the run is stopped early."""
    poses, inserted = (map_T_laser[row] for row in range(len(map_T_laser))), 0
    moved = (s._replace(match=s.match._replace(map_T_laser=next(poses))) if s.tracked else s for s in track.steps)
    rebuilt = replace(track, steps=Steps(moved), method=make_method(track.config))
    for step, scan, motion in rebuilt.placed_scans():
        rebuilt.method.insert(scan, step.match.map_T_laser, motion)
        inserted += 1
    return rebuilt if inserted == len(map_T_laser) else None


def points_of(log_scans: LogScans, steps: Steps, refiner: Refiner, rows: list[int]) -> Iterator[NDArray[np.float64]]:
    """Yield the match points (n, 2) of the tracked scans in these rows of the trajectory; m, laser frame."""
    tracked = steps.column("index")[steps.column("tracked")].tolist()
    wanted = {tracked[row] for row in rows}
    return (refiner.match_points(scan).copy() for index, scan in enumerate(log_scans()) if index in wanted)


def information_of(refiner: Refiner, points: NDArray[np.float64], map_T_laser: Pose) -> NDArray[np.float64]:
    """Return what the map shows of a pose by points (n, 2), (6,): `Refiner.observability`."""
    return refiner.observability(points, no_match(map_T_laser))[1]
