"""One map of several sessions: every scan where the pose graph puts it, then where it fits what all of them saw."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import rigid_fit
from mavnav.slam.loop_closure.detection import follow
from mavnav.slam.matching.motion_model import motions_along
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step, Steps, tracked_trajectory
from mavnav.slam.methods.robust import Robust
from mavnav.slam.refinement.refine import refine_steps

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.pose import Pose, Trajectory
    from mavnav.profiling import Progress
    from mavnav.scan import Scan
    from mavnav.sessions.group import Session, SessionGroup
    from mavnav.slam.matching.motion_model import Motion

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
        for scan, motion in _all_scans([sessions[k] for k in numbers], [placed[k] for k in numbers]):
            method.insert(scan, motion.map_T_laser, motion)
            done += 1
            progress("draw map", done, total)
        method.remove_dynamic_cells()
        for k in numbers:
            refined_poses[k] = _match_scans(sessions[k], placed[k], method)
    map_T_here = frame_of([refined_poses[k] for k in framing], [sessions[k].map_T_laser for k in framing])
    refined_poses = [poses.seen_from(map_T_here) for poses in refined_poses]
    grid = GridBuilder(method.grid.cell_m)
    for done, (scan, motion) in enumerate(_all_scans(sessions, refined_poses), start=1):
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


def _all_scans(sessions: Sequence[Session], placed: Sequence[Trajectory]) -> Iterator[tuple[Scan, Motion]]:
    """Give every scan with its pose and velocity."""
    for session, poses in zip(sessions, placed, strict=True):
        yield from zip(session.scans(), motions_along(poses, session.at_rest), strict=True)


def _match_scans(session: Session, poses: Trajectory, method: Robust) -> Trajectory:
    """Match every scan of a session against the map of all."""
    stamps_ns = poses.stamps_ns.tolist()
    steps = (Step(k, stamp_ns, no_match(poses[k]), tracked=True) for k, stamp_ns in enumerate(stamps_ns))
    return tracked_trajectory(Steps(refine_steps(session.scans(), steps, method, array("d"))))
