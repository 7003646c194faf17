"""Scans made of scans: levelled by the attitude of the laser, or several lasers of one base merged.

With the attitude over time comes the ceiling, where a tilted laser sees it. Scans of nearest stamps are merged to one
virtual scan in the frame of the base.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from math import copysign, hypot, inf, isfinite, tau
from typing import Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import Pose, nearest_rows
from mavnav.scan import Floats, LaserSpec, Scan, level_scan, nearest_returns, on_bearings
from mavnav.units import DEG, NS

GAP_NS: Final = 500_000_000
"""Scans farther in time from the nearest attitude have none; attitudes are interpolated over twice as much."""

MOST_RAD: Final = 60 * DEG
"""Scans that are tilted by more are not used: their plane meets hardly any wall."""

MOST_SCANS: Final = 3000
"""The ceiling, many returns at one height and hardly any above, is sought in the first so many scans."""

LEAST_TILT_RAD: Final = 2 * DEG
HIGHEST_M: Final = 100.0
BIN_M: Final = 0.05
WIDTHS: Final = (1, 2, 4)
"""Heights are counted in bins of this size, of which a ceiling fills so many, by the noise of the attitude."""

LEAST_RETURNS, TIMES_BELOW, BELOW, SHARE_ABOVE = 100, 2.0, 6, 0.05
"""A ceiling has so many returns, so many times as dense as in the next bins below, and that share of them above."""

LEAST_SPREAD_RAD: Final = 1.5 * DEG
"""Standard deviation of the tilts that show it: at one tilt a wall is met at one height, too."""


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


def ceiling_height_m(scans: Iterable[Scan], attitude: RecordedAttitude) -> float:
    """Return the height of the ceiling above the floor, m, from scans that are not levelled; inf if none is seen."""
    if not attitude.has_heights or attitude.tilt_rad.max() < LEAST_TILT_RAD or attitude.height_m.max() > HIGHEST_M:
        return inf
    above = [_above(scan, attitude) for scan in islice(scans, MOST_SCANS)]
    heights_m, tilts_rad = np.concatenate([np.zeros((0, 2)), *above]).T
    counts = np.bincount((heights_m / BIN_M).astype(np.int64))
    for width in WIDTHS:
        peak = _peak(counts, width)
        if peak:
            within = np.abs(heights_m / BIN_M - peak + 0.5 * width) <= 0.5 * width
            return float(heights_m[within].mean()) if tilts_rad[within].std() >= LEAST_SPREAD_RAD else inf
    return inf


def _peak(counts: NDArray[np.int64], width: int) -> int:
    """Return the end of the highest bins, of a width, that may be a ceiling; 0 if there are none."""
    for end in range(len(counts), BELOW + width - 1, -1):
        here, above = int(counts[end - width : end].sum()), int(counts[end:].sum())
        below = counts[end - width - BELOW : end - width].mean() * width
        if above > SHARE_ABOVE * max(here, LEAST_RETURNS):
            return 0
        if here >= LEAST_RETURNS and here >= TIMES_BELOW * below:
            return end
    return 0


def _above(scan: Scan, attitude: RecordedAttitude) -> Floats:
    """Return height, m, and tilt, rad, of the returns that lie above the laser, (n, 2)."""
    roll, pitch, height = (v[0] for v in attitude.at(np.array([float(scan.stamp_ns - int(attitude.stamps_ns[0]))])))
    up = np.array([-np.sin(pitch), np.sin(roll) * np.cos(pitch)])
    rise_m = scan.points() @ up
    heights_m = height + rise_m[rise_m > 2 * BIN_M]
    return np.column_stack((heights_m, np.full(len(heights_m), np.hypot(*up))))


FRAME: Final = "merged_lasers"
"""The frame of virtual scans: that of the base."""

SAME_PLACE_M, SAME_TIME_S = 1e-4, 1e-6
"""Lasers no farther from the base keep their bearings; beams whose times are no farther from a steady sweep are one."""


class Mounted(Struct, frozen=True):
    """A laser, its pose on the base, and the stamps (n,) of its scans, ns."""

    spec: LaserSpec
    base_T_laser: Pose
    stamps_ns: NDArray[np.int64]


def partners(stamps_ns: NDArray[np.int64], others_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return for each scan the number of the other laser's scan that goes with it, (n,); -1 for none.

    Two scans go together if each is nearest to the other, and they are at most half a period apart. Both (n,) and (m,)
    ascend.
    """
    there, back = nearest_rows(others_ns, stamps_ns), nearest_rows(stamps_ns, others_ns)
    half_ns = 0.5 * float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else np.inf
    mutual = back[there] == np.arange(len(stamps_ns))
    return np.where(mutual & (np.abs(others_ns[there] - stamps_ns) <= half_ns), there, -1)


