"""Inertial sensors in a log: the yaw rate about the vertical, integrated, and the tilt."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavnav.logs.log import Log
from mavnav.logs.messages.columns import merge
from mavnav.logs.messages.records import Measurements
from mavnav.logs.namespaces import laser_topics, of_same_robot
from mavnav.logs.records import Imu
from mavnav.logs.stamps import MessageTrack, StampSource, in_order
from mavnav.pose import Rotation, ups_of_quaternions
from mavnav.units import NS

Floats = NDArray[np.float64]

USUAL_NAMES: Final = ("/imu/data", "/imu", "/imu/data_raw")
"""Of several topics of a robot the first of these is used."""

STANDARD_GRAVITY_M_S2: Final = 9.81
GRAVITY_SHARE: Final = 0.2
"""A mean acceleration that differs from gravity by more of it does not give the vertical; some sensors count in g."""

SMOOTHED_S: Final = 1.0
"""Accelerations are averaged over this time: what is left is gravity."""

LEAST_MESSAGES: Final = 10
MOST_RAD_S, MOST_M_S2 = 100.0, 1e4


class ImuTrack(MessageTrack):
    """The messages of an inertial sensor: rates, accelerations and orientation, 56 bytes each."""

    def add(self, parts: list[Measurements]) -> None:
        """Take in messages; those with rates or accelerations that are not finite, or impossible, are dropped."""
        part = merge(parts)
        rates, accelerations = part.angular_velocity_rad_s, part.acceleration_m_s2
        self.frame = self.frame or next((each.frame_id for each in parts if each.frame_id), "")
        possible = (np.abs(accelerations) <= MOST_M_S2).all(axis=0) & (np.abs(rates) <= MOST_RAD_S).all(axis=0)
        numbers = np.vstack((rates, accelerations, part.xyzw)).T
        self.extend(part.stamps_ns[possible], part.log_ns[possible], numbers[possible])

    def rotation(self, stamp_source: StampSource, half_sweep_ns: int, warn: Callable[[str], None]) -> Rotation | None:
        """Return the rotation at mid-sweep by the stamps of scans; None of too few messages."""
        stamps, recorded = self.stamps.by(stamp_source)
        keep = in_order(stamps, recorded, self.topic, warn)
        if len(keep) < LEAST_MESSAGES:
            if len(stamps) >= LEAST_MESSAGES:
                text = f"the stamps of the inertial sensor ascend in {len(keep)} of {len(stamps)} messages"
                warn(f"{self.topic}: {text}; it is not used, check its clock")
            return None
        numbers = self.rows(10)[keep]
        stamps, rates, ups = stamps[keep], numbers[:, :3], _ups(stamps[keep], numbers[:, 3:6], numbers[:, 6:])
        usual = _unit(np.median(ups, axis=0))
        about = np.einsum("ij,ij->i", rates, ups)
        turns: Floats = 0.5 * (about[1:] + about[:-1]) * np.diff(stamps) * NS
        tilt_rad = np.arccos(np.clip(ups @ usual, -1.0, 1.0))
        return Rotation(stamps - half_sweep_ns, np.concatenate(([0.0], np.cumsum(turns))), tilt_rad)


def _ups(stamps_ns: NDArray[np.int64], accelerations: Floats, xyzw: Floats) -> Floats:
    """Return the upward direction in the sensor's frame, (n, 3): by its orientation, else by gravity, else z."""
    if np.isfinite(xyzw).all() and (np.linalg.norm(xyzw, axis=1) > 0.5).all() and np.ptp(xyzw, axis=0).any():
        return ups_of_quaternions(xyzw)
    gravity = np.linalg.norm(np.median(accelerations, axis=0))
    in_m_s2, in_g = abs(gravity / STANDARD_GRAVITY_M_S2 - 1.0), abs(gravity - 1.0)
    if min(in_m_s2, in_g) > GRAVITY_SHARE:
        return np.tile((0.0, 0.0, 1.0), (len(accelerations), 1))
    return _unit(_smooth(stamps_ns, accelerations))


def _smooth(stamps_ns: NDArray[np.int64], values: Floats) -> Floats:
    """Return the means of values (n, 3) over windows of `SMOOTHED_S` about each."""
    half_ns = round(0.5 * SMOOTHED_S / NS)
    start, end = (np.searchsorted(stamps_ns, stamps_ns + off) for off in (-half_ns, half_ns + 1))
    sums = np.vstack((np.zeros(3), np.cumsum(values, axis=0)))
    means: Floats = (sums[end] - sums[start]) / (end - start)[:, None]
    return means


def _unit(vectors: Floats) -> Floats:
    lengths: Floats = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(lengths, 1e-9)


def usual_topic(names: list[str], scan_topic: str, scan_topics: Iterable[str]) -> str | None:
    """Return which of several topics to use for a scan topic, of all that the log has; None if that is not clear.

    Of those of its robot it is the first of the usual names, or the only one.
    """
    own = of_same_robot(names, scan_topic, scan_topics)
    named = ((name, name.removesuffix(end)) for end in USUAL_NAMES for name in own if name.endswith(end))
    usual = (name for name, space in named if scan_topic.startswith(f"{space}/"))
    return next(usual, own[0] if len(own) == 1 else None)


def laser_rotation(tracks: dict[str, ImuTrack], log: Log, odom: str, warn: Callable[[str], None]) -> Imu | None:
    """Return the sensor to use of those of a log, by topic, at mid-sweep; None without one, or with ``odom`` off.

    Of several of the robot without a usual name none is used, with a warning.
    """
    names = [name for name, track in tracks.items() if len(track.stamps)]
    if odom == "off" or not names:
        return None
    usual = usual_topic(names, log.topic, laser_topics(log.topics))
    if usual is None:
        if own := of_same_robot(names, log.topic, laser_topics(log.topics)):
            warn(f"several Imu topics, none is used: {', '.join(own)}")
        return None
    rotation = tracks[usual].rotation(log.stamp_source, round(0.5 * log.sensor.sweep_s / NS), warn)
    if rotation and not log.shares_time(rotation.stamps_ns):
        warn(f"{usual}: inertial sensor and scans share no time; it is not used, check its clock")
        return None
    return Imu(usual, rotation) if rotation else None
