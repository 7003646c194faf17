"""Smooth the jitter of the finished trajectory, within the uncertainty of the scans (docs/method.md)."""

from __future__ import annotations

from itertools import chain
from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels.scans.rts_smoother import smooth
from mavnav.profiling import timed
from mavnav.slam.matching.motion_model import LONGEST_S
from mavnav.slam.matching.steps import jumps, tracked_trajectory
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from mavnav.slam.matching.steps import Steps
    from mavnav.slam.methods.method import Refiner
    from mavnav.slam.track import Track

FEWEST = 10
"""Minimum number of consecutive poses for an estimate of the jitter."""

STIFFNESSES = 2.0 ** np.arange(-6, 32, 0.5)
"""Stiffnesses that are tried, in periods to the fourth, from no smoothing to a window of about 250 scans."""

UNCERTAIN_SHARE = 1 / 7
"""Position error of one match as a share of its RMS point-to-line distance (about 1/sqrt(50))."""


def smooth_jitter(track: Track, _refiner: Refiner) -> Track:
    """Smooth the positions of the finished trajectory; the steps are changed in place."""
    smooth_positions(track.steps, track.motion.period_s)
    return track


@timed("smoothing")
def smooth_positions(steps: Steps, period_s: float) -> None:
    """Move the steps to smoothed positions: jitter lengthens every path and moves a laser at rest.

    The model is white noise on the positions of a path whose velocity is a random walk. The most likely ratio of both
    is estimated for each stretch. If the median scan would move farther than its uncertainty, less is smoothed.
    Headings do not change: scans determine them well.
    """
    poses, stamps_ns, costs_m2 = (steps.column(name) for name in ("map_T_laser", "stamp_ns", "cost_m2"))
    for stretch in stretches(steps):
        periods = np.maximum(np.round(np.diff(stamps_ns[stretch]) * NS / period_s), 1.0)
        uncertainty_m = UNCERTAIN_SHARE * np.sqrt(np.median(costs_m2[stretch]))
        steps.move(stretch, _smooth(poses[stretch, :2], periods, uncertainty_m))


def stretches(steps: Steps) -> list[NDArray[np.intp]]:
    """Return the numbers of tracked steps in stretches of ``FEWEST`` or more, without a long gap or a jump within."""
    tracked, path = np.flatnonzero(steps.column("tracked")), tracked_trajectory(steps)
    parted = (np.diff(path.stamps_ns) * NS > LONGEST_S) | jumps(path)[1]
    runs = np.split(tracked, np.flatnonzero(parted) + 1)
    return [run for run in runs if len(run) >= FEWEST]


def _smooth(xy_m: NDArray[np.float64], periods: NDArray[np.float64], uncertainty_m: float) -> NDArray[np.float64]:
    """Return smoothed positions (n, 2), m, of which the median moves by at most the uncertainty of the scans."""
    middle, out = xy_m.mean(axis=0), np.empty(xy_m.shape)
    centred = xy_m - middle
    likely = [smooth(centred, periods, stiffness, out) for stiffness in STIFFNESSES]
    path_m = xy_m
    for stiffness in reversed(STIFFNESSES[: int(np.argmax(likely)) + 1]):
        smooth(centred, periods, stiffness, out)
        if np.median(np.linalg.norm(out + middle - xy_m, axis=1)) <= uncertainty_m:
            path_m = out + middle
            break
    for rest in rests(path_m, uncertainty_m):
        path_m[rest] = xy_m[rest].mean(axis=0)
    return path_m


def rests(xy_m: NDArray[np.float64], within_m: float) -> Iterator[slice]:
    """Yield the stretches of ``FEWEST`` positions (n, 2) or more that stay in a box of this half diagonal, m."""
    first = 0
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for k, (x, y) in enumerate(chain(map(np.ndarray.tolist, xy_m), [(np.inf, np.inf)])):
        low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
        if hypot(high_x - low_x, high_y - low_y) > 2 * within_m:
            if k - first >= FEWEST:
                yield slice(first, k)
            first, low_x, high_x, low_y, high_y = k, x, x, y, y