def virtual_laser(lasers: Sequence[Mounted]) -> LaserSpec:
    """Return the laser of the virtual scans: the bearings of the first, finely enough for all.

    It covers what all lasers cover, and the whole turn if one of them is not on the base's origin.
    """
    first = lasers[0].spec
    step = copysign(min(abs(m.spec.angle_step_rad) for m in lasers), first.angle_step_rad)
    offsets_m = [hypot(*m.base_T_laser[:2]) for m in lasers]
    start, end = _span(lasers, step)
    beams, most = round((end - start) / step) + 1, int(tau / abs(step) + 1e-6)
    if max(offsets_m) > SAME_PLACE_M or beams > most:
        beams = most
    farthest_m = [m.spec.range_max_m + off for m, off in zip(lasers, offsets_m, strict=True)]
    nearest_m = min(m.spec.range_min_m for m in lasers) if max(offsets_m) <= SAME_PLACE_M else 0.0
    return replace(
        first, angle_min_rad=start, angle_step_rad=step, beams=beams, range_min_m=nearest_m, range_max_m=max(farthest_m)
    )


def _span(lasers: Sequence[Mounted], step: float) -> tuple[float, float]:
    """Return the first and the last bearing on the base, rad, in the direction of ``step``."""
    sign, start, end = copysign(1.0, step), inf, -inf
    for spec, base_T_laser in ((m.spec, m.base_T_laser) for m in lasers):
        first = spec.angle_min_rad + base_T_laser.yaw_rad
        low, high = sorted((sign * first, sign * (first + spec.angle_step_rad * (spec.beams - 1))))
        turn = tau * round((start + end - low - high) / (2 * tau)) if isfinite(start) else 0.0
        start, end = min(start, low + turn), max(end, high + turn)
    return sign * start, sign * end


def virtual_scan(parts: Sequence[tuple[Scan, Pose]], laser: LaserSpec) -> Scan:
    """Return scans of several lasers, each with ``base_T_laser``, as one of the virtual laser, on the base.

    Every return falls on the nearest bearing; of several the nearest counts. Its range is that of its surface at this
    bearing. The stamp is that of the first scan.
    """
    stamp_ns = parts[0][0].stamp_ns
    returns = [_returns(scan, base_T_laser, laser, stamp_ns) for scan, base_T_laser in parts]
    beam, range_m, time_s = (np.concatenate(column) for column in zip(*returns, strict=True))
    nearest = nearest_returns(beam, range_m, np.ones(len(beam), np.bool_))
    beam = beam[nearest]
    ranges_m, times_s = np.full(laser.beams, np.nan), np.zeros(laser.beams)
    ranges_m[beam], times_s[beam] = range_m[nearest], time_s[nearest]
    steady_s = laser.time_increment_s * beam
    if np.abs(times_s[beam] - steady_s).max(initial=0.0) <= SAME_TIME_S:
        return Scan(stamp_ns, ranges_m, laser)
    return Scan(stamp_ns, ranges_m, replace(laser, time_increment_s=0.0), times_s)


def _returns(
    scan: Scan, base_T_laser: Pose, laser: LaserSpec, stamp_ns: int
) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return for every return of a scan the virtual beam, its range, m, and its time since ``stamp_ns``, s."""
    c, s = np.cos(base_T_laser.yaw_rad), np.sin(base_T_laser.yaw_rad)
    x, y = (scan.ranges_m[:, None] * scan.spec.directions).T
    x, y = base_T_laser.x_m + c * x - s * y, base_T_laser.y_m + s * x + c * y
    beam, range_m, kept = on_bearings(x, y, laser, scan.spec.angle_step_rad)
    since_s = (scan.stamp_ns - stamp_ns) * NS
    time_s: Floats = since_s + scan.spec.time_increment_s * np.arange(scan.spec.beams, dtype=np.float64)
    return beam[kept], range_m[kept], time_s[kept]


def virtual_scans(lasers: Sequence[Mounted], streams: Sequence[Iterator[Scan]], laser: LaserSpec) -> Iterator[Scan]:
    """Yield a virtual scan for every scan of the first laser, with those of the others that go with it."""
    numbers = [partners(lasers[0].stamps_ns, m.stamps_ns).tolist() for m in lasers[1:]]
    others = [enumerate(stream) for stream in streams[1:]]
    for k, scan in enumerate(streams[0]):
        parts = [(scan, lasers[0].base_T_laser)]
        for mounted, chosen, stream in zip(lasers[1:], numbers, others, strict=True):
            if chosen[k] >= 0:
                partner = next(other for number, other in stream if number == chosen[k])
                parts.append((partner, mounted.base_T_laser))
        yield virtual_scan(parts, laser)
