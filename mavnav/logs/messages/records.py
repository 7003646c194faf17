"""Decoded messages, independent of their encoding."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class DecodeError(Exception):
    """The bytes of a message do not fit the type of its channel."""


class LaserMessage(NamedTuple):
    """A scan message before cleaning: lengths in m, angles in rad, ``ranges_m`` of any float type, shape (beams,).

    ``last_angle_rad`` is None if the message does not contain it. Range limits are NaN if there are none.
    """

    stamp_ns: int
    frame_id: str
    angle_min_rad: float
    angle_step_rad: float
    last_angle_rad: float | None
    range_min_m: float
    range_max_m: float
    time_increment_s: float
    scan_time_s: float
    ranges_m: NDArray[Any]
    has_limits: bool = True
    has_pose: bool = False


class ImuMessage(NamedTuple):
    """Measurements of an inertial sensor, in its own frame.

    Angular velocity in rad/s, acceleration in m/s2 (up at rest), and the orientation ``xyzw`` in a frame with z up,
    None if the message has no orientation.
    """

    stamp_ns: int
    xyzw: tuple[float, float, float, float] | None
    angular_velocity_rad_s: tuple[float, float, float]
    acceleration_m_s2: tuple[float, float, float]
    frame_id: str = ""


class Measurements(NamedTuple):
    """Measurements of an inertial sensor, in columns: those of `ImuMessage`, ``xyzw`` NaN where there is none.

    ``rows`` (n,) are the numbers of the messages among those read together, ``log_ns`` the times of recording.
    """

    rows: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    xyzw: NDArray[np.float64]
    angular_velocity_rad_s: NDArray[np.float64]
    acceleration_m_s2: NDArray[np.float64]
    frame_id: str


class Poses(NamedTuple):
    """Poses of frame ``child`` in frame ``parent``, in columns: ``xyz`` (3, n) in m, quaternions ``xyzw`` (4, n).

    ``rows`` (n,) are the numbers of the messages among those read together, ``log_ns`` the times of recording.
    """

    rows: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    parent: str
    child: str
    xyz: NDArray[np.float64]
    xyzw: NDArray[np.float64]

    def of_message(self, row: int) -> Poses:
        """Return the poses of one message."""
        own = self.rows == row
        xyz, xyzw = self.xyz[:, own], self.xyzw[:, own]
        return Poses(self.rows[own], self.stamps_ns[own], self.log_ns[own], self.parent, self.child, xyz, xyzw)


class TransformMessage(NamedTuple):
    """The pose of frame ``child`` in frame ``parent``: ``xyz`` in m, quaternion ``xyzw``."""

    stamp_ns: int
    parent: str
    child: str
    xyz: tuple[float, float, float]
    xyzw: tuple[float, float, float, float]
