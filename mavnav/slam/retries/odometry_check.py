"""Check the odometry of a log against its scans, and track without it where it does not fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from mavnav.slam.matching.motion_model import GAP_S
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.retries.odometry_offset import at_offset, fitting_offset_s, size
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from mavnav.pose import Pose, Trajectory
    from mavnav.slam.matching.motion_model import Odometry
    from mavnav.slam.matching.steps import Step
    from mavnav.slam.track import Track, Until

LEAST_STEPS, MISLEADING = 20, 0.3
"""Minimum number of steps of the check, and largest RMS error of the odometry as a share of the motion."""

EARLY_STEPS, EARLY_RATIO = 60, 1.5
"""Minimum number of steps before the track ends early, and the multiple of the allowed error that ends it."""

LEAST_COVERED = 0.9
"""Minimum share of scans that odometry covers without a warning."""

WARNING = (
    "odometry contradicts the scans and is not used; check its scale, axes and clock; if they are right, see map.png"
)

JITTER_WARNING = "odometry contradicts the steps between scans, but fits motions of a second"
"""Beginning of the warning of odometry whose stamps jitter, or have a time offset."""


def while_odometry_fits(track: Track, phase: str = "track", until: Until | None = None) -> Track:
    """Track the log; the track ends early where its odometry plainly contradicts the scans.

    ``until`` may end it earlier.
    """
    odometry = track.motion.odometry

    def passed_on(steps: Iterable[Step]) -> Iterator[Step]:
        fitting = iter(steps) if odometry is None else until_misled(steps, odometry)
        return until(fitting) if until else fitting

    return track.over(track.log_scans(), phase, passed_on)


def without_misleading_odometry(track: Track) -> Track:
    """Track again without odometry where it contradicts the scans, or with it only after gaps if it fits there."""
    odometry = track.motion.odometry
    if odometry is None:
        return track
    if not misleads(odometry, tracked_trajectory(track.steps)):
        return with_coverage(track)
    alone = replace(track, motion=track.motion._replace(odometry=None))
    alone = alone.over(alone.log_scans(), "track again")
    if len(alone.steps) < len(track.steps):
        return track
    alone = replace(alone, odometry_contradicts=True)
    offset_s = fitting_offset_s(odometry, tracked_trajectory(alone.steps))
    if offset_s is None:
        return alone.with_warning(WARNING)
    found = with_gap_odometry(alone, at_offset(odometry, offset_s))
    total_s, used = offset_s + track.config.odometry.offset_s, "not used" if found is None else "used only after gaps"
    return (found or alone).with_warning(
        f"{JITTER_WARNING} with {total_s:.2f} s added to its stamps, and is {used}; measure its time offset with "
        "'mavnav calibrate'"
    )


def with_gap_odometry(track: Track, odometry: Odometry) -> Track | None:
    """Track again with odometry after gaps; None if the track has none, or if the run is stopped."""
    path = tracked_trajectory(track.steps)
    if track.steps.column("tracked").all() and np.all(np.diff(path.stamps_ns) * NS <= GAP_S):
        return None
    again = replace(track, motion=track.motion._replace(gap_odometry=odometry))
    again = again.over(track.log_scans(), "track again")
    return again if len(again.steps) == len(track.steps) else None


def with_coverage(track: Track) -> Track:
    """Return a track with a warning if its odometry covers few of its scans."""
    known = track.motion.odometry_at(track.steps.column("stamp_ns"))
    if not len(known) or known.mean() >= LEAST_COVERED:
        return track
    covered = f"{np.count_nonzero(known)} of {len(known)} scans"
    return track.with_warning(
        f"odometry covers {covered} (not in gaps of over 0.5 s); the others are matched without it: record it for the "
        "whole log, or cut the log with --start and --end"
    )


def until_misled(steps: Iterable[Step], odometry: Odometry) -> Iterator[Step]:
    """Yield the steps of a track until its odometry is wrong by ``EARLY_RATIO`` times the allowed error."""
    poses: list[tuple[int, Pose]] = []
    squares, count = np.zeros(3), 0
    for step in steps:
        yield step
        if not step.tracked:
            continue
        poses = [*poses[-2:], (step.stamp_ns, step.match.map_T_laser)]
        errors = _errors(odometry, poses) if len(poses) == 3 else None
        if errors is not None:
            squares, count = squares + errors**2, count + 1
        if count >= EARLY_STEPS and _is_worse(np.sqrt(squares / count), EARLY_RATIO):
            return


def misleads(odometry: Odometry, map_T_laser: Trajectory) -> bool:
    """Return whether odometry predicts the tracked poses worse than constant velocity, and badly.

    Errors are root mean squares over steps, in m; a radian counts as a metre.
    """
    stamps = map_T_laser.stamps_ns.tolist()
    triples = ([(stamps[m], map_T_laser[m]) for m in range(k - 2, k + 1)] for k in range(2, len(stamps)))
    errors = [found for triple in triples if (found := _errors(odometry, triple)) is not None]
    return len(errors) >= LEAST_STEPS and _is_worse(np.sqrt(np.square(errors).mean(axis=0)))


def _errors(odometry: Odometry, poses: list[tuple[int, Pose]]) -> NDArray[np.float64] | None:
    """Return the errors of odometry and of constant velocity at the last of three poses, and the motion there, (3,).

    None where odometry does not cover both times.
    """
    (_, a), (b_ns, b), (c_ns, c) = poses
    then, now = odometry(b_ns), odometry(c_ns)
    if then is None or now is None:
        return None
    went, moved = a.between(b), b.between(c)
    return np.array([size(p) for p in (then.between(now).between(moved), went.between(moved), moved)])


def _is_worse(errors: NDArray[np.float64], times: float = 1.0) -> bool:
    by_odometry, by_velocity, motion = errors
    return bool(by_odometry > times * max(by_velocity, MISLEADING * motion))
