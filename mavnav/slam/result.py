"""The result of SLAM on a log: the input of the writers, the metrics and the simulation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import Grid
from mavnav.pose import Pose, Trajectory
from mavnav.scan import Line
from mavnav.slam.findings import NOT_PLANAR, Doubt, Loops, TrackedAgain
from mavnav.slam.matching.observability import covariances_of
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, FittedOdometry, OdometryFit, fit_odometry, with_noise
from mavnav.slam.matching.steps import NEARLY_ALL, LostInterval, Steps, jumps, lost_intervals, tracked_trajectory
from mavnav.slam.methods.pauses import pause_warnings
from mavnav.slam.recovery.bridges import Bridges, bridge_by_odometry
from mavnav.slam.recovery.parts import Part, lost_for_good, part_warnings, parts_of
from mavnav.slam.retries.attempt import COARSER_VOXELS
from mavnav.slam.retries.odometry import odometry_warnings
from mavnav.slam.retries.unused_odometry import odometry_advice
from mavnav.slam.track import Track
from mavnav.units import NS

MOST_SCATTERED = 0.2
"""Share of scans without a pose outside of lost intervals from which there is a warning."""

FEW_BEAMS = 70
"""Median number of points of the scans below which there is a warning."""


class SlamResult(Struct, frozen=True):
    """The result: a step for every scan, the poses of the tracked ones (map_T_laser), map, lost intervals, loops.

    ``covariances`` (n, 6) are those of the poses of all steps in the map frame, in the order of `covariances_of`, NaN
    where unknown; None without the passes after tracking. ``warnings`` are lines for the user about input that was not
    used as recorded. ``attempts`` to track the log again, in order. ``parts`` are the stretches of a log that was not
    tracked as a whole, each on a separate map at first; else empty. ``doubt`` is None where it
    was not judged. ``begin_ns`` is the stamp of the scan that begins the map and defines the map frame; None where
    nothing was tracked. It is put at ``map_T_begin``, else at the origin. ``odometry`` is what corrects the odometry
    that is used; None if none is. ``sweep_s`` is the time of a sweep where it is another than stated, else None.
    ``bridges`` are poses of lost scans by odometry. ``floor_m`` is the line from which on returns are left out
    (`scan_before`), if any are. ``wheels`` is the odometry of the log that is used, as it was corrected;
    None if none is.
    """

    steps: Steps
    trajectory: Trajectory
    grid: Grid
    lost: tuple[LostInterval, ...]
    loops: Loops = field(default_factory=Loops)
    warnings: tuple[str, ...] = ()
    attempts: tuple[TrackedAgain, ...] = ()
    parts: tuple[Part, ...] = ()
    doubt: Doubt | None = None
    covariances: NDArray[np.float64] | None = None
    begin_ns: int | None = None
    odometry: OdometryFit | None = None
    sweep_s: float | None = None
    bridges: Bridges = field(default_factory=Bridges)
    map_T_begin: Pose | None = None
    floor_m: Line | None = None
    wheels: FittedOdometry | None = None

    @property
    def path(self) -> Trajectory:
        """The poses of all scans that have one: the tracked ones, and lost ones by odometry."""
        stamps_ns = np.concatenate((self.trajectory.stamps_ns, self.bridges.trajectory.stamps_ns))
        order = np.argsort(stamps_ns, kind="stable")
        return Trajectory(stamps_ns[order], np.vstack((self.trajectory.xyyaw, self.bridges.trajectory.xyyaw))[order])

    @property
    def tracks_compared(self) -> int:
        """Number of tracks of which the sharpest was kept."""
        return 1 + sum(attempt.name == COARSER_VOXELS.name for attempt in self.attempts)

    @property
    def tracked_share(self) -> float:
        """Share of the scans that have a pose; 0 without scans."""
        return len(self.trajectory) / max(len(self.steps), 1)

    @property
    def lost_for_good(self) -> bool:
        """Whether the track has too few of its scans or too many are in parts not joined.

        So too where it ended before the log, unless nearly all scans have a pose.
        """
        return lost_for_good(self.steps, self.lost, self.parts, NEARLY_ALL, len(self.bridges.numbers))

    @property
    def planar(self) -> bool:
        """Whether the scans fit a map of a plane: False if the doubt is high and "not planar" is among its reasons."""
        return self.doubt is None or not self.doubt.high or NOT_PLANAR not in {r.name for r in self.doubt.reasons}

    def doubtful(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which of the scans (n,) are in a doubtful stretch; none unless the doubt is high."""
        return np.zeros(len(stamps_ns), np.bool_) if self.doubt is None else self.doubt.marks(stamps_ns)


