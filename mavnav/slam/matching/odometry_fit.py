"""How well odometry predicts a tracked path: time offset, scales and noise, by least squares over motions of a second.

Single steps show quantization and jitter of stamps; a second of motion shows what odometry is good for. The fifth of
the motions that fits worst does not count: slips, wrong matches, the laser carried.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any, Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import Pose, Trajectory, between, correct_path
from mavnav.slam.matching.motion_model import GAP_S, Odometry
from mavnav.units import NS

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


WINDOW_S: Final = 1.0
"""Time over which motions are compared, s."""

LEAST_WINDOWS, MOST_WINDOWS = 20, 1000
"""Numbers of motions: fewer show nothing; of more, some at even distances are enough."""

KEPT: Final = 0.8
"""Share of the motions that counts, those that fit best."""

LEAST_MOTION: Final = 0.05
"""RMS motion in a second that shows anything, m; a radian counts as a meter."""

LEAST_ERROR: Final = 0.03
"""Share of the motion that is wrong at least: of the track, too. Smaller differences between fits show nothing."""

NEIGHBOURS, LONGEST_STEP = 10, 3.0
"""Scans on either side over which stamps are averaged, and step in median steps that is a gap between them."""

UNITS: Final = (1.0, 0.01, 0.001)
"""Meters of what odometry may count in."""

STEP_S: Final = 0.02
COARSE_S, FINE_S = 0.1 * np.arange(-10, 11), STEP_S * np.arange(-4, 5)
"""Offsets that are tried, s, and those tried around the best of them."""

OTHER_S, DISTINCT = 0.25, 1.1
"""Offsets that are farther away than that are others; their least error must be so many times that of the best."""

REMEMBERED: Final = 1 << 14
"""Number of poses that a lookup remembers: a scan asks nine times for two of them, and every further track again."""

SURE: Final = 2.0
"""Standard deviations by which a scale differs from 1, else it is 1."""


class OdometryFit(NamedTuple):
    """What corrects odometry, and how well it then fits.

    ``offset_s`` is added to its stamps, the scales are factors on its distances and turns. ``noise_m_per_m`` and
    ``noise_rad_per_rad`` are RMS errors over a second as shares of the motion; ``error`` is that of both together, and
    ``LEAST_ERROR``. ``mean_stamps`` says that it fits at the averaged stamps of the scans.
    """

    offset_s: float = 0.0
    distance_scale: float = 1.0
    turn_scale: float = 1.0
    noise_m_per_m: float = 0.0
    noise_rad_per_rad: float = 0.0
    error: float = 0.0
    mean_stamps: bool = False


GOOD_ODOMETRY: Final = OdometryFit()
"""Odometry that needs no correction."""


class LogOdometry(Struct, frozen=True):
    """Odometry of a log: the path of the base, where the laser sits on it; stamps (n,) of all scans, if known."""

    odom_T_base: Trajectory
    base_T_laser: Pose = Pose()
    scans_ns: NDArray[np.int64] | None = None

    def lookup(self, fit: OdometryFit) -> Odometry:
        """Return the corrected pose of the laser by stamp, ns; None outside, or in a gap of over ``GAP_S``."""
        odom_T_base = correct_path(self.odom_T_base, round(fit.offset_s / NS), fit.distance_scale, fit.turn_scale)
        pose_at = partial(odom_T_base.compose(self.base_T_laser).at, max_gap_ns=round(GAP_S / NS))
        if not fit.mean_stamps or self.scans_ns is None:
            return lru_cache(REMEMBERED)(pose_at)
        averaged_ns = partial(np.interp, xp=self.scans_ns, fp=average_stamps(self.scans_ns))
        return lru_cache(REMEMBERED)(lambda stamp_ns: pose_at(round(float(averaged_ns(stamp_ns)))))

    def without(self, spans_ns: NDArray[np.int64], fit: OdometryFit) -> LogOdometry:
        """Return odometry without its poses in some spans of time (n, 2), first and last stamp of scans, ascending."""
        stamps_ns = self.odom_T_base.stamps_ns + round(fit.offset_s / NS)
        last = np.searchsorted(spans_ns[:, 0], stamps_ns, side="right") - 1
        kept = (last < 0) | (stamps_ns > spans_ns[last, 1])
        return replace(self, odom_T_base=Trajectory(self.odom_T_base.stamps_ns[kept], self.odom_T_base.xyyaw[kept]))

    def with_mean_stamps(self, map_T_laser: Trajectory) -> Trajectory | None:
        """Return a path at the averaged stamps of its scans; None if the scans are unknown."""
        if self.scans_ns is None:
            return None
        averaged_ns = np.interp(map_T_laser.stamps_ns, self.scans_ns, average_stamps(self.scans_ns))
        return replace(map_T_laser, stamps_ns=np.round(averaged_ns).astype(np.int64))


FittedOdometry = tuple[LogOdometry, OdometryFit]
"""Odometry of a log, and what corrects it."""


def average_stamps(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the mean of every stamp (n,) and its neighbours, ns: when scans were taken that are stamped on arrival.

    So many neighbours count on both sides, at most ``NEIGHBOURS`` and none across a gap.
    """
    steps_ns = np.diff(stamps_ns)
    parted = np.flatnonzero(steps_ns > LONGEST_STEP * np.median(steps_ns)) + 1 if len(steps_ns) else steps_ns
    first = np.concatenate(((0,), parted, (len(stamps_ns),)))
    k = np.arange(len(stamps_ns))
    run = np.searchsorted(first, k, side="right")
    beside = np.minimum(np.minimum(k - first[run - 1], first[run] - 1 - k), NEIGHBOURS)
    sums = np.concatenate(((0,), np.cumsum(stamps_ns - stamps_ns[:1])))
    mean_ns = (sums[k + beside + 1] - sums[k - beside]) / (2 * beside + 1)
    averaged: NDArray[np.int64] = stamps_ns[:1] + np.round(mean_ns).astype(np.int64)
    return averaged


