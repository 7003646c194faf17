"""Wheels that err where walls show the motion: a track without them is kept if it differs, and is hardly doubted.

A match that is fused with wheels follows them where it knows little, and its map with it: wheels that slip, stand still
or change their scale bend a map of which each scan fits the last ones.
"""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from mavnav.slam.doubt.features import difference
from mavnav.slam.doubt.judge import UNASKED, judge, match_again
from mavnav.slam.methods.robust import Robust
from mavnav.slam.retries.attempt import Attempt
from mavnav.slam.retries.odometry import ERRING_WHEELS
from mavnav.slam.retries.wheel_scale import UNTIL_LOST

if TYPE_CHECKING:
    from mavnav.slam.track import Track

SURE: Final = 0.05
"""Doubt below which a track without wheels is believed: 0.02 in made logs where it is right, from 0.95 on where walls
leave motion open, or people walk along."""


def drop_wheels(track: Track) -> Track | None:
    """Return a track without the odometry that is used for it; None if none is, or the map is given."""
    if track.motion.odometry is None or not track.builds_map:
        return None
    return replace(track, motion=track.motion._replace(odometry=None))


def differs_and_is_sure(alone: Track, track: Track) -> bool:
    """Return whether a track without wheels differs from one with them clearly, and is sure."""
    return differs(alone, track) and is_sure(alone)


def differs(other: Track, track: Track) -> bool:
    """Return whether the motion of two tracks differs by more than the bound for wrong."""
    tracked = track.steps.column("tracked")
    stamps_ns, xyyaw = track.steps.column("stamp_ns")[tracked], track.steps.column("map_T_laser")[tracked]
    known = other.steps.column("tracked")[tracked, None]
    poses = np.where(known, other.steps.column("map_T_laser")[tracked], np.nan)
    return bool((difference(stamps_ns, xyyaw, poses) > 1.0).any())


def is_sure(track: Track) -> bool:
    """Return whether a track would hardly be doubted if the log had no odometry."""
    if not isinstance(track.method, Robust):
        return False
    method = deepcopy(track.method)
    doubt = judge(match_again(replace(track, log_odometry=None), method), method, UNASKED).findings.doubt
    return doubt is not None and doubt.probability < SURE


WITHOUT_WHEELS: Final = Attempt(ERRING_WHEELS, drop_wheels, differs_and_is_sure, UNTIL_LOST)
