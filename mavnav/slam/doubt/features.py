"""The features of the doubt: the evidence of a track, and each reason to doubt it, with its strength and its weight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import compress
from math import pi
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import motions
from mavnav.slam.doubt.gaps import beside_doubtful_gaps
from mavnav.slam.doubt.second_motion import LEAST_AGREEING, second_motion
from mavnav.slam.findings import NOT_PLANAR, SECOND_LOST, SECOND_MOTION
from mavnav.slam.matching.observability import LEAST_OBSERVABILITY
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.retries.attempt import COARSER, COARSER_VOXELS, FEW_POINTS
from mavnav.slam.retries.odometry import by_wheels
from mavnav.slam.track import Track
from mavnav.units import DEG, NS

Floats = NDArray[np.float64]


class TrackEvidence(Struct, frozen=True):
    """Arrays with a row for every tracked scan, and scalars of the whole track.

    ``stamps_ns`` (n,); ``xyyaw`` (n, 3) the poses in the map frame, m and rad; ``points`` (n,) the numbers of matched
    points; ``observed`` and ``conflicts`` (n,) observability and visibility conflicts in the finished map;
    ``resampled`` (n, 3) the poses of a track with coarser voxels, ``wheels`` (n, 3) those by the odometry of the log,
    used or not, NaN without one; ``tilt_rad`` (n,) the tilt by an inertial sensor, 0 without; ``second_motion`` (n,)
    the share of scans that fit another motion too, at those scans; ``by_odometry_m`` (n,) the error to be expected
    where odometry alone gives the pose, 0 elsewhere; ``beside_gap`` (n,) whether a gap is beside them beyond which the
    laser may be elsewhere; ``unmeasured`` (n,) the share of the motion that nothing but scans measures: 0 with
    odometry, 1 without. ``period_s`` is the scan period.
    """

    period_s: float
    unmeasured: Floats
    stamps_ns: NDArray[np.int64]
    xyyaw: Floats
    points: NDArray[np.int64]
    observed: Floats
    conflicts: Floats
    resampled: Floats
    wheels: Floats
    tilt_rad: Floats
    second_motion: Floats
    by_odometry_m: Floats
    beside_gap: Floats


def evidence_of(track: Track, refiner: Refiner, *, gaps: bool = True) -> TrackEvidence:
    """Return the evidence of a finished track, without that of other tracks; of ``gaps`` none in a given map."""
    tracked, findings = track.steps.column("tracked"), track.findings
    xyyaw = track.steps.column("map_T_laser")[tracked]
    stamps_ns, rotation = track.steps.column("stamp_ns")[tracked], track.motion.rotation
    return TrackEvidence(
        period_s=track.motion.period_s,
        unmeasured=np.where(track.motion.odometry_at(stamps_ns), COMMANDS_ERR * track.motion.commanded, 1.0),
        stamps_ns=stamps_ns,
        xyyaw=xyyaw,
        points=track.steps.column("beams_used")[tracked],
        observed=findings.observed[tracked],
        conflicts=findings.conflicts[tracked],
        resampled=np.full(xyyaw.shape, np.nan),
        wheels=by_wheels(track, stamps_ns),
        tilt_rad=np.zeros(len(stamps_ns)) if rotation is None else rotation.tilts_rad(stamps_ns),
        second_motion=second_motion(track, refiner, findings.conflicts[tracked]),
        by_odometry_m=findings.by_odometry_m[tracked] if len(findings.by_odometry_m) else np.zeros(len(stamps_ns)),
        beside_gap=beside_doubtful_gaps(track) if gaps else np.zeros(len(stamps_ns)),
    )


def wrap_angles(yaws_rad: Floats) -> Floats:
    """Wrap angles to [-pi, pi)."""
    return (yaws_rad + pi) % (2.0 * pi) - pi


def turns_rad(yaws_rad: Floats) -> Floats:
    """Return the rotation (n,) from the previous heading to each of the headings (n,), 0 for the first."""
    return np.abs(wrap_angles(np.diff(yaws_rad, prepend=yaws_rad[:1])))


def resampled_poses(track: Track) -> Floats | None:
    """Return the poses (n, 3) of the tracked scans in a track with coarser voxels, NaN for scans without a pose there.

    Only these scans are tracked once more: others cannot be compared, and take most time. Where all have a pose, such
    a track may have been refused before. None if the run is stopped.
    """
    tracked, steps = track.steps.column("tracked"), track.findings.refused_steps
    if steps is None or track.findings.attempts[-1].name != COARSER_VOXELS.name or not tracked.all():
        other = replace(track, config=track.config.with_voxels(COARSER), begin=int(tracked[: track.begin].sum()))
        steps = other.over(compress(track.log_scans(), tracked), "track again").steps
    if len(steps) < np.count_nonzero(tracked):
        return None
    return np.where(steps.column("tracked")[:, None], steps.column("map_T_laser"), np.nan)


WINDOWS_S = (2.0, 10.0)
"""Lengths of the windows over which the motion is compared with that of another track, and with odometry."""

WRONG_M, WRONG_RAD = 0.2, 5 * DEG
"""Largest error of the motion over a window of a track that is not wrong."""

WHEELS_SHARE = 0.1
"""Error of odometry that wheels explain, as a share of the distance and of the turn."""

STEADY_M, STEADY_RAD, SPIKE = 0.01, 0.02, 5.0
"""Changes of velocity per period, m and rad, that are added to the 0.9 quantile of all changes, and the factor.

