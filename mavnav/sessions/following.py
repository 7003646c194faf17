"""Where a recording goes on after a cut: the scans on both sides of it are tracked together."""

from __future__ import annotations

from itertools import chain, islice
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavnav.pose import Trajectory
from mavnav.sessions.merged_map import frame_of
from mavnav.slam.matching.steps import Steps, lost_intervals, tracked_trajectory
from mavnav.slam.methods.robust import Robust
from mavnav.slam.tracker import track
from mavnav.units import NS

if TYPE_CHECKING:
    from mavnav.config.models import Config
    from mavnav.pose import Pose
    from mavnav.sessions.group import SessionGroup
    from mavnav.sessions.session import Session

SOON_S = 5.0
"""Time between two parts of one recording."""

SIDE_M, MOST_SCANS = 3.0, 300
"""So much of the path on each side of a cut is tracked, and so many scans at most."""


class Follows(NamedTuple):
    """A session of a group at whose end another one begins: its number, and the pause between them, s."""

    number: int
    pause_s: float

    @property
    def soon(self) -> bool:
        """Whether both may be parts of one recording."""
        return self.pause_s <= SOON_S


def ended_before(group: SessionGroup, session: Session, pause_s: float) -> Follows | None:
    """Return the session of a group that ended last before another one begins; None if the pause is longer."""
    pauses_s = [(pause_between_s(session, member, pause_s), k) for k, member in enumerate(group.sessions)]
    latest = min(((p, k) for p, k in pauses_s if p is not None), default=None)
    return None if latest is None else Follows(latest[1], latest[0])


def pause_between_s(session: Session, other: Session, pause_s: float) -> float | None:
    """Return the pause after which a session begins at the end of another one, s; None if it is longer, or before."""
    if other is session or len(session.map_T_laser) < 2:
        return None
    left_s = (int(session.map_T_laser.stamps_ns[0]) - int(other.map_T_laser.stamps_ns[-1])) * NS
    return left_s if 0.0 <= left_s <= pause_s else None


def end_of(group: SessionGroup, number: int) -> Pose:
    """Return the frame of a session in that of its group, as it is at the end of the session."""
    return group.keys_of(number)[-1].map_T_laser @ group.sessions[number].keys[-1].map_T_laser.inverse()


def track_across_cut(member: Session, session: Session, config: Config) -> Pose | None:
    """Return the frame of a session in that of another one which ended before; None where the track does not go on."""
    before, after = member.map_T_laser, session.map_T_laser
    first, last = _rows_within(before.xyyaw[::-1]), _rows_within(after.xyyaw)
    scans = chain(islice(member.scans(), len(before) - first, None), islice(session.scans(), last))
    method = Robust(config)
    steps = Steps(track(scans, method, session.at_rest._replace(expects_rest=method.expects_rest)))
    if not steps.column("tracked").all() or any(lost_intervals(steps)):
        return None
    local = tracked_trajectory(steps)
    member_T_local = frame_of([_rows(local, slice(first))], [_rows(before, slice(len(before) - first, None))])
    local_T_session = frame_of([_rows(after, slice(last))], [_rows(local, slice(first, None))])
    return member_T_local @ local_T_session


def _rows(path: Trajectory, rows: slice) -> Trajectory:
    return Trajectory(path.stamps_ns[rows], path.xyyaw[rows])


def _rows_within(xyyaw: np.ndarray) -> int:
    """Count the poses (n, 3) up to ``SIDE_M`` of the path."""
    path_m = np.hypot(*np.diff(xyyaw[:MOST_SCANS, :2], axis=0).T).cumsum()
    return 1 + int(np.searchsorted(path_m, SIDE_M))