def usual_speed(path: Trajectory) -> float:
    """Return the upper quartile of the speeds along a path, m/s; 0 of few poses."""
    if len(path) < LEAST_WINDOWS:
        return 0.0
    moved_m, elapsed_s = np.hypot(*np.diff(path.xyyaw[:, :2], axis=0).T), np.diff(path.stamps_ns) * NS
    return float(np.quantile(moved_m / elapsed_s, 0.75))


def in_meters(odometry: LogOdometry, fastest_m_s: float) -> OdometryFit:
    """Return the correction of odometry in centimeters or millimeters, which is faster than any vehicle; else none."""
    usual_m_s = usual_speed(odometry.odom_T_base)
    units = (unit for unit in UNITS if usual_m_s * unit <= fastest_m_s)
    return OdometryFit(distance_scale=next(units, 1.0))


class _Windows(NamedTuple):
    """Motions of the laser (n,): when they begin and end, s, distances in the base's axes, m, and turns, rad.

    Beside them the path of the base by the odometry: stamps (k,) and steps (k - 1,), s, and x, y, yaw, m and rad,
    without jumps by a turn.
    """

    start_s: Array
    end_s: Array
    moved: Complex
    turned: Array
    odometry_s: Array
    steps_s: Array
    odometry: tuple[Array, Array, Array]


def fit_odometry(odometry: LogOdometry, map_T_laser: Trajectory, used: OdometryFit) -> OdometryFit | None:
    """Return what makes odometry fit a tracked path best; None where too little moves, or is covered.

    The offset stays the one that is ``used`` where others fit about as well, as at constant speed.
    """
    path = odometry.with_mean_stamps(map_T_laser)
    fits = [_fit_offset(odometry, _motions(map_T_laser, odometry), used.offset_s)]
    if path:
        fits.append(_fit_offset(odometry, _motions(path, odometry), used.offset_s)._replace(mean_stamps=True))
    best = min(fits, key=lambda fit: fit.error)
    return best if np.isfinite(best.error) else None


