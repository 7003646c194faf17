"""Check the odometry of a log against its scans; track without it, or with it only after gaps, if it does not fit.

Stamps that jitter, or an offset between two clocks, make the steps of odometry wrong, but not its long motions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec.structs import replace

from mavnav.slam.matching.motion_model import GAP_S, motion_by
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.retries.attempt import Attempt
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


def drop_odometry(track: Track) -> Track | None:
    """Return a track without odometry if that contradicts the scans."""
    odometry = track.motion.odometry
    if odometry is None or not misleads(odometry, tracked_trajectory(track.steps)):
        return None
    return replace(track, motion=track.motion._replace(odometry=None))


def bridge_gaps(track: Track) -> Track | None:
    """Return a track that uses contradicting odometry after gaps, at the time offset at which it fits; None without."""
    path = tracked_trajectory(track.steps)
    gapless = track.steps.column("tracked").all() and np.all(np.diff(path.stamps_ns) * NS <= GAP_S)
    if track.log_odometry is None or not track.odometry_contradicts or gapless:
        return None
    offset_s = fitting_offset_s(track.log_odometry, path)
    if offset_s is None:
        return None
    return replace(track, motion=track.motion._replace(gap_odometry=at_offset(track.log_odometry, offset_s)))


WITHOUT_ODOMETRY: Final = Attempt("without odometry", drop_odometry)
ODOMETRY_AFTER_GAPS: Final = Attempt("odometry after gaps", bridge_gaps)


def odometry_warnings(track: Track) -> Iterator[str]:
    """Yield a warning if the odometry of the log is not used, or covers few of the scans."""
    if track.log_odometry is None:
        return
    known = track.motion.odometry_at(track.steps.column("stamp_ns"))
    if track.odometry_contradicts:
        yield contradiction_warning(track, track.log_odometry)
    elif len(known) and known.mean() < LEAST_COVERED:
        yield (
            f"odometry covers {np.count_nonzero(known)} of {len(known)} scans (not in gaps of over 0.5 s); the others "
            "are matched without it: record it for the whole log, or cut the log with --start and --end"
        )


def contradiction_warning(track: Track, odometry: Odometry) -> str:
    """Return the warning of odometry that contradicts the scans: whether, and how, it fits long motions."""
    offset_s = fitting_offset_s(odometry, tracked_trajectory(track.steps))
    if offset_s is None:
        return (
            "odometry contradicts the scans and is not used; check its scale, axes and clock; if they are right, "
            "see map.png"
        )
    total_s = offset_s + track.config.odometry.offset_s
    used = "used only after gaps" if track.motion.gap_odometry else "not used"
    return (
        f"{JITTER_WARNING} with {total_s:.2f} s added to its stamps, and is {used}; measure its time offset with "
        "'mavnav calibrate'"
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
    errors = [error for triple in triples if (error := _errors(odometry, triple)) is not None]
    return len(errors) >= LEAST_STEPS and _is_worse(np.sqrt(np.square(errors).mean(axis=0)))


def _errors(odometry: Odometry, poses: list[tuple[int, Pose]]) -> NDArray[np.float64] | None:
    """Return the errors of odometry and of constant velocity at the last of three poses, and the motion there, (3,).

    None where odometry does not cover both times.
    """
    (_, a), (b_ns, b), (c_ns, c) = poses
    by_odometry, went, moved = motion_by(odometry, b_ns, c_ns), a.between(b), b.between(c)
    if by_odometry is None:
        return None
    return np.array([size(p) for p in (by_odometry.between(moved), went.between(moved), moved)])


def _is_worse(errors: NDArray[np.float64], times: float = 1.0) -> bool:
    by_odometry, by_velocity, motion = errors
    return bool(by_odometry > times * max(by_velocity, MISLEADING * motion))


COARSE_S, FINE_S = 0.1 * np.arange(-10, 11), 0.02 * np.arange(-4, 5)
"""Offsets that are tried, s, and those tried around the best of them."""

WINDOW_S = 1.0
"""Time over which motions are compared, s."""

MOST_WINDOWS, LEAST_WINDOWS = 100, 20
"""Number of windows that are compared, those with most motion, and the fewest that are enough."""

LARGEST_SHARE = 0.2
"""Largest RMS error of odometry that fits, as a share of the motion."""


class MotionWindow(NamedTuple):
    """A motion between two stamps: of the laser, in its frame at the first."""

    start_ns: int
    end_ns: int
    moved: Pose


def fitting_offset_s(odometry: Odometry, map_T_laser: Trajectory) -> float | None:
    """Return the time to add to the stamps of the odometry so that it fits the tracked poses, s; None if none does.

    The best offset within 1 s counts if the RMS error is at most ``LARGEST_SHARE`` of the motion. Errors and motions
    are in m; a radian counts as a metre.
    """
    windows = most_moving(map_T_laser)
    if len(windows) < LEAST_WINDOWS:
        return None
    coarse_s = min(COARSE_S.tolist(), key=lambda offset_s: rms_error(odometry, windows, offset_s))
    best_s = min((coarse_s + FINE_S).tolist(), key=lambda offset_s: rms_error(odometry, windows, offset_s))
    motion = np.sqrt(np.mean([size(window.moved) ** 2 for window in windows]))
    return round(best_s, 2) if rms_error(odometry, windows, best_s) <= LARGEST_SHARE * motion else None


def most_moving(map_T_laser: Trajectory) -> list[MotionWindow]:
    """Return the windows of a path with most motion, in the order of their times."""
    stamps_ns = map_T_laser.stamps_ns
    ends = np.searchsorted(stamps_ns, stamps_ns + round(WINDOW_S / NS))
    stamps = stamps_ns.tolist()
    inside = ((a, b) for a, b in enumerate(ends.tolist()) if b < len(stamps))
    close = ((a, b) for a, b in inside if (stamps[b] - stamps[a]) * NS < 2 * WINDOW_S)
    windows = [MotionWindow(stamps[a], stamps[b], map_T_laser[a].between(map_T_laser[b])) for a, b in close]
    return sorted(sorted(windows, key=lambda window: -size(window.moved))[:MOST_WINDOWS])


def rms_error(odometry: Odometry, windows: list[MotionWindow], offset_s: float) -> float:
    """Return the error of odometry with an offset; infinite if it covers few of the windows."""
    errors = errors_m(at_offset(odometry, offset_s), windows)
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else np.inf


def errors_m(odometry: Odometry, windows: list[MotionWindow]) -> list[float]:
    """Return the errors of odometry in the windows that it covers; none if these are few."""
    pairs = ((motion_by(odometry, start_ns, end_ns), moved) for start_ns, end_ns, moved in windows)
    errors = [size(by_odometry.between(moved)) for by_odometry, moved in pairs if by_odometry]
    return errors if len(errors) >= LEAST_WINDOWS else []


def size(moved: Pose) -> float:
    """Return the size of a motion, m; a radian counts as a metre."""
    return float(np.hypot(np.hypot(moved.x_m, moved.y_m), moved.yaw_rad))


def at_offset(odometry: Odometry, offset_s: float) -> Odometry:
    """Return odometry with a time added to its stamps."""
    offset_ns = round(offset_s / NS)
    return lambda stamp_ns: odometry(stamp_ns - offset_ns)
