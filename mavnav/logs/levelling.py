"""The attitude of the laser by its best source in a log: checked, brought to the laser, and used to level scans."""

from __future__ import annotations

from math import inf, pi
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.errors import TopicError
from mavnav.logs.attitude import NAME
from mavnav.logs.stamps import in_order
from mavnav.logs.transforms import frame_name
from mavnav.scan import level_scan
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from mavnav.logs.attitude import TopicAttitude
    from mavnav.logs.stamps import StampSource
    from mavnav.logs.transforms import FrameTree
    from mavnav.scan import Scan

    Floats = NDArray[np.float64]

GAP_NS: Final = 500_000_000
"""Scans farther in time from the nearest attitude have none; attitudes are interpolated over twice as much."""

MOST_RAD: Final = 60 * DEG
"""Scans that are tilted by more are not used: their plane meets hardly any wall."""

LEAST_RAD, LEAST_SHARE = 5 * DEG, 0.1
"""Sensors of other names are used if so much of the time the laser tilts by more than this from how it usually is."""


class RecordedAttitude(Struct, frozen=True):
    """Tilt and height of the laser over time, from a topic of the log; ``source`` is pose, odom or imu.

    ``stamps_ns`` (n,) ascend strictly; ``roll_rad``, ``pitch_rad`` and ``height_m`` (n,) are those of `Attitude`. All
    are read-only. ``ceiling_m`` is the height of the ceiling, inf if unknown.
    """

    topic: str
    source: Literal["pose", "odom", "imu"]
    stamps_ns: NDArray[np.int64]
    roll_rad: Floats
    pitch_rad: Floats
    height_m: Floats
    ceiling_m: float = inf

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for values in (self.stamps_ns, self.roll_rad, self.pitch_rad, self.height_m):
            values.flags.writeable = False

    @property
    def tilt_rad(self) -> Floats:
        """Angles between the laser's vertical and the true one, (n,)."""
        return _tilts_rad(self.roll_rad, self.pitch_rad)

    @property
    def has_heights(self) -> bool:
        """Whether the height of the laser is known."""
        return bool(np.isfinite(self.height_m).all())

    def known_at(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return at which times (m,) there is an attitude near."""
        after = np.searchsorted(self.stamps_ns, stamps_ns)
        last = len(self.stamps_ns) - 1
        near_ns = [np.abs(stamps_ns - self.stamps_ns[k.clip(0, last)]) for k in (after - 1, after)]
        return np.asarray(np.minimum(*near_ns) <= GAP_NS)

    def at(self, late_ns: Floats) -> tuple[Floats, Floats, Floats]:
        """Interpolate roll, pitch, rad, and height, m, at times (m,) since the first attitude, ns."""
        begin_ns = int(self.stamps_ns[0])
        first, last = np.searchsorted(self.stamps_ns, [begin_ns + int(late_ns.min()), begin_ns + int(late_ns.max())])
        part = slice(max(int(first) - 1, 0), int(last) + 2)  # interpolation in all of a long log would take long
        since_ns, values = self.stamps_ns[part] - begin_ns, (self.roll_rad, self.pitch_rad, self.height_m)
        roll, pitch, height = (np.interp(late_ns, since_ns, v[part]) for v in values)
        return roll, pitch, height

    def height_at(self, stamp_ns: int) -> float:
        """Interpolate the height, m, at a time."""
        return float(self.at(np.array([float(stamp_ns - int(self.stamps_ns[0]))]))[2][0])

    def tilts_at(self, stamps_ns: NDArray[np.int64]) -> Floats:
        """Interpolate the tilt, rad, at times (m,)."""
        roll, pitch, _ = self.at((stamps_ns - self.stamps_ns[0]).astype(np.float64))
        return _tilts_rad(roll, pitch)

    def level(self, scan: Scan) -> Scan:
        """Return a scan levelled, each beam at its time; without any range if its attitude is unknown or too steep."""
        stamp_ns = np.array([scan.stamp_ns])
        if not self.known_at(stamp_ns)[0] or self.tilts_at(stamp_ns)[0] > MOST_RAD:
            return replace(scan, ranges_m=np.full(scan.spec.beams, np.nan))
        times_s = scan.spec.time_increment_s * np.arange(scan.spec.beams) if scan.times_s is None else scan.times_s
        late_ns = np.asarray(times_s / NS + float(scan.stamp_ns - int(self.stamps_ns[0])))
        return level_scan(scan, *self.at(late_ns), self.ceiling_m)


def _tilts_rad(roll_rad: Floats, pitch_rad: Floats) -> Floats:
    return np.asarray(np.arccos(np.cos(roll_rad) * np.cos(pitch_rad)))


def laser_attitude(
    sources: Iterable[TopicAttitude],
    frames: FrameTree,
    laser_frame: str,
    stamps_ns: NDArray[np.int64],
    stamp_source: StampSource,
    *,
    named: bool,
    upside_down: bool,
    warn: Callable[[str], None],
) -> RecordedAttitude | None:
    """Return the attitude of the laser from the first source that can be used; None without any.

    Poses (PoseStamped) are those of the laser. Orientations of another frame are brought to the laser by the static
    transforms, without which only a topic that the user names is used. ``stamps_ns`` (m,) are those of the scans.
    Scans without an attitude, and what else is odd, are reported to ``warn``.

    Raises
    ------
    TopicError
        The named topic holds nothing that can be used.
    """
    for source in sources:
        body_T_laser = _mounting(source, frames, laser_frame)
        left_out: list[str] = []
        mounted = np.eye(4) if body_T_laser is None else body_T_laser
        attitude = _recorded_attitude(source, mounted, stamp_source, upside_down, left_out.append)
        wanted = named or frame_name(source.topic) == NAME
        if not wanted and not _tilts(attitude):
            continue
        if body_T_laser is None:
            text = f"{source.topic}: no transform from {source.body_frame!r} to {frame_name(laser_frame)!r}"
            if not wanted:
                warn(f"{text}; its tilt is not used (record /tf_static, or give --attitude {source.topic})")
                continue
            warn(f"{text}; their axes are taken as parallel")
        problem = _problem(attitude, stamps_ns)
        if problem and named:
            raise TopicError(f"{source.topic}: {problem}, or write --attitude off")
        for text in [f"{problem}; it is not used"] if problem else _oddities(source, attitude, stamps_ns):
            warn(f"{source.topic}: {text}")
        for text in left_out:
            warn(text)
        return None if problem else attitude
    return None


def _mounting(source: TopicAttitude, frames: FrameTree, laser_frame: str) -> NDArray[np.floating] | None:
    if source.kind == "pose" or source.body_frame == frame_name(laser_frame):
        return np.eye(4)
    return frames.find(source.body_frame, frame_name(laser_frame))


def _recorded_attitude(
    source: TopicAttitude,
    body_T_laser: NDArray[np.floating],
    stamp_source: StampSource,
    upside_down: bool,
    warn: Callable[[str], None],
) -> RecordedAttitude:
    """Return the attitude of the laser, as seen from above, without messages that are not finite or not in order."""
    finite = _finite(source)
    stamps_ns, recorded_ns = (each[finite] for each in source.stamps.by(stamp_source))
    order = in_order(stamps_ns, recorded_ns, source.topic, warn)
    stamps_ns, ups, height_m = stamps_ns[order], source.ups[finite][order], source.height_m[finite][order]
    height_m = height_m + ups @ body_T_laser[:3, 3]
    if len(height_m) and height_m.min() <= 0.0:
        height_m = np.full(len(height_m), np.nan)
    x, y, z = (ups @ body_T_laser[:3, :3]).T
    if upside_down and source.kind != "pose":
        y, z = -y, -z
    return RecordedAttitude(
        source.topic, source.kind, stamps_ns, np.arctan2(y, z), -np.arcsin(np.clip(x, -1.0, 1.0)), height_m
    )


def _tilts(attitude: RecordedAttitude) -> bool:
    """Return whether the laser tilts often and by much from how it usually is."""
    if not len(attitude.stamps_ns):
        return False
    off = [(v - np.median(v) + pi) % (2 * pi) - pi for v in (attitude.roll_rad, attitude.pitch_rad)]
    return float((np.hypot(*off) > LEAST_RAD).mean()) >= LEAST_SHARE


def _problem(attitude: RecordedAttitude, stamps_ns: NDArray[np.int64]) -> str:
    """Return why an attitude cannot be used at all; empty if it can."""
    if not len(attitude.stamps_ns):
        return "no attitude in it is finite; see what publishes it"
    known = attitude.known_at(stamps_ns)
    if not known.any():
        return "attitude and scans share no time; check its clock"
    if (attitude.tilts_at(stamps_ns[known]) > MOST_RAD).all():
        return "all scans are tilted by more than 60 deg; check its axes (x forward, z up) and the mounting"
    return ""


def _oddities(source: TopicAttitude, attitude: RecordedAttitude, stamps_ns: NDArray[np.int64]) -> Iterator[str]:
    """Say what of an attitude, or of which scans, is not used."""
    n, known = len(stamps_ns), attitude.known_at(stamps_ns)
    bad = int((~_finite(source)).sum())
    if bad:
        yield f"{bad} of {len(source.ups)} attitudes are not finite; they are left out, see what publishes them"
    if not known.all():
        first_s, last_s = ((stamps_ns[~known] - stamps_ns[0]) * NS)[[0, -1]]
        text = f"{int((~known).sum())} of {n} scans, from {first_s:.1f} to {last_s:.1f} s, have no attitude in 0.5 s"
        yield f"{text}; they are not used: record it for the whole log, or cut the log with --start and --end"
    tilts_rad = attitude.tilts_at(stamps_ns[known])
    if (steep := tilts_rad > MOST_RAD).any():
        text = (
            f"{int(steep.sum())} of {n} scans are tilted by more than 60 deg, by up to {tilts_rad.max() / DEG:.0f} deg"
        )
        yield f"{text}; they are not used, check its axes (x forward, z up) and the mounting"
    if source.kind != "imu" and not attitude.has_heights:
        yield "the heights (position.z) are not all above the floor; they are not used, and there are no slices"


def _finite(source: TopicAttitude) -> NDArray[np.bool_]:
    """Return which attitudes are finite, (n,); an inertial sensor knows no height."""
    known = np.isfinite(source.ups).all(axis=1)
    return np.asarray(known if source.kind == "imu" else known & np.isfinite(source.height_m))
