"""The jitter of the scans taken out of the finished trajectory, as far as the scans cannot tell (docs/method.md)."""

from __future__ import annotations

from itertools import chain
from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels.rts_smoother import smooth
from mavnav.profiling import timed
from mavnav.slam.steps import jumps, tracked_trajectory
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from mavnav.slam.steps import Steps
    from mavnav.slam.track import Track

FEWEST = 10
"""Poses in a row from which a stretch tells how much of its motion is jitter."""

STIFFNESSES = 2.0 ** np.arange(-6, 32, 0.5)
"""That are tried, in periods to the fourth: from what leaves the way alone to a window of some 250 scans."""

CANNOT_TELL = 1 / 7
"""A scan tells its place to about this share of its points' distances from the walls, of which some fifty count."""

LONGEST_S = 1.2
"""A longer gap parts two stretches."""


def smooth_jitter(track: Track) -> Track:
    """Smooth the positions of the finished trajectory; the steps themselves take them."""
    if track.refiner:
        smooth_positions(track.steps, track.motion.period_s)
    return track


@timed("smoothing")
def smooth_positions(steps: Steps, period_s: float) -> None:
    """Move the steps to smooth positions: the jitter of the scans would lengthen every way, and move a rest.

    How much of the motion is jitter is asked of each stretch itself: positions with white noise, of a way whose
    velocity walks at random, with the likeliest share of both. Where the median scan would move farther than it can
    tell, less is smoothed. Headings stay: scans tell them well.
    """
    poses, stamps_ns, costs_m2 = (steps.column(name) for name in ("map_T_laser", "stamp_ns", "cost_m2"))
    for stretch in stretches(steps):
        periods = np.maximum(np.round(np.diff(stamps_ns[stretch]) * NS / period_s), 1.0)
        told_m = CANNOT_TELL * np.sqrt(np.median(costs_m2[stretch]))
        steps.move(stretch, _smooth(poses[stretch, :2], periods, told_m))


def stretches(steps: Steps) -> list[NDArray[np.intp]]:
    """Return the numbers of tracked steps that follow each other without a long gap or a leap, ``FEWEST`` or more."""
    tracked, way = np.flatnonzero(steps.column("tracked")), tracked_trajectory(steps)
    parted = (np.diff(way.stamps_ns) * NS > LONGEST_S) | jumps(way)[1]
    runs = np.split(tracked, np.flatnonzero(parted) + 1)
    return [run for run in runs if len(run) >= FEWEST]


def _smooth(xy_m: NDArray[np.float64], periods: NDArray[np.float64], told_m: float) -> NDArray[np.float64]:
    """Return positions (n, 2) smoothed as much as they ask for, but by no more than the scans can tell."""
    middle, out = xy_m.mean(axis=0), np.empty(xy_m.shape)
    centred = xy_m - middle
    likely = [smooth(centred, periods, stiffness, out) for stiffness in STIFFNESSES]
    way_m = xy_m
    for stiffness in reversed(STIFFNESSES[: int(np.argmax(likely)) + 1]):
        smooth(centred, periods, stiffness, out)
        if np.median(np.linalg.norm(out + middle - xy_m, axis=1)) <= told_m:
            way_m = out + middle
            break
    for rest in rests(way_m, told_m):
        way_m[rest] = xy_m[rest].mean(axis=0)
    return way_m


def rests(xy_m: NDArray[np.float64], within_m: float) -> Iterator[slice]:
    """Give the stretches of ``FEWEST`` positions (n, 2) or more that stay in a box of this half diagonal, m."""
    first = 0
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for k, (x, y) in enumerate(chain(map(np.ndarray.tolist, xy_m), [(np.inf, np.inf)])):
        low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
        if hypot(high_x - low_x, high_y - low_y) > 2 * within_m:
            if k - first >= FEWEST:
                yield slice(first, k)
            first, low_x, high_x, low_y, high_y = k, x, x, y, y
