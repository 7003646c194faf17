"""Several lasers of one base, merged: scans of nearest stamps as one virtual scan in the frame of the base."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import copysign, hypot, inf, isfinite, tau
from typing import Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import Pose, nearest_rows
from mavnav.scan import LaserSpec, Scan, nearest_returns, on_bearings
from mavnav.units import NS

Floats = NDArray[np.float64]

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