def summarize(track: Track) -> SlamResult:
    """Return the result of a finished track; its map is taken from the method."""
    steps, findings, parts, lost = track.steps, track.findings, parts_of(track), tuple(lost_intervals(track.steps))
    bridges = bridge_by_odometry(track)
    covariances = covariances_of(steps, findings.hessians) if len(findings.hessians) else None
    if covariances is not None:
        bridges.grow(covariances)
    return SlamResult(
        steps,
        tracked_trajectory(steps),
        track.method.release_map(),
        lost,
        findings.loops,
        (*odometry_warnings(track), *findings.warnings, *_late_warnings(track, parts, lost, bridges)),
        findings.attempts,
        parts,
        findings.doubt,
        covariances,
        beginning_ns(steps, track.begin),
        used_odometry(track),
        findings.sweep_s,
        bridges,
        findings.map_T_begin,
        findings.floor_m,
        (track.log_odometry, findings.odometry) if track.log_odometry and track.motion.odometry else None,
    )


def used_odometry(track: Track) -> OdometryFit | None:
    """Return what corrects the odometry that is used, estimated beside the finished path; None if none is."""
    used = track.findings.odometry
    if track.motion.odometry is None:
        return None
    if track.log_odometry is None:  # the commands of a mission
        return used
    path = tracked_trajectory(track.steps)
    corrected = fit_odometry(track.log_odometry, path, used) if used != GOOD_ODOMETRY else None
    return corrected or with_noise(track.log_odometry, path, used)


def _late_warnings(
    track: Track, parts: Sequence[Part], lost: Sequence[LostInterval], bridges: Bridges
) -> Iterator[str]:
    """Yield the warnings that depend on the finished path."""
    yield from part_warnings(parts, track.steps[0].stamp_ns, track.start_s) if parts else ()
    yield from bridges.warnings(track.steps[0].stamp_ns) if bridges.numbers else ()
    yield from jump_warnings(track.steps)
    if track.prior_map is None:
        yield from pause_warnings(track.steps, track.motion)
    if track.builds_map:
        yield from scattered_warnings(track.steps, lost)
        advice = "" if track.motion.odometry else odometry_advice(track, track.steps.column("stamp_ns"))
        yield from few_beams_warnings(track.steps, advice)


def jump_warnings(steps: Steps) -> Iterator[str]:
    """Yield a warning if the path jumps between two successive poses; scans without one may lie between them."""
    path = tracked_trajectory(steps)
    at_s = [(int(path.stamps_ns[k + 1]) - steps[0].stamp_ns) * NS for k in np.flatnonzero(jumps(path)[1]).tolist()]
    if at_s:
        when = f"{at_s[0]:.1f} s after the first scan" + (f", and {len(at_s) - 1} more" if len(at_s) > 1 else "")
        yield (
            f"the path jumps faster than any vehicle ({when}): a wrong match, scans that repeat, or a laser that was "
            "carried; see the map there"
        )


def scattered_warnings(steps: Steps, lost: Sequence[LostInterval]) -> Iterator[str]:
    """Yield a warning if many scans without a pose are spread over the log."""
    missing, in_lost = int(np.count_nonzero(~steps.column("tracked"))), sum(interval.scans for interval in lost)
    if missing - in_lost > MOST_SCATTERED * len(steps):
        scans = f"{missing - in_lost} of {len(steps)} scans, spread over the log,"
        if not steps.column("evaluations").any():  # at given poses
            yield f"{scans} have no pose with their stamp; give a pose for every scan"
        else:
            causes = "two lasers on one topic, or scans that are cut or spoilt? See them with 'mavnav info'"
            yield f"{scans} match nowhere: {causes}"


def few_beams_warnings(steps: Steps, advice: str) -> Iterator[str]:
    """Yield a warning if most tracked scans have few points: they may fit at several poses.

    ``advice`` says what to do about odometry, if anything.
    """
    used = steps.column("beams_used")[steps.column("tracked")]
    if len(used) and (usual := float(np.median(used))) < FEW_BEAMS:
        yield (
            f"the scans have only {usual:.0f} points in the median: single poses may be off by a meter; "
            f"check the map{f', or {advice}' if advice else ''}"
        )


def beginning_ns(steps: Steps, begin: int) -> int | None:
    """Return the stamp of the first tracked scan from number ``begin`` on; None if there is none."""
    later = steps.column("stamp_ns")[begin:][steps.column("tracked")[begin:]]
    return int(later[0]) if len(later) else None


def parts_of_path(slam: SlamResult) -> list[NDArray[np.float64]]:
    """Return the positions of the path (n, 2), in parts between the stretches where the track was lost."""
    breaks = np.searchsorted(slam.trajectory.stamps_ns, [lost.start_ns for lost in slam.lost], side="right")
    return np.split(slam.trajectory.xyyaw[:, :2], breaks)


def doubtful_parts(slam: SlamResult) -> list[NDArray[np.float64]]:
    """Return the positions (n, 2) of the doubtful stretches of the path."""
    stamps_ns = slam.trajectory.stamps_ns
    marked, breaks = slam.doubtful(stamps_ns), [lost.start_ns for lost in slam.lost]
    turns, gaps = np.flatnonzero(np.diff(marked)) + 1, np.searchsorted(stamps_ns, breaks, side="right")
    ends = np.unique(np.concatenate((turns, gaps)))
    parts = zip(np.split(slam.trajectory.xyyaw[:, :2], ends), np.split(marked, ends), strict=True)
    return [xy_m for xy_m, doubtful in parts if doubtful.any()]
