"""Wheels that err where walls show the motion: a track without them is kept if it differs, and is hardly doubted.

A match that is fused with wheels follows them where it knows little, and its map with it: wheels that slip, stand still
or change their scale bend a map of which each scan fits the last ones. Where walls show nothing, wheels alone do.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.slam.doubt.features import difference, turns_rad
from mavnav.slam.doubt.judge import UNASKED, judge, match_again
from mavnav.slam.matching.observability import LEAST_OBSERVABILITY
from mavnav.slam.matching.odometry_fit import LogOdometry
from mavnav.slam.matching.scan_matching import MatchVerdict
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.methods.robust import Robust
from mavnav.slam.retries.beginning import UNTIL_LOST
from mavnav.slam.retries.odometry import ERRING_WHEELS, describe_error
from mavnav.slam.track import Track
from mavnav.units import DEG, NS

SURE: Final = 0.05
"""Doubt below which a track without wheels is believed: 0.02 in made logs where it is right, from 0.95 on where walls
leave motion open, or people walk along."""

SAMPLE_S, SAMPLE_M, SAMPLE_RAD = 0.8, 0.15, 10 * DEG
"""Time, path length and turn after which another scan shows whether walls agree: with fewer scans they often do not."""


def without_erring_wheels(track: Track) -> Track:
    """Return a track without the odometry that is used, or without the part of it that errs; else the given one.

    The given one is kept if no odometry is used, nothing is tracked, the map is given, or the run is stopped.
    """
    if track.log_odometry is None or track.motion.odometry is None or not track.builds_map:
        return track
    if not track.steps.column("tracked").any():
        return track
    if walls_agree(track):
        return track.with_attempt(ERRING_WHEELS, kept=False)
    alone = with_odometry(track, None)
    if len(alone.steps) < len(track.steps):
        return track
    erring = differs(alone, track)
    judged = judge_alone(alone) if erring.any() else None
    if judged is None:
        return track.with_attempt(ERRING_WHEELS, kept=False)
    if is_sure(judged):
        return alone.with_attempt(ERRING_WHEELS, kept=True)
    erring &= judged.findings.observed >= LEAST_OBSERVABILITY
    left = track.log_odometry.without(spans_ns(erring, track), track.findings.odometry) if erring.any() else None
    partly = with_odometry(track, left) if 0 < count_without(left, track) < len(track.steps) else track
    complete = len(partly.steps) == len(track.steps)
    if not complete or not differs(partly, track).any() or not is_sure(judge_alone(partly)):
        return track.with_attempt(ERRING_WHEELS, kept=False)
    return partly.with_warning(without_part(partly, track)).with_attempt(ERRING_WHEELS, kept=True)


def walls_agree(track: Track) -> bool:
    """Return whether some scans, which walls alone place, show the motion of a track: without wheels it is the same.

    The track predicts where they are, but a map of their own decides. On 37 made logs whose track without wheels
    differs, that of these scans does, or loses one. On 3 others they agree: the track with wheels is as good.
    """
    some, alone, poses, before = sampled_steps(track), Robust(track.config), list[Pose](), None
    for step, scan, motion in track.placed_scans("track again"):
        if not some[step.index]:
            continue
        here, pose = motion._replace(odometry=None), step.match.map_T_laser
        if before:
            here = here._replace(map_T_laser=poses[-1], stamp_ns=before.stamp_ns)
            match = alone.match(scan, poses[-1] @ before.match.map_T_laser.between(pose), here)
            if alone.gate(match, scan, here) is MatchVerdict.REFUSED:
                return False
            pose = match.map_T_laser
        alone.insert(scan, pose, here)
        poses.append(pose)
        before = step
    if len(poses) < np.count_nonzero(some):
        return False
    stamps_ns, xyyaw = (track.steps.column(name)[some] for name in ("stamp_ns", "map_T_laser"))
    return bool((difference(stamps_ns, xyyaw, np.array(poses)) <= 1.0).all())


def sampled_steps(track: Track) -> NDArray[np.bool_]:
    """Return which steps (n,) are tracked, and the first after some time, path or turn."""
    rows = np.flatnonzero(track.steps.column("tracked"))
    stamps_ns, xyyaw = (track.steps.column(name)[rows] for name in ("stamp_ns", "map_T_laser"))
    elapsed, driven = np.diff(stamps_ns) * NS / SAMPLE_S, np.hypot(*np.diff(xyyaw[:, :2], axis=0).T) / SAMPLE_M
    due = np.cumsum(np.maximum.reduce((elapsed, driven, turns_rad(xyyaw[:, 2])[1:] / SAMPLE_RAD)))
    _, first = np.unique(np.floor(np.append(0.0, due)), return_index=True)
    return np.isin(np.arange(len(track.steps)), rows[first])


def with_odometry(track: Track, odometry: LogOdometry | None) -> Track:
    """Track the log again with a part of its odometry, or without; the new track ends where it is lost."""
    other = track.with_odometry(odometry, track.findings.odometry)
    return other.over(track.log_scans(), "track again", UNTIL_LOST)


def differs(other: Track, track: Track) -> NDArray[np.bool_]:
    """Return at which steps (n,) the motion of two tracks differs by more than the bound for wrong."""
    tracked = track.steps.column("tracked")
    stamps_ns, xyyaw = track.steps.column("stamp_ns")[tracked], track.steps.column("map_T_laser")[tracked]
    known = other.steps.column("tracked")[tracked, None]
    poses = np.where(known, other.steps.column("map_T_laser")[tracked], np.nan)
    out = np.zeros(len(track.steps), np.bool_)
    out[tracked] = difference(stamps_ns, xyyaw, poses) > 1.0
    return out


def judge_alone(track: Track) -> Track | None:
    """Return a track with its doubt if the log had no other odometry than it uses; None if no map is built."""
    if not isinstance(track.method, Robust):
        return None
    method = deepcopy(track.method)
    return judge(match_again(replace(track, log_odometry=None), method), method, UNASKED)


def is_sure(judged: Track | None) -> bool:
    """Return whether a judged track is hardly doubted."""
    doubt = judged.findings.doubt if judged else None
    return doubt is not None and doubt.probability < SURE


def spans_ns(chosen: NDArray[np.bool_], track: Track) -> NDArray[np.int64]:
    """Return the runs of the chosen steps (n,), each as the stamps of its first and last scan, (m, 2)."""
    edges = np.flatnonzero(np.diff(np.pad(chosen, 1).astype(np.int8))).reshape(-1, 2)
    return np.asarray(track.steps.column("stamp_ns")[edges - (0, 1)], np.int64)


def count_without(part: LogOdometry | None, track: Track) -> int:
    """Return for how many scans a part of the odometry of a track leaves it out: poses bridge a short gap."""
    if part is None:
        return 0
    stamps_ns, pose_at = track.steps.column("stamp_ns"), part.lookup(track.findings.odometry)
    left = track.motion._replace(odometry=pose_at).odometry_at(stamps_ns)
    return int(np.count_nonzero(track.motion.odometry_at(stamps_ns) & ~left))


def without_part(partly: Track, track: Track) -> str:
    """Say for how many scans wheels are left out, and why."""
    without = count_without(partly.log_odometry, track)
    path = tracked_trajectory(partly.steps)
    return f"odometry is left out for {without} of {len(track.steps)} scans: {describe_error(track, path)}"