A spike is the sum times the factor.
"""

SPARSE_M, SPARSE_RAD = 0.3, 20 * DEG
"""Motion between two scans above which sampling is sparse."""

CONFLICTS, LOST_SHARE = 0.05, 0.1
"""Bounds besides ``FEW_POINTS``: more conflicts and more scans lost by a second track raise doubt."""

WEAK_M_S, LONGEST_S = 0.5, 1.0
"""Along walls that leave the motion open, the least speed that is possible, whatever the track says, and the longest
time between two scans for which that counts; the motion adds up over the longer of ``WINDOWS_S``."""

COMMANDS_ERR: Final = 0.5
"""Share of its commanded motion by which a vehicle may be off: nothing measures what it does."""

TILT_RAD = 10 * DEG
"""Tilt above which motion is not planar: a wall 3 m away is then met 0.5 m higher or lower."""

MOVING_S, MOVING_M = 0.5, 0.1
"""Time to either side, and motion meanwhile of a laser that moves: what changes before a standing one is no tilt."""


def disagreement(evidence: TrackEvidence) -> Floats:
    """Return the difference of two tracks in the motion from or to each scan, as a multiple of the bound for wrong.

    NaN without a second track.
    """
    stamps_ns, other = evidence.stamps_ns, evidence.resampled
    known = np.isfinite(other[:, 0]).any()
    return difference(stamps_ns, evidence.xyyaw, other) if known else np.full(len(stamps_ns), np.nan)


def odometry_disagrees(evidence: TrackEvidence) -> Floats:
    """Return the difference between track and odometry, as a multiple of the bound for wrong and the usual error."""
    return difference(evidence.stamps_ns, evidence.xyyaw, evidence.wheels, WHEELS_SHARE)


def difference(stamps_ns: NDArray[np.int64], xyyaw: Floats, other: Floats, share: float = 0.0) -> Floats:
    """Return the difference of poses (n, 3) to other ones, NaN where there are none, in the motion from or to each.

    It is (n,) multiples of the bound for wrong and a share of the motion.
    """
    common, out = np.flatnonzero(np.isfinite(other[:, 0])), np.zeros(len(stamps_ns))
    stamps_s, start = stamps_ns[common] * NS, np.arange(len(common))
    for window_s in WINDOWS_S if len(common) else ():
        end = np.minimum(np.searchsorted(stamps_s, stamps_s + window_s), len(common) - 1)
        moved = motions(other[common], start, end)
        off = motions(xyyaw[common], start, end) - moved
        ratio_m = np.hypot(off[:, 0], off[:, 1]) / (WRONG_M + share * np.hypot(moved[:, 0], moved[:, 1]))
        ratio_rad = np.abs(wrap_angles(off[:, 2])) / (WRONG_RAD + share * np.abs(wrap_angles(moved[:, 2])))
        ratio = np.where(stamps_s[end] - stamps_s > window_s + 1.5, 0.0, np.maximum(ratio_m, ratio_rad))
        np.maximum.at(out, common, ratio)  # across a gap neither is reliable
        np.maximum.at(out, common[end], ratio)
    return out


def second_lost(evidence: TrackEvidence) -> Floats:
    """Return the share of the scans that a second track lost, at those scans, as a multiple of the bound."""
    lost = np.isnan(evidence.resampled[:, 0])
    return lost * (0.0 if lost.all() else lost.mean() / LOST_SHARE)


def slip(evidence: TrackEvidence) -> Floats:
    """Return the change of velocity at each scan, before and after it, as a multiple of a spike."""
    n = len(evidence.stamps_ns)
    if n < 4:
        return np.zeros(n)
    periods = np.maximum(np.round(np.diff(evidence.stamps_ns) * NS / evidence.period_s), 1.0)
    change = np.diff(motions(evidence.xyyaw, np.arange(n - 1), np.arange(1, n)) / periods[:, None], axis=0)
    spikes = [_spikes(np.hypot(change[:, 0], change[:, 1]), STEADY_M), _spikes(np.abs(change[:, 2]), STEADY_RAD)]
    return np.pad(np.maximum(*spikes), (2, 1))


def _spikes(changes: Floats, steady: float) -> Floats:
    """Return the lesser of two successive changes (n,), as a multiple of a spike."""
    spike = SPIKE * (float(np.quantile(changes, 0.9)) + steady)
    return np.asarray(np.minimum(changes[:-1], changes[1:]) / spike)


def weak(evidence: TrackEvidence) -> Floats:
    """Return how far the laser may move without odometry where the walls leave it open, at those scans.

    It is the motion in the longer window before or after, as a multiple of the bound for wrong. A track along bare
    walls may stand still while the laser moves.
    """
    weak, stamps_s = (evidence.observed < LEAST_OBSERVABILITY) * evidence.unmeasured, evidence.stamps_ns * NS
    elapsed_s = np.minimum(np.diff(stamps_s, prepend=stamps_s[:1]), LONGEST_S)
    driven_m = np.cumsum(weak * np.maximum(steps_m(evidence), WEAK_M_S * elapsed_s))
    first = np.searchsorted(stamps_s, stamps_s - WINDOWS_S[-1])
    last = np.minimum(np.searchsorted(stamps_s, stamps_s + WINDOWS_S[-1]), len(stamps_s) - 1)
    return np.asarray((weak > 0.0) * np.maximum(driven_m[last] - driven_m, driven_m - driven_m[first]) / WRONG_M)


def steps_m(evidence: TrackEvidence) -> Floats:
    """Return the distance from the scan before to each scan (n,), m; 0 for the first."""
    return np.asarray(np.linalg.norm(np.diff(evidence.xyyaw[:, :2], axis=0, prepend=evidence.xyyaw[:1, :2]), axis=1))


def sparse(evidence: TrackEvidence) -> Floats:
    """Return the motion before each scan as a multiple of the bound for sparse sampling."""
    turned = turns_rad(evidence.xyyaw[:, 2])
    return np.asarray(np.maximum(steps_m(evidence) / SPARSE_M, turned / SPARSE_RAD))


def not_planar(evidence: TrackEvidence) -> Floats:
    """Return the conflicts with the finished map while the laser moves, or the tilt, as multiples of their bounds."""
    stamps_s, last = evidence.stamps_ns * NS, len(evidence.stamps_ns) - 1
    ends = (np.clip(np.searchsorted(stamps_s, stamps_s + s), 0, last) for s in (-MOVING_S, MOVING_S))
    before, after = (evidence.xyyaw[end, :2] for end in ends)
    conflicts = np.where(np.linalg.norm(after - before, axis=1) > MOVING_M, evidence.conflicts, 0.0)
    return np.asarray(np.maximum(conflicts / CONFLICTS, evidence.tilt_rad / TILT_RAD))


def few_points(evidence: TrackEvidence) -> Floats:
    """Return the bound for few points as a multiple of the matched points."""
    return FEW_POINTS / np.maximum(evidence.points, 1)


def other_motion(evidence: TrackEvidence) -> Floats:
    """Return the share of scans that fit a second motion, at those scans, as a multiple of the bound."""
    return evidence.second_motion / LEAST_AGREEING


def placed_by_odometry(evidence: TrackEvidence) -> Floats:
    """Return the expected error of poses that odometry alone gives, as a multiple of the bound for wrong."""
    return evidence.by_odometry_m / WRONG_M


def doubtful_gap(evidence: TrackEvidence) -> Floats:
    """Return whether the laser may be elsewhere beyond a gap beside each scan, as a multiple of the bound: 1 or 0."""
    return evidence.beside_gap


class Feature(NamedTuple):
    """A reason to doubt a track: its strength at each scan, (n,), and the quantile over the scans that is used.

    ``alone`` is the increase of the log-odds with each doubling of its value for a track without a second one, 0 if the
    feature needs that; ``compared`` that for a track that was compared with a resampled one.
    """

    reason: str
    of: Callable[[TrackEvidence], Floats]
    quantile: float
    alone: float
    compared: float

    def total(self, shown: Floats) -> float:
        """Return the value for a track from the values of its scans; NaN if it was not measured."""
        return float(np.quantile(shown, self.quantile)) if len(shown) else np.nan


DISAGREEMENT: Final = "tracks_disagree"
"""The feature that needs a second track."""

ONE_SCAN, MANY_SCANS = 1.0, 0.9

FEATURES: Final = {
    DISAGREEMENT: Feature("two tracks disagree", disagreement, ONE_SCAN, 0.0, 1.47),
    "second_lost": Feature(SECOND_LOST, second_lost, ONE_SCAN, 0.0, 0.56),
    "slip": Feature("slip", slip, ONE_SCAN, 0.53, 0.1),
    "weakly_constrained": Feature("weakly constrained pose", weak, ONE_SCAN, 1.07, 0.75),
    "second_motion": Feature(SECOND_MOTION, other_motion, ONE_SCAN, 1.93, 1.78),
    "odometry_disagrees": Feature("odometry contradicts", odometry_disagrees, MANY_SCANS, 0.45, 0.3),
    "placed_by_odometry": Feature("placed by odometry alone", placed_by_odometry, ONE_SCAN, 1.17, 0.79),
    "doubtful_gap": Feature("may have been carried", doubtful_gap, ONE_SCAN, 2.5, 2.5),
    "not_planar": Feature(NOT_PLANAR, not_planar, MANY_SCANS, 0.21, 0.1),
    "sparse_sampling": Feature("sampling too sparse for the motion", sparse, MANY_SCANS, 0.35, 0.0),
    "few_points": Feature("too few beams", few_points, MANY_SCANS, 0.72, 0.0),
}
"""A slip shows at one scan, conflicts at many. The weights are as `python benchmarks/doubt.py fit` printed them
before odometry was fused; a laser that may have been carried is marked by that alone."""


class Weights(NamedTuple):
    """The log-odds of a track with all features at their least, and the increase by each doubling of a feature."""

    bias: float
    weights: Mapping[str, float]


ONE_TRACK: Final = Weights(-4.17, {name: feature.alone for name, feature in FEATURES.items() if feature.alone})
TWO_TRACKS: Final = Weights(-4.26, {name: feature.compared for name, feature in FEATURES.items() if feature.compared})