def _fit_offset(odometry: LogOdometry, motions: _Windows, used_s: float) -> OdometryFit:
    """Return the best fit at any offset; at the one that is used where others fit about as well."""
    fits = {offset_s: _fit(odometry, motions, offset_s) for offset_s in COARSE_S.tolist()}
    best_s = min(fits, key=lambda offset_s: fits[offset_s].error)
    fits |= {offset_s: _fit(odometry, motions, offset_s) for offset_s in (best_s + FINE_S).tolist()}
    best_s = min(fits, key=lambda offset_s: fits[offset_s].error)
    others = [fit.error for offset_s, fit in fits.items() if abs(offset_s - best_s) > OTHER_S]
    distinct = min(others) > DISTINCT * fits[best_s].error
    return _fit(odometry, motions, _vertex_s(odometry, motions, best_s) if distinct else used_s)


def _vertex_s(odometry: LogOdometry, motions: _Windows, best_s: float) -> float:
    """Return where the parabola through the squared errors at the best offset and ``STEP_S`` beside it is least, s."""
    before, at, after = (_fit(odometry, motions, best_s + k * STEP_S).error ** 2 for k in (-1, 0, 1))
    bend = before - 2.0 * at + after
    beside = float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend > 0.0 else 0.0
    return round(best_s + STEP_S * beside, 3)


def with_noise(odometry: LogOdometry, map_T_laser: Trajectory, used: OdometryFit) -> OdometryFit:
    """Return a correction with the noise of the odometry beside a path; its error is infinite if nothing shows it."""
    path = (odometry.with_mean_stamps(map_T_laser) if used.mean_stamps else None) or map_T_laser
    return _fit(odometry, _motions(path, odometry), used.offset_s, used)._replace(mean_stamps=used.mean_stamps)


def share_of_turns(odometry: LogOdometry, map_T_laser: Trajectory, used: OdometryFit) -> float:
    """Return the turns over a second by odometry as a share of those of a path, by least squares; 0 without turns."""
    motions = _motions(map_T_laser, odometry)
    base, covered = _by_odometry(motions, used.offset_s)
    turned = motions.turned[covered]
    return float(np.vdot(base[:, 2], turned)) / max(float(np.vdot(turned, turned)), 1e-9)


