"""What a calibration found, quantity by quantity: value and uncertainty, or why the log does not show it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.metrics.calibration.motion import DISTANCE, LONGEST_OFFSET_S, STEP_S, Array, Complex, Motions
from mavnav.metrics.calibration.solve import LEAST_STEPS, Estimate, FirstEstimate, estimate, start_of
from mavnav.units import DEG, MM

LEAST_TURN_RAD, LEAST_PATH_M = 90 * DEG, 1.0
"""Motion that a log must have for what turns show, and for what straight motion shows."""

STILL_M, STILL_RAD = 10 * MM, 0.5 * DEG
"""Steps that are smaller in both are taken for rest, and do not count as motion."""

STRIDES = (1, 10)
"""Numbers of steps over which motion is distinguished from rest: the single steps of a slow robot are small."""

SLOWEST_ODOM_S: Final = 0.6
"""Longest period of the odometry: between its poses the motion is interpolated, which at 1 Hz biases all quantities."""

ALIKE, MOST_SCALE = 0.5, 2.0
"""Least correlation of the turns of one robot; odometry that is wrong by a larger factor is in other units."""

DISTINCT = 100.0
"""Another offset must be so much less likely (twice the logarithm): up to 30 by chance at constant speed."""

TURN_MORE: Final = "record turns in both directions, 360 deg in all"
DRIVE_MORE: Final = "record a drive of 3 m or more"
CHANGE_MORE: Final = "record starts, stops and turns"
ENOUGH_TURN_RAD, ENOUGH_PATH_M = 360 * DEG, 3.0
"""What the advice asks for."""
BETTER: Final = "drive longer, more slowly, or use better odometry"
"""The advice where the log has that already."""


class QuantityKind(NamedTuple):
    """A quantity: its name and unit, how many of its unit an SI unit has, and what the log takes for it (SI).

    Wider intervals than ``widest`` (SI) are refused, with the ``advice``.
    """

    name: str
    unit: str
    per_si: float
    assumed: float
    widest: float
    advice: str


KINDS: Final = (
    QuantityKind("x_m", "m", 1.0, 0.0, 0.1, TURN_MORE),
    QuantityKind("y_m", "m", 1.0, 0.0, 0.1, TURN_MORE),
    QuantityKind("yaw_deg", "deg", 1 / DEG, 0.0, 5 * DEG, DRIVE_MORE),
    QuantityKind("offset_s", "s", 1.0, 0.0, 0.1, CHANGE_MORE),
    QuantityKind("distance_scale", "", 1.0, 1.0, 0.05, DRIVE_MORE),
    QuantityKind("turn_scale", "", 1.0, 1.0, 0.05, TURN_MORE),
    QuantityKind("veer_deg_per_m", "deg/m", 1 / DEG, 0.0, 5 * DEG, DRIVE_MORE),
)
"""In the order of the parameters."""


class Travel(Struct, frozen=True):
    """How much the laser and its base moved: m and rad along the path, over so many steps."""

    path_m: float
    turned_rad: float
    odom_path_m: float
    odom_turned_rad: float
    steps: int


class QuantityValue(Struct, frozen=True):
    """A quantity in its unit: value and half-width of its 95 % interval, or why it is ``refused``."""

    kind: QuantityKind
    value: float | None = None
    ci95: float | None = None
    refused: str = ""


class Calibration(Struct, frozen=True):
    """All quantities in the order of `KINDS`, the motion behind them, and the fit; None where there was none.

    ``refused`` is why nothing at all could be estimated. ``mirrored``: the scans are those of a laser that is the other
    way up than the log says; None where turns do not show it.
    """

    quantities: tuple[QuantityValue, ...]
    motion: Travel
    refused: str = ""
    mirrored: bool | None = None
    fit: Estimate | None = None


def calibration_of(motions: Motions, *, doubtful: bool = False) -> Calibration:
    """Estimate what the motions show, and refuse the rest.

    Of a ``doubtful`` track the halves must agree, and the intervals include those of both.
    """
    motion = motion_of(motions)
    if why := _unusable(motions, motion):
        return refusal(why, motion)
    turning = motion.turned_rad >= LEAST_TURN_RAD
    start = start_of(motions, turning=turning)
    if why := _contradiction(start, motion):
        return refusal(why, motion)
    fit, sided = estimate(motions, start), motions.mirror() if start.mirrored else motions
    halves = [estimate(half, start._replace(mirrored=False)) for half in sided.halves()] if doubtful else []
    quantities = tuple(_quantity(k, fit, motion, start, halves) for k in range(len(KINDS)))
    return Calibration(quantities, motion, "", fit.mirrored if turning else None, fit)


def refusal(why: str, motion: Travel) -> Calibration:
    """Return a calibration in which nothing could be estimated."""
    return Calibration(tuple(QuantityValue(kind, refused=why) for kind in KINDS), motion, why)


def motion_of(motions: Motions) -> Travel:
    """Return how much laser and base moved, and the number of steps of no gap."""
    gaps = np.concatenate(((0,), np.cumsum(~motions.linked)))
    laser, base = (motions.where, motions.heading_rad), motions.base(0.0)
    return Travel(*_size(*laser, gaps), *_size(*base, gaps), int(motions.linked.sum()))


def _size(where: Complex, heading_rad: Array, gaps: NDArray[np.int64]) -> tuple[float, float]:
    """Return path, m, and turns, rad: by single steps, or by several where the motion is slow."""
    sizes = []
    for stride in STRIDES:
        moved_m, turned_rad = np.abs(np.diff(where[::stride])), np.abs(np.diff(heading_rad[::stride]))
        some = (np.diff(gaps[::stride]) == 0) & ((moved_m > STILL_M) | (turned_rad > STILL_RAD))
        sizes.append((float(moved_m[some].sum()), float(turned_rad[some].sum())))
    path_m, turned_rad = np.max(sizes, axis=0).tolist()
    return path_m, turned_rad


def _unusable(motions: Motions, motion: Travel) -> str:
    """Return why motions show nothing at all, or the odometry comes too rarely; empty where they may."""
    if motion.steps < LEAST_STEPS:
        text = f"{motion.steps} steps of {STEP_S} s have tracked scans and odometry"
        return f"{text}; {LEAST_STEPS} are needed: record half a minute or more"
    if motion.path_m < LEAST_PATH_M and motion.turned_rad < LEAST_TURN_RAD:
        text = f"the laser moves by {motion.path_m:.2f} m and turns by {motion.turned_rad / DEG:.0f} deg in all"
        return f"{text}; {DRIVE_MORE}, with turns of 360 deg in all"
    if motion.odom_path_m < 0.1 * motion.path_m and motion.odom_turned_rad < 0.1 * motion.turned_rad:
        return "the odometry stands still while the laser moves; see that the wheel encoders report"
    if (period_s := float(np.median(np.diff(motions.odom_s)))) > SLOWEST_ODOM_S:
        return f"the odometry comes every {period_s:.2g} s; record it at 10 Hz or more"
    return ""


def _contradiction(start: FirstEstimate, motion: Travel) -> str:
    """Return why the odometry cannot be that of the laser's base; empty where it may."""
    scale = float(start.parameters[DISTANCE])
    if motion.turned_rad >= LEAST_TURN_RAD and start.correlation < ALIKE:
        return f"odometry and laser turn differently (correlation {start.correlation:.2f}); see whose odometry it is"
    if start.distinct >= DISTINCT and abs(start.offset_s) > 0.98 * LONGEST_OFFSET_S:
        return f"no time offset of up to {LONGEST_OFFSET_S:g} s fits laser and odometry; synchronize their clocks"
    if motion.odom_path_m >= LEAST_PATH_M and not 1.0 / MOST_SCALE < scale < MOST_SCALE:
        return f"the distances of odometry and laser differ by a factor of {scale:.3g}; see the units of the odometry"
    return ""


