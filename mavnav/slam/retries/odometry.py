"""Odometry as a measurement: corrected by what makes it fit the track, and left out only where nothing does."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import Trajectory, motions
from mavnav.slam.findings import TrackedAgain
from mavnav.slam.matching.motion_model import MOST_ERROR
from mavnav.slam.matching.odometry_fit import (
    GOOD_ODOMETRY,
    UNITS,
    LogOdometry,
    OdometryFit,
    fit_odometry,
    share_of_turns,
    with_noise,
)
from mavnav.slam.matching.steps import NEARLY_ALL, Step, Steps, tracked_trajectory
from mavnav.slam.retries.attempt import Attempt
from mavnav.slam.retries.unused_odometry import is_recorded
from mavnav.slam.track import Track, Until
from mavnav.units import DEG, NS

IMPROVED: Final = 0.85
"""Ratio of the errors with and without a correction from which it is applied."""

LEAST_CHANGE: Final = OdometryFit(0.03, 0.03, 0.05)
"""Offset, s, and changes of the scales from which a correction is applied."""

SCALES: Final = (0.4, 2.5)
"""Least and largest factor on distances and turns of wheels that are wrongly calibrated."""

FIRST_CHECK, CHECK_RATIO = 200, 3
"""Number of poses at which a track is first compared with its odometry, and ratio of those of one check to the next."""

OPPOSITE: Final = -0.5
"""Share of the turns of a path below which odometry turns the other way; -1 beside mirrored scans."""

LEAST_TURN_RAD: Final = 90 * DEG
"""Turns that show whether scans are mirrored, and in which order their beams were fired."""


def while_odometry_fits(track: Track, phase: str = "track", until: Until | None = None) -> Track:
    """Track the log; the track ends early where its odometry should be corrected, or left out.

    ``until`` may end it earlier.
    """

    def passed_on(steps: Iterable[Step]) -> Iterator[Step]:
        fitting = iter(steps) if track.motion.odometry is None else until_wrong(steps, track)
        return until(fitting) if until else fitting

    return track.over(track.log_scans(), phase, passed_on)


def until_wrong(steps: Iterable[Step], track: Track) -> Iterator[Step]:
    """Yield the steps of a track until its odometry should be corrected or left out."""
    accepted: list[Step] = []
    due = FIRST_CHECK
    for step in steps:
        yield step
        if step.tracked:
            accepted.append(step)
        if len(accepted) == due:
            due *= CHECK_RATIO
            so_far = Steps(accepted)
            if correction(track, so_far) or contradicts(track, so_far):
                return


def correction(track: Track, steps: Steps) -> OdometryFit | None:
    """Return what makes the odometry of the log fit the steps of a track better; None if nothing does so clearly."""
    odometry, used, path = track.log_odometry, track.findings.odometry, tracked_trajectory(steps)
    if odometry is None or not len(path):
        return None
    best = fit_odometry(odometry, path, used)
    if best is None or best.error > MOST_ERROR or not is_plausible(best) or turns_against(best, odometry, path):
        return None
    differs = any(abs(a - b) >= least for a, b, least in zip(best[:3], used[:3], LEAST_CHANGE[:3], strict=True))
    differs, unused = differs or best.mean_stamps != used.mean_stamps, track.motion.odometry is None
    return best if unused or (differs and best.error < IMPROVED * with_noise(odometry, path, used).error) else None


def is_plausible(fit: OdometryFit) -> bool:
    """Return whether wheels or units explain the scales."""
    low, high = SCALES
    return low < fit.turn_scale < high and any(low < fit.distance_scale / unit < high for unit in UNITS)


def contradicts(track: Track, steps: Steps) -> bool:
    """Return whether the odometry that is used contradicts the steps of a track."""
    if track.log_odometry is None or track.motion.odometry is None:
        return False
    path = tracked_trajectory(steps)
    fit = with_noise(track.log_odometry, path, track.findings.odometry)
    return bool(MOST_ERROR < fit.error < np.inf) or turns_against(fit, track.log_odometry, path)


def turns_against(fit: OdometryFit, odometry: LogOdometry, path: Trajectory) -> bool:
    """Return whether odometry fits a path, but for its turns, which are few, and its mirror image as a whole."""
    return share_of_turns(odometry, path, fit) < OPPOSITE and is_mirrored(odometry, path)


def correct_odometry(track: Track) -> Track | None:
    """Return a track with odometry that is corrected to fit better; None where it fits, or nothing makes it fit."""
    fit = correction(track, track.steps)
    return track.with_odometry(track.log_odometry, fit) if fit else None


def drop_odometry(track: Track) -> Track | None:
    """Return a track without odometry if that contradicts the scans."""
    return track.with_odometry(None, track.findings.odometry) if contradicts(track, track.steps) else None


ERRING_WHEELS: Final = "without wheels"
"""The attempt without odometry, or without a part of it, that shows where it errs."""

WINDOW_S: Final = 10.0
"""Time over which the largest error of odometry is given."""


def wheels_err(track: Track) -> bool:
    """Return whether odometry, or a part of it, is left out as a track without it shows that it errs."""
    return TrackedAgain(ERRING_WHEELS, kept=True) in track.findings.attempts


def contradiction(track: Track) -> str:
    """Say how odometry contradicts the scans, and what to do."""
    odometry, path = track.log_odometry, tracked_trajectory(track.steps)
    if odometry and wheels_err(track):
        return describe_error(track, path)
    if odometry and is_mirrored(odometry, path):
        return (
            "the laser turns the other way; if it is mounted upside down, or its scans are mirrored, replay with --set "
            "upside_down=true; if the transforms have turned them over, with --extrinsic x,y,yaw instead; if the "
            "odometry is mirrored, this run is right"
        )
    best = fit_odometry(odometry, path, GOOD_ODOMETRY) if odometry and len(path) else None
    if best and best.error <= MOST_ERROR:
        scales = f"its distances times {best.distance_scale:.3g} and its turns times {best.turn_scale:.3g}"
        return f"it fits with {scales}; check the units of the ranges and of the odometry"
    return (
        "no time offset and scale makes it fit; check its axes and its clock, and whose it is ('mavnav calibrate' "
        "compares them); if they are right, see map.png"
    )


def describe_error(track: Track, path: Trajectory) -> str:
    """Say by how much the odometry of a track differs from a path that walls show, and when."""
    off_m, at_ns = largest_error(track, path)
    at_s = (at_ns - track.steps[0].stamp_ns) * NS
    return (
        f"it is off by up to {off_m:.2g} m in {WINDOW_S:.0f} s (from {at_s:.1f} s on), while the walls show the "
        "motion without it; see what the wheels did there"
    )


def by_wheels(track: Track, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the poses (n, 3) by the corrected odometry of the log, used or not; NaN where it has none."""
    given = track.log_odometry
    pose_at = given.lookup(track.findings.odometry) if given else lambda _: None
    return np.array([pose_at(stamp_ns) or (np.nan,) * 3 for stamp_ns in stamps_ns.tolist()]).reshape(-1, 3)