def a_second_apart(stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows (n,) and (n,) of stamps between which lies ``WINDOW_S`` or more, but not twice as much."""
    ends = np.searchsorted(stamps_ns, stamps_ns + round(WINDOW_S / NS))
    begins = np.flatnonzero(ends < len(stamps_ns))
    begins = begins[(stamps_ns[ends[begins]] - stamps_ns[begins]) * NS < 2.0 * WINDOW_S]
    return begins, ends[begins]


def _motions(map_T_laser: Trajectory, odometry: LogOdometry) -> _Windows:
    """Return the motions of a path over a second."""
    stamps_ns = map_T_laser.stamps_ns
    starts, ends = a_second_apart(stamps_ns)
    if len(starts) > MOST_WINDOWS:
        some = np.linspace(0, len(starts) - 1, MOST_WINDOWS).astype(np.intp)
        starts, ends = starts[some], ends[some]
    moved = between(map_T_laser.xyyaw[starts], map_T_laser.xyyaw[ends])
    in_base = (moved[:, 0] + 1j * moved[:, 1]) * np.exp(1j * odometry.base_T_laser.yaw_rad)
    (x_m, y_m, yaw_rad), path_ns = odometry.odom_T_base.xyyaw.T, odometry.odom_T_base.stamps_ns
    start_s, end_s, odometry_s = ((ns - path_ns[0]) * NS for ns in (stamps_ns[starts], stamps_ns[ends], path_ns))
    columns = (x_m, y_m, np.unwrap(yaw_rad))
    return _Windows(start_s, end_s, in_base, moved[:, 2], odometry_s, np.diff(path_ns) * NS, columns)


def _fit(odometry: LogOdometry, motions: _Windows, offset_s: float, scales: OdometryFit | None = None) -> OdometryFit:
    """Return the scales that fit best at an offset, or the error of given ones; infinite where too little is covered.

    A scale that the motions do not show to differ from 1 is 1.
    """
    base, covered = _by_odometry(motions, offset_s)
    moved, turned = motions.moved[covered], motions.turned[covered]
    _, distance, turn, *_ = scales or GOOD_ODOMETRY
    if len(turned) < LEAST_WINDOWS:
        return OdometryFit(offset_s, distance, turn, error=np.inf)
    driven, turns, arm = base[:, 0] + 1j * base[:, 1], base[:, 2], complex(*odometry.base_T_laser[:2])
    if scales is None:  # other units are too far from 1 for least squares with a prior
        beside = np.abs(moved - (np.exp(1j * turns) - 1.0) * arm)
        distance = float(np.median(beside) / max(np.median(np.abs(driven)), 1e-9))
    overlapping = max(1.0, len(motions.start_s) * WINDOW_S / np.ptp(motions.start_s))
    last = int(KEPT * (len(turned) - 1))
    for again in (*(3 * (scales is None,)), False):
        ahead = driven * np.exp(0.5j * (turn - 1.0) * turns)
        wanted = moved - (np.exp(1j * turn * turns) - 1.0) * arm
        off = np.abs(distance * ahead - wanted)
        off_rad = np.abs((turn * turns - turned + np.pi) % (2.0 * np.pi) - np.pi)
        total = np.hypot(off, off_rad)
        kept = total <= np.partition(total, last)[last]
        before = distance, turn
        if again:
            distance = _scale(ahead[kept], wanted[kept], _mean2(off[kept]) * overlapping)
            turn = _scale(turns[kept], turned[kept], _mean2(off_rad[kept]) * overlapping)
        if (distance, turn) == before:
            break  # further rounds are the same
    errors = np.sqrt((_mean2(off[kept]), _mean2(off_rad[kept])))
    sizes = np.sqrt((_mean2(moved[kept]), _mean2(turned[kept])))
    size = float(np.hypot(*np.maximum(sizes, np.sqrt((_mean2(distance * ahead[kept]), _mean2(turn * turns[kept]))))))
    if size < LEAST_MOTION:
        return OdometryFit(offset_s, distance, turn, error=np.inf)
    of_path, of_turns = (errors / np.maximum(sizes, 1e-9)).tolist()
    return OdometryFit(
        offset_s, distance, turn, of_path, of_turns, float(np.hypot(np.hypot(*errors) / size, LEAST_ERROR))
    )


def _scale(driven: NDArray[Any], wanted: NDArray[Any], error2: float) -> float:
    """Return the factor on some motions that leads to others, by least squares; 1 if it may be 1, or is not positive.

    ``error2`` is the squared error of a motion times the number of motions that overlap. Others that are hardly any
    show their noise alone.
    """
    if _mean2(wanted) < LEAST_MOTION**2:
        return 1.0
    driven2 = float(np.vdot(driven, driven).real) + 1e-12
    scale = float(np.vdot(driven, wanted).real) / driven2
    return scale if scale > 0.0 and (scale - 1.0) ** 2 * driven2 > SURE**2 * error2 else 1.0


def _mean2(values: NDArray[Any]) -> float:
    return float(np.square(np.abs(values)).sum()) / len(values)  # nearly half the time of mean()


def _by_odometry(motions: _Windows, offset_s: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the motions of the base (m, 3) by the odometry, m, m, rad, and which (n,) it covers without a gap."""
    at_s, times = motions.odometry_s, np.array((motions.start_s, motions.end_s)) - offset_s
    after = np.searchsorted(at_s, times)
    inside = (after > 0) & (after < len(at_s))
    row = np.clip(after, 1, max(len(at_s) - 1, 1))
    gapless = (motions.steps_s[row - 1] <= GAP_S) if len(at_s) > 1 else inside
    covered: NDArray[np.bool_] = np.asarray((inside & gapless).all(axis=0))
    start, end = (np.column_stack([np.interp(some[covered], at_s, c) for c in motions.odometry]) for some in times)
    return between(start, end), covered
