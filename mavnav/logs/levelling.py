"""The attitude of the laser over time, by which scans are levelled, and the ceiling, where a tilted laser sees it."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from math import inf
from typing import Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.scan import Scan, level_scan
from mavnav.units import DEG, NS

Floats = NDArray[np.float64]

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
