"""Refine the finished track and its map: steps 12 to 15 (docs/method.md), and the poses of a calibration."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from functools import partial
from itertools import chain
from math import hypot

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.kernels.scans.rts_smoother import smooth
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.profiling import as_stage
from mavnav.scan import Scan
from mavnav.slam.matching.motion_model import LONGEST_S, Motion, motions_along
from mavnav.slam.matching.observability import UNMEASURED, degeneracy_warning
from mavnav.slam.matching.steps import Step, Steps, jumps, tracked_trajectory
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.retries.unused_odometry import not_observed, observed_by_odometry
from mavnav.slam.track import Track
from mavnav.units import DEG, NS

NO_EVIDENCE = (UNMEASURED, *(0.0,) * 7)
"""Observability, visibility conflicts and Hessian of a scan without a pose."""

NOTABLE_CONFLICTS, SKEWED_RAD = 0.01, 2 * DEG
"""Visibility conflicts that raise doubt, and turn during a sweep from which they may be due to the turn alone."""


def remove_dynamic_cells(track: Track, refiner: Refiner) -> Track:
    """Remove the hits of people and other moving things from the map."""
    refiner.remove_dynamic_cells()
    return track


def refine_poses(track: Track, refiner: Refiner) -> Track:
    """Match every tracked scan against the finished map, and warn where its geometry is degenerate.

    The steps are changed in place, because there may be many. Observability, visibility conflicts and Hessians of the
    scans are stored in its findings.
    """
    evidence = array("d")
    motions = motions_along(tracked_trajectory(track.steps), track.motion)
    coming = refine_steps(track.log_scans(), track.steps, refiner, evidence, motions)
    for step in track.report_progress(coming, "final pass"):
        track.steps[step.index] = step
    columns = np.array(evidence).reshape(-1, 8)
    observed = columns[:, 0]
    track = track.with_findings(observed=observed, conflicts=columns[:, 1], hessians=columns[:, 2:])
    if not len(observed):
        return track
    stamps_ns = track.steps.column("stamp_ns")[: len(observed)]  # fewer where the run is stopped
    covered = track.motion.odometry_at(stamps_ns)
    warning = degeneracy_warning(
        track.steps, np.where(covered, UNMEASURED, observed), partial(not_observed, track)
    ) or degeneracy_warning(track.steps, np.where(covered, observed, UNMEASURED), observed_by_odometry)
    return track.with_warning(warning) if warning and not track.motion.commanded else track


def refine_steps(
    scans: Iterable[Scan],
    steps: Iterable[Step],
    refiner: Refiner,
    evidence: array[float],
    motions: Iterable[Motion] = (),
) -> Iterator[Step]:
    """Match every tracked scan once more against the finished map, close to its pose; yield the steps.

    If the run is stopped and the scans end early, the remaining steps are yielded unchanged. Observability, visibility
    conflicts and Hessian of each of the others are appended to ``evidence``. ``motions`` are those at the tracked
    scans: the map is made of de-skewed scans, with which a scan as recorded conflicts in a turn.
    """
    moving, waiting = iter(motions), iter(steps)
    for scan, step in zip(scans, waiting, strict=False):
        if not step.tracked:
            evidence.extend(NO_EVIDENCE)
            yield step
            continue
        points = refiner.match_points(scan)
        match = refiner.refine(points, step.match)
        observed, hessian = refiner.observability(points, match)
        conflicts, motion = refiner.conflicts(points, match), next(moving, None)
        turn_rad = abs(motion.twist[2]) * scan.sweep_s if motion else 0.0
        if motion and conflicts >= NOTABLE_CONFLICTS and turn_rad >= SKEWED_RAD:
            deskewed = refiner.match_points(scan, motion)
            conflicts = min(conflicts, refiner.conflicts(deskewed, refiner.refine(deskewed, match)))
        evidence.extend((observed, conflicts, *hessian.tolist()))
        yield step._replace(match=match)
    yield from waiting


def draw_map(track: Track, refiner: Refiner) -> Track:
    """Draw the map again, of the scans at their final poses; they were inserted before the whole map was known.

    A given map stays, and the old one if the run is stopped early.
    """
    if not refiner.builds_map:
        return track
    drawn, waiting = GridBuilder(track.method.grid.cell_m), track.steps.column("tracked")
    for step, scan, motion in track.placed_scans("draw map"):
        map_T_mid, waiting[step.index] = step.match.map_T_laser @ refiner.sweep_T_mid(scan, motion), False
        drawn.insert(map_T_mid, *refiner.placed_points(scan, map_T_mid, motion))
    if not waiting.any():
        drawn.remove_dynamic_cells()
        track.method.grid = drawn
    return track


def match_deskewed(track: Track, refiner: Refiner) -> Track:
    """Match every tracked scan once more against the finished map, de-skewed by the motion along the track.

    Where the run is being stopped, the later steps stay as they are.
    """
    steps = Steps(track.steps)
    for step, scan, motion in track.placed_scans():
        match = refiner.refine(refiner.match_points(scan, motion), step.match)
        steps[step.index] = step._replace(match=match)
    return replace(track, steps=steps)


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


@as_stage("smoothing")
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
