"""Scans that leave a motion open: whether the log has odometry there all the same, and what to do about it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavnav.slam.matching.motion_model import GAP_S
from mavnav.slam.track import Track
from mavnav.units import NS


def is_recorded(track: Track, stamps_ns: NDArray[np.int64]) -> bool:
    """Return whether the log has odometry at most of some stamps (n,), in no gap of over ``GAP_S``."""
    recorded_ns = track.recorded_ns
    if len(recorded_ns) < 2:
        return False
    after = np.searchsorted(recorded_ns, stamps_ns).clip(1, len(recorded_ns) - 1)
    inside = (stamps_ns >= recorded_ns[0]) & (stamps_ns <= recorded_ns[-1])
    near = recorded_ns[after] - recorded_ns[after - 1] <= round(GAP_S / NS)
    return 2 * int((inside & near).sum()) > len(stamps_ns)


def not_observed(track: Track, stamps_ns: NDArray[np.int64]) -> str:
    """Return what it means that scans of some stamps (n,) leave a direction open, and nothing else shows it."""
    todo = odometry_advice(track, stamps_ns)
    return (
        "motion in one direction is not observable, and the path may be too short, too long or turned there; "
        f"{todo}{', or ' if todo else ''}check map.png"
    )


def observed_by_odometry(_: NDArray[np.int64]) -> str:
    """Return what it means where odometry shows the direction that scans leave open."""
    return "motion in one direction is that of the odometry alone: compare the map with a length that is known"


def odometry_advice(track: Track, stamps_ns: NDArray[np.int64]) -> str:
    """Return what to do so that scans of some stamps (n,) have odometry; empty where the log has it already."""
    if track.odometry_contradicts:
        return "correct the odometry"
    if is_recorded(track, stamps_ns):
        return ""
    if track.config.odom == "off":
        return "use --odom auto if the log has odometry"
    return "record odometry for the whole log" if len(track.recorded_ns) else "record odometry"