def _quantity(
    number: int, fit: Estimate, motion: Travel, start: FirstEstimate, halves: Sequence[Estimate]
) -> QuantityValue:
    kind, value, ci95 = KINDS[number], float(fit.values[number]), float(fit.ci95[number])
    parts = [(float(half.values[number]), float(half.ci95[number])) for half in halves]
    ci95 = max(ci95, *(abs(part - value) + own for part, own in parts)) if parts else ci95
    if why := _disagreement(kind, parts) or _doubt(kind, ci95, motion, start):
        return QuantityValue(kind, refused=why)
    return QuantityValue(kind, value * kind.per_si, ci95 * kind.per_si)


def _disagreement(kind: QuantityKind, parts: Sequence[tuple[float, float]]) -> str:
    """Return how the halves of a doubtful track, each a value and its interval, disagree; empty where they agree."""
    if not parts:
        return ""
    (first, first_ci95), (second, second_ci95) = parts
    if abs(first - second) <= np.hypot(first_ci95, second_ci95):
        return ""
    values = f"{first * kind.per_si:.3g} and {second * kind.per_si:.3g} {kind.unit}".rstrip()
    return f"the halves of the log do not agree: {values}"


def _doubt(kind: QuantityKind, ci95: float, motion: Travel, start: FirstEstimate) -> str:
    """Return why the log does not show a quantity; empty where it does."""
    if kind.advice == TURN_MORE and motion.turned_rad < LEAST_TURN_RAD:
        return f"the laser turns by {motion.turned_rad / DEG:.0f} deg in all; {TURN_MORE}"
    if kind.advice == DRIVE_MORE and motion.odom_path_m < LEAST_PATH_M:
        return f"the base moves by {motion.odom_path_m:.2f} m in all; {DRIVE_MORE}"
    if kind.advice == CHANGE_MORE and start.distinct < DISTINCT:
        return f"speed and turn rate change too little, and other offsets fit as well; {CHANGE_MORE}"
    if ci95 > kind.widest:
        return f"uncertain by {ci95 * kind.per_si:.2g} {kind.unit}".rstrip() + f"; {_advice(kind, motion)}"
    return ""


def _advice(kind: QuantityKind, motion: Travel) -> str:
    """Return what to record for a shorter interval."""
    turned, driven = motion.turned_rad >= ENOUGH_TURN_RAD, motion.odom_path_m >= ENOUGH_PATH_M
    return BETTER if {TURN_MORE: turned, DRIVE_MORE: driven}.get(kind.advice) else kind.advice