def largest_error(track: Track, path: Trajectory) -> tuple[float, int]:
    """Return by how much odometry differs from a path over ``WINDOW_S`` at most, m, and the stamp of its beginning."""
    wheels, begins = by_wheels(track, path.stamps_ns), np.arange(len(path))
    ends = np.minimum(np.searchsorted(path.stamps_ns, path.stamps_ns + round(WINDOW_S / NS)), len(path) - 1)
    apart = motions(wheels, begins, ends) - motions(path.xyyaw, begins, ends)
    off_m = np.nan_to_num(np.linalg.norm(apart[:, :2], axis=1))
    worst = int(off_m.argmax())
    return float(off_m[worst]), int(path.stamps_ns[worst])


def is_mirrored(odometry: LogOdometry, path: Trajectory) -> bool:
    """Return whether odometry fits the mirror image of a path that turns."""
    if (
        not len(path) or np.ptp(np.unwrap(path.xyyaw[:, 2])) < LEAST_TURN_RAD
    ):  # the sum of all turns grows with their noise
        return False
    fit = fit_odometry(odometry, replace(path, xyyaw=path.xyyaw * (1.0, -1.0, -1.0)), GOOD_ODOMETRY)
    return fit is not None and fit.error <= MOST_ERROR and is_plausible(fit)


def _partly_used(track: Track, known: NDArray[np.bool_]) -> str:
    """Say for how many scans (n,) odometry is known, why not for the others, and what to do."""
    scans = f"{np.count_nonzero(known)} of {len(known)} scans"
    if is_recorded(track, track.steps.column("stamp_ns")[~known]):
        return (
            f"odometry is used for {scans}, because poses of it that jump are left out; the others are matched without "
            "it: see what publishes it"
        )
    return (
        f"odometry covers {scans} (not in gaps of over 0.5 s); the others are matched without it: record it for the "
        "whole log, or cut the log with --start and --end"
    )


CORRECTED_ODOMETRY: Final = Attempt("corrected odometry", correct_odometry)
WITHOUT_ODOMETRY: Final = Attempt("without odometry", drop_odometry)
FITTING_ODOMETRY: Final = (CORRECTED_ODOMETRY, CORRECTED_ODOMETRY, WITHOUT_ODOMETRY, CORRECTED_ODOMETRY)
"""A track with wrong odometry may show what is wrong with it, or a track without it."""


def odometry_warnings(track: Track) -> Iterator[str]:
    """Yield a warning if the odometry of the log is not used, or for a part of the scans alone."""
    if track.log_odometry is None:
        return
    known, errs = track.motion.odometry_at(track.steps.column("stamp_ns")), wheels_err(track)
    if track.odometry_contradicts:
        yield f"odometry contradicts the scans and is not used: {contradiction(track)}"
    elif len(known) and known.mean() < NEARLY_ALL and not errs:
        yield _partly_used(track, known)
