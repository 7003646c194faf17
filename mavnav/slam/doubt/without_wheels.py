"""Wheels that err where walls show the motion: a track without them is kept if it differs, and is hardly doubted.

A match that is fused with wheels follows them where it knows little, and its map with it: wheels that slip, stand still
or change their scale bend a map of which each scan fits the last ones. Where walls show nothing, wheels alone do.
"""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from mavnav.slam.doubt.features import difference
from mavnav.slam.doubt.judge import UNASKED, judge, match_again
from mavnav.slam.matching.observability import LEAST_OBSERVABILITY
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.methods.robust import Robust
from mavnav.slam.retries.odometry import ERRING_WHEELS, describe_error
from mavnav.slam.retries.wheel_scale import UNTIL_LOST

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.slam.matching.odometry_fit import LogOdometry
    from mavnav.slam.track import Track

SURE: Final = 0.05
"""Doubt below which a track without wheels is believed: 0.02 in made logs where it is right, from 0.95 on where walls
leave motion open, or people walk along."""


def without_erring_wheels(track: Track) -> Track:
    """Return a track without the odometry that is used, or without the part of it that errs; else the given one.

    The given one is kept if no odometry is used, if the map is given, and if the run is stopped.
    """
    if track.log_odometry is None or track.motion.odometry is None or not track.builds_map:
        return track
    alone = with_odometry(track, None)
    if len(alone.steps) < len(track.steps):
        return track
    if is_better(alone, track):
        return alone.with_attempt(ERRING_WHEELS, kept=True)
    spans_ns = erring_spans_ns(alone, track)
    if len(spans_ns):
        partly = with_odometry(track, track.log_odometry.without(spans_ns, track.findings.odometry))
        if is_better(partly, track):
            return partly.with_warning(without_part(partly, track)).with_attempt(ERRING_WHEELS, kept=True)
    return track.with_attempt(ERRING_WHEELS, kept=False)


def with_odometry(track: Track, odometry: LogOdometry | None) -> Track:
    """Track the log again with a part of its odometry, or without; the new track ends where it is lost."""
    motion = track.motion._replace(odometry=odometry.lookup(track.findings.odometry) if odometry else None)
    other = replace(track, motion=motion, log_odometry=odometry or track.log_odometry)
    return other.over(track.log_scans(), "track again", UNTIL_LOST)


def is_better(other: Track, track: Track) -> bool:
    """Return whether another track of all scans differs from one with all wheels clearly, and is sure."""
    return len(other.steps) == len(track.steps) and bool(differs(other, track).any()) and is_sure(other)


def differs(other: Track, track: Track) -> NDArray[np.bool_]:
    """Return at which steps (n,) the motion of two tracks differs by more than the bound for wrong."""
    tracked = track.steps.column("tracked")
    stamps_ns, xyyaw = track.steps.column("stamp_ns")[tracked], track.steps.column("map_T_laser")[tracked]
    known = other.steps.column("tracked")[tracked, None]
    poses = np.where(known, other.steps.column("map_T_laser")[tracked], np.nan)
    out = np.zeros(len(track.steps), np.bool_)
    out[tracked] = difference(stamps_ns, xyyaw, poses) > 1.0
    return out


def is_sure(track: Track) -> bool:
    """Return whether a track would hardly be doubted if the log had no other odometry than it uses."""
    if not isinstance(track.method, Robust):
        return False
    method = deepcopy(track.method)
    doubt = judge(match_again(replace(track, log_odometry=None), method), method, UNASKED).findings.doubt
    return doubt is not None and doubt.probability < SURE


def erring_spans_ns(alone: Track, track: Track) -> NDArray[np.int64]:
    """Return where a track without wheels differs and walls show the motion: first and last stamps (n, 2) of scans."""
    erring = differs(alone, track)
    if erring.any() and isinstance(alone.method, Robust):
        erring &= match_again(alone, deepcopy(alone.method)).findings.observed >= LEAST_OBSERVABILITY
    edges = np.flatnonzero(np.diff(np.pad(erring, 1).astype(np.int8))).reshape(-1, 2)
    return np.asarray(track.steps.column("stamp_ns")[edges - (0, 1)], np.int64)


def without_part(partly: Track, track: Track) -> str:
    """Say for how many scans wheels are left out, and why."""
    stamps_ns, path = track.steps.column("stamp_ns"), tracked_trajectory(partly.steps)
    without = np.count_nonzero(track.motion.odometry_at(stamps_ns) & ~partly.motion.odometry_at(stamps_ns))
    return f"odometry is left out for {without} of {len(stamps_ns)} scans: {describe_error(track, path)}"
