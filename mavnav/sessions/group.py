"""Sessions, groups of those that are joined (key frames in one frame, the pose graph over all), and their one map.

In the map every scan is where the pose graph puts it, then where it fits what all sessions saw.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple
from zlib import crc32

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.pose import Pose, Trajectory, rigid_fit
from mavnav.profiling import Progress
from mavnav.scan import Scan
from mavnav.slam.findings import Edge
from mavnav.slam.loop_closure.detection import follow, nearest_old
from mavnav.slam.loop_closure.key_frames import KEY_M, KEY_RAD, KeyFrame, KeyFrameMap, LocalMaps, Visibility, key_rows
from mavnav.slam.loop_closure.pose_graph import PATH_SIGMA_M, PATH_SIGMA_RAD, root_information
from mavnav.slam.matching.motion_model import USUAL_PERIOD_S, Motion, motions_along
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step, Steps, tracked_trajectory
from mavnav.slam.methods.robust import Robust
from mavnav.slam.refinement.refine import refine_steps
from mavnav.units import DEG, NS

END_M, END_KEY_M, END_KEY_RAD = 1.5, 0.1, 5 * DEG
"""Sessions may meet at an end: that near to the ends of the path, key frames follow each other more closely."""


class Session(Struct, frozen=True):
    """Tracked scans, from the first one again at every call, their poses, a row each, and the key frames among them.

    ``doubtful``: the track may be wrong, by its own run. ``scan_hashes`` are those of the ranges.
    """

    name: str
    scans: Callable[[], Iterable[Scan]]
    map_T_laser: Trajectory
    keys: tuple[KeyFrame, ...]
    doubtful: bool = False
    scan_hashes: frozenset[int] = frozenset()

    @property
    def at_rest(self) -> Motion:
        """The motion before the first scan: the time between two scans alone is known."""
        steps_ns = np.diff(self.map_T_laser.stamps_ns)
        return Motion(float(np.median(steps_ns)) * NS if len(steps_ns) else USUAL_PERIOD_S)


def make_session(
    name: str, scans: Callable[[], Iterable[Scan]], map_T_laser: Trajectory, config: Config, *, doubtful: bool = False
) -> Session:
    """Choose the key frames of a session; raises ValueError where the scans are not those of the trajectory."""
    path_of, method, keys = key_paths_m(map_T_laser.xyyaw), Robust(config), list[KeyFrame]()
    stamps_ns, hashes = map_T_laser.stamps_ns.tolist(), set[int]()
    for row, (scan, stamp_ns) in enumerate(zip(scans(), stamps_ns, strict=True)):
        if scan.stamp_ns != stamp_ns:
            raise ValueError(f"pose {row} is of another time than scan {row}")
        hashes.add(crc32(scan.ranges_m.tobytes()))
        if row in path_of:
            keys.append(KeyFrame(row, path_of[row], method.match_points(scan).copy(), map_T_laser[row]))
    return Session(name, scans, map_T_laser, tuple(keys), doubtful, frozenset(hashes))


def key_paths_m(xyyaw: NDArray[np.float64]) -> dict[int, float]:
    """Choose the rows of key frames out of poses (n, 3); return the path length up to each, m."""
    rows, paths_m = key_rows(xyyaw)
    close = zip(*key_rows(xyyaw, END_KEY_M, END_KEY_RAD), strict=True)
    end_m = paths_m[-1] - END_M if rows else 0.0
    chosen = [*zip(rows, paths_m, strict=True), *(pair for pair in close if not END_M < pair[1] < end_m)]
    return dict(sorted(chosen))


DOUBTFUL = 3.0
"""The path of a session whose own track is doubtful has standard deviations so many times as large: it is bent to fit
the others, and does not bend them."""

SHORT = 0.1
"""The variance of the motion to the next key frame shrinks with it, down to this part."""

NEAR_M = 2.0
"""Key frames of one session that lie so near, a long path apart, are held together by its finished map."""

REVISIT_SIGMA_M, REVISIT_SIGMA_RAD = 0.03, 0.5 * DEG
"""Standard deviations of where a run placed a key frame against one of a long path before, or of another session."""

APART_M = 1e6
"""Between the paths of two sessions: nothing of one is near to the other along the path."""


class Join(NamedTuple):
    """How a session was joined to a group, or why not (``why``).

    ``searched`` witnesses, ``found`` of them fit in one place, and ``agreeing`` of those agree. Of ``tested`` key
    frames ``closures`` agree with the map and ``contradicting`` conflict with it. ``residual_m`` and ``residual_rad``
    are the RMS of what the pose graph leaves of the closures. ``after`` names the session at whose end it begins, if it
    was placed there.
    """

    name: str
    searched: int = 0
    found: int = 0
    agreeing: int = 0
    tested: int = 0
    closures: int = 0
    contradicting: int = 0
    residual_m: float = 0.0
    residual_rad: float = 0.0
    joined_to: tuple[tuple[str, int], ...] = ()
    why: str = ""
    after: str = ""

    @property
    def agreeing_share(self) -> float:
        """Part of the witnesses that agree."""
        return self.agreeing / max(self.searched, 1)


class SessionGroup(Struct, frozen=True):
    """Sessions in one frame: their key frames, one session after another, what binds them, and how each was joined."""

    sessions: tuple[Session, ...]
    keys: tuple[KeyFrame, ...]
    edges: tuple[Edge, ...]
    joins: tuple[Join, ...]

    def owner(self, key: int) -> int:
        """Return the number of the session of a key frame."""
        return int(self.keys[key].path_m // APART_M)

    def keys_of(self, number: int) -> list[KeyFrame]:
        """Return the key frames of a session, in the frame of the group."""
        return [key for k, key in enumerate(self.keys) if self.owner(k) == number]


def group_in_frame(sessions: Sequence[Session]) -> SessionGroup:
    """Return sessions that are in one frame already as a group: each is held where it is by those before it."""
    keys, edges = list[KeyFrame](), list[Edge]()
    for number, session in enumerate(sessions):
        first = len(keys)
        keys += [replace(key, path_m=key.path_m + number * APART_M) for key in session.keys]
        edges += own_edges(session, first)
        if number:
            pairs = [pair for pair in revisits(keys, first) if pair[0] < first] or [nearest_pair(keys, first)]
            firm = root_information(REVISIT_SIGMA_M, REVISIT_SIGMA_RAD)
            edges += [Edge(i, j, keys[i].map_T_laser.between(keys[j].map_T_laser), firm) for i, j in pairs]
    return SessionGroup(tuple(sessions), tuple(keys), tuple(edges), tuple(Join(session.name) for session in sessions))


def nearest_pair(keys: Sequence[KeyFrame], first: int) -> tuple[int, int]:
    """Return the key frame from number ``first`` on, and the one before, that are nearest to each other."""
    xy_m = np.array([key.map_T_laser[:2] for key in keys])
    off_m = np.hypot(*(xy_m[first:, None] - xy_m[None, :first]).transpose(2, 0, 1))
    j, i = np.unravel_index(int(np.argmin(off_m)), off_m.shape)
    return int(i), first + int(j)


def own_edges(session: Session, first: int) -> Iterator[Edge]:
    """Bind the key frames of a session as its run placed them; ``first`` is the number of its first one."""
    keys, times = session.keys, DOUBTFUL if session.doubtful else 1.0
    poses, path = [key.map_T_laser for key in keys], root_information(PATH_SIGMA_M, PATH_SIGMA_RAD) / times
    for k, (a, b) in enumerate(pairwise(poses)):
        a_T_b = a.between(b)
        share = max(a_T_b.distance_m / KEY_M, abs(a_T_b.yaw_rad) / KEY_RAD)
        yield Edge(first + k, first + k + 1, a_T_b, path / np.sqrt(min(max(share, SHORT), 1.0)))
    firm = root_information(REVISIT_SIGMA_M, REVISIT_SIGMA_RAD) / times
    yield from (Edge(first + i, first + j, poses[i].between(poses[j]), firm) for i, j in revisits(keys, 0))


def revisits(keys: Sequence[KeyFrame], begin: int) -> Iterator[tuple[int, int]]:
    """Pair key frames from number ``begin`` on with the nearest one of a long path before, if that is near."""
    xy_m, paths_m = np.array([key.map_T_laser[:2] for key in keys]), np.array([key.path_m for key in keys])
    for j, key in enumerate(keys[begin:], start=begin):
        i = nearest_old(xy_m, paths_m, xy_m[j], key.path_m)
        if i is not None and np.hypot(*(xy_m[i] - xy_m[j])) <= NEAR_M:
            yield i, j


STILL_M, STILL_RAD = 0.06, 0.6 * DEG
"""A map stays where no key frame moved nor turned farther: places are found in it, and measured elsewhere."""


class GroupMap:
    """What some key frames saw: the map of all, and which of them saw which squares of the plane."""

    def __init__(self, keys: Sequence[KeyFrame], config: Config) -> None:
        """Draw the map of some key frames."""
        self.keys, self.map, self.config = list(keys), KeyFrameMap(config), config
        self.seen = Visibility(self.keys, LocalMaps(self.keys, config))
        self.map.grow(self.keys, len(self.keys))
        self.seen.grow(len(self.keys))

    def with_keys(self, keys: Sequence[KeyFrame]) -> GroupMap:
        """Return the map of more key frames, of which these are the first: this one grown, or another if they moved."""
        count = len(self.keys)
        poses = (np.array([key.map_T_laser for key in some]) for some in (self.keys, keys[:count]))
        off = np.abs(np.subtract(*poses))
        off[:, 2] = np.minimum(off[:, 2], 2.0 * np.pi - off[:, 2])
        if (off > (STILL_M, STILL_M, STILL_RAD)).any():
            return GroupMap(keys, self.config)
        self.keys.extend(keys[count:])
        self.map.grow(self.keys, len(keys))
        self.seen.grow(len(keys))
        return self


AHEAD_M = 1.0
"""Frames are compared by the positions of poses, and by points so far ahead of them."""


def trajectories(group: SessionGroup) -> list[Trajectory]:
    """Return the poses of all scans of each session in the frame of the group: they move with their key frames."""
    return [follow(member.map_T_laser, member.keys, group.keys_of(k)) for k, member in enumerate(group.sessions)]


def merged_map(
    group: SessionGroup, config: Config, framing: Sequence[int], progress: Progress
) -> tuple[Grid, list[Session]]:
    """Draw the map of a group, and return it with the sessions at the poses as matched against it.

    What did not stay where it was seen is no part of the map. Sessions whose track is doubtful are matched against the
    map of the others too, these not against theirs. The frame is that in which the sessions of the numbers ``framing``
    were, as nearly as can be.
    """
    sessions, placed = group.sessions, trajectories(group)
    method, refined_poses, done, total = Robust(config), list(placed), 0, sum(map(len, placed))
    for doubtful in sorted({session.doubtful for session in sessions}):
        numbers = [k for k, session in enumerate(sessions) if session.doubtful == doubtful]
        for scan, motion in _all_scans([sessions[k] for k in numbers], [placed[k] for k in numbers], method):
            method.insert(scan, motion.map_T_laser, motion)
            done += 1
            progress("draw map", done, total)
        method.remove_dynamic_cells()
        for k in numbers:
            refined_poses[k] = _match_scans(sessions[k], placed[k], method)
    map_T_here = frame_of([refined_poses[k] for k in framing], [sessions[k].map_T_laser for k in framing])
    refined_poses = [poses.seen_from(map_T_here) for poses in refined_poses]
    grid = GridBuilder(method.grid.cell_m)
    for done, (scan, motion) in enumerate(_all_scans(sessions, refined_poses, method), start=1):
        grid.insert(motion.map_T_laser, *method.placed_points(scan, motion.map_T_laser, motion))
        progress("draw map again", done, total)
    grid.remove_dynamic_cells()
    placed_sessions = zip(sessions, refined_poses, strict=True)
    return grid.by_rows(), [replace(session, map_T_laser=poses) for session, poses in placed_sessions]


def frame_of(here: Sequence[Trajectory], there: Sequence[Trajectory]) -> Pose:
    """Return the motion that brings poses best to where they are in another frame: themselves, and a point ahead."""
    return rigid_fit(*(np.concatenate([_points(path) for path in paths]) for paths in (here, there)))


def _points(path: Trajectory) -> NDArray[np.float64]:
    """Return the positions of poses, and points ahead of them, (2 n, 2), m."""
    x_m, y_m, yaw_rad = path.xyyaw.T
    ahead = np.column_stack((x_m + AHEAD_M * np.cos(yaw_rad), y_m + AHEAD_M * np.sin(yaw_rad)))
    return np.concatenate((path.xyyaw[:, :2], ahead))


def _all_scans(
    sessions: Sequence[Session], placed: Sequence[Trajectory], method: Robust
) -> Iterator[tuple[Scan, Motion]]:
    """Give every scan with its velocity and the pose at mid-sweep."""
    for session, poses in zip(sessions, placed, strict=True):
        for scan, motion in zip(session.scans(), motions_along(poses, session.at_rest), strict=True):
            yield scan, motion._replace(map_T_laser=motion.map_T_laser @ method.sweep_T_mid(scan, motion))


def _match_scans(session: Session, poses: Trajectory, method: Robust) -> Trajectory:
    """Match every scan of a session against the map of all."""
    stamps_ns = poses.stamps_ns.tolist()
    steps = (Step(k, stamp_ns, no_match(poses[k]), tracked=True) for k, stamp_ns in enumerate(stamps_ns))
    return tracked_trajectory(Steps(refine_steps(session.scans(), steps, method, array("d"))))
