"""The content of the messages of interest, whatever encoding they came in."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from numpy.typing import NDArray


class DecodeError(Exception):
    """A message is not what its channel says."""


class LaserMessage(NamedTuple):
    """A scan message, uncleaned: lengths in m, angles in rad, ``ranges_m`` of any float type, shape (beams,).

    ``last_angle_rad`` is None where the message does not have it. Limits are NaN where there are none.
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
    """What an inertial sensor measured, in its own frame.

    Angular velocity in rad/s, acceleration in m/s2 (up at rest), and the orientation ``xyzw`` in a frame with z up,
    None where the message says that there is none.
    """

    stamp_ns: int
    xyzw: tuple[float, float, float, float] | None
    angular_velocity_rad_s: tuple[float, float, float]
    acceleration_m_s2: tuple[float, float, float]
    frame_id: str = ""


class TransformMessage(NamedTuple):
    """The pose of frame ``child`` in frame ``parent``: ``xyz`` in m, quaternion ``xyzw``."""

    stamp_ns: int
    parent: str
    child: str
    xyz: tuple[float, float, float]
    xyzw: tuple[float, float, float, float]
