"""The features of the doubt: the evidence of a track, and each reason to doubt it, with its strength and its weight."""

from __future__ import annotations

from itertools import compress
from math import pi
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.pose import motions
from mavnav.slam.doubt.second_motion import LEAST_AGREEING, second_motion
from mavnav.slam.findings import NOT_PLANAR, SECOND_MOTION
from mavnav.slam.loop_closure.detection import points_of
from mavnav.slam.retries.attempt import COARSER
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from mavnav.slam.methods.registry import Refiner
    from mavnav.slam.track import Track

    Floats = NDArray[np.float64]

SHARPEST, LEAST_TURN_RAD = 12, 30 * DEG
"""Number of scans, those after the sharpest turns, that are compared with other headings, and their minimum turn."""


class TrackEvidence(Struct, frozen=True):
    """Arrays with a row for every tracked scan, and scalars of the whole track.

    ``stamps_ns`` (n,); ``xyyaw`` (n, 3) the poses in the map frame, m and rad; ``points`` (n,) the numbers of matched
    points; ``observed`` and ``conflicts`` (n,) observability and visibility conflicts in the finished map;
    ``heading_margins`` (n,) the additional cost of the best other heading, as a share of the worst cost, inf without a
    sharp turn; ``resampled`` (n, 3) the poses of a track with coarser voxels, NaN without one; ``tilt_rad`` (n,) the
    tilt by an inertial sensor, 0 without one; ``second_motion`` (n,) the share of scans that fit another motion too, at
    those scans; ``by_odometry_m`` (n,) the error to be expected where odometry alone gives the pose, 0 elsewhere;
    ``odometry`` (n,): odometry predicts the pose. ``period_s`` is the scan period; ``contradicted``:
    odometry is not used; ``refused`` is the number of loops that were found and not used, ``closed`` of those that were
    used.
    """

    period_s: float
    odometry: NDArray[np.bool_]
    contradicted: bool
    refused: int
    closed: int
    stamps_ns: NDArray[np.int64]
    xyyaw: Floats
    points: NDArray[np.int64]
    observed: Floats
    conflicts: Floats
    heading_margins: Floats
    resampled: Floats
    tilt_rad: Floats
    second_motion: Floats
    by_odometry_m: Floats


def evidence_of(track: Track, refiner: Refiner) -> TrackEvidence:
    """Return the evidence of a finished track, without that of other tracks."""
    tracked, findings = track.steps.column("tracked"), track.findings
    xyyaw = track.steps.column("map_T_laser")[tracked]
    stamps_ns, rotation = track.steps.column("stamp_ns")[tracked], track.motion.rotation
    return TrackEvidence(
        period_s=track.motion.period_s,
        odometry=track.motion.odometry_at(stamps_ns),
        contradicted=track.odometry_contradicts,
        refused=findings.loops.refused,
        closed=len(findings.loops.closed),
        stamps_ns=stamps_ns,
        xyyaw=xyyaw,
        points=track.steps.column("beams_used")[tracked],
        observed=findings.observed[tracked],
        conflicts=findings.conflicts[tracked],
        heading_margins=heading_margins(track, refiner, xyyaw[:, 2]),
        resampled=np.full(xyyaw.shape, np.nan),
        tilt_rad=np.zeros(len(stamps_ns)) if rotation is None else rotation.tilts_rad(stamps_ns),
        second_motion=second_motion(track, refiner, findings.conflicts[tracked]),
        by_odometry_m=findings.by_odometry_m[tracked] if len(findings.by_odometry_m) else np.zeros(len(stamps_ns)),
    )


def wrap_angles(yaws_rad: Floats) -> Floats:
    """Wrap angles to [-pi, pi)."""
    return (yaws_rad + pi) % (2.0 * pi) - pi


def turns_rad(yaws_rad: Floats) -> Floats:
    """Return the rotation (n,) from the previous heading to each of the headings (n,), 0 for the first."""
    return np.abs(wrap_angles(np.diff(yaws_rad, prepend=yaws_rad[:1])))


def heading_margins(track: Track, refiner: Refiner, yaws_rad: Floats) -> Floats:
    """Return the heading margins of the scans after the sharpest turns (n,); inf for the others."""
    out, turned = np.full(len(yaws_rad), np.inf), turns_rad(yaws_rad)
    sharpest = np.sort(np.argsort(-turned, kind="stable")[:SHARPEST])
    rows = sharpest[turned[sharpest] >= LEAST_TURN_RAD].tolist()
    if rows:
        steps = [step for step in track.steps if step.tracked]
        coming = points_of(track.log_scans, track.steps, refiner, rows)
        for row, points in zip(rows, coming, strict=False):
            out[row] = refiner.heading_margin(points, steps[row].match)
    return out


def resampled_poses(track: Track) -> Floats | None:
    """Track the tracked scans with coarser voxels; return those poses (n, 3), NaN for scans without a pose there.

    None if the run is stopped early.
    """
    tracked = track.steps.column("tracked")
    config, begin = track.config.with_voxels(COARSER), int(tracked[: track.begin].sum())
    scans = compress(track.log_scans(), tracked)  # lost ones cannot be compared, and take most time
    other = replace(track, config=config, begin=begin).over(scans, "track again")
    if len(other.steps) < np.count_nonzero(tracked):
        return None
    return np.where(other.steps.column("tracked")[:, None], other.steps.column("map_T_laser"), np.nan)


WINDOWS_S = (2.0, 10.0)
"""Lengths of the windows over which the motion of two tracks is compared."""

WRONG_M, WRONG_RAD = 0.2, 5 * DEG
"""Largest error of the motion over a window of a track that is not wrong."""

STEADY_M, STEADY_RAD, SPIKE = 0.01, 0.02, 5.0
"""Changes of velocity per period, m and rad, that are added to the 0.9 quantile of all changes, and the factor.

A spike is the sum times the factor.
"""

SPARSE_M, SPARSE_RAD = 0.3, 20 * DEG
"""Motion between two scans above which sampling is sparse."""

WEAK, FEW_POINTS, CONFLICTS, LEAST_MARGIN = 0.01, 80, 0.05, 0.15
"""Bounds: observability below it is weak, points fewer, conflicts more, heading margins smaller raise doubt."""

TILT_RAD = 10 * DEG
"""Tilt above which motion is not planar: a wall 3 m away is then met 0.5 m higher or lower."""

GAP_S = 2.0
"""Time without a pose that is long."""


def disagreement(evidence: TrackEvidence) -> Floats:
    """Return the difference of two tracks in the motion from or to each scan, as a multiple of the bound for wrong.

    NaN without a second track.
    """
    common = np.flatnonzero(np.isfinite(evidence.resampled[:, 0]))
    out = np.full(len(evidence.stamps_ns), 0.0 if len(common) else np.nan)
    stamps_s, start = evidence.stamps_ns[common] * NS, np.arange(len(common))
    for window_s in WINDOWS_S if len(common) else ():
        end = np.minimum(np.searchsorted(stamps_s, stamps_s + window_s), len(common) - 1)
        off = motions(evidence.xyyaw[common], start, end) - motions(evidence.resampled[common], start, end)
        share = np.maximum(np.hypot(off[:, 0], off[:, 1]) / WRONG_M, np.abs(wrap_angles(off[:, 2])) / WRONG_RAD)
        share[stamps_s[end] - stamps_s > window_s + 1.5] = 0.0  # across a gap neither is reliable
        np.maximum.at(out, common, share)
        np.maximum.at(out, common[end], share)
    return out


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
    """Return how weakly the walls constrain each pose; 0 with odometry."""
    return np.where(evidence.odometry, 0.0, _weakness(evidence))


def weak_but_odometry(evidence: TrackEvidence) -> Floats:
    """Return how weakly the walls constrain each pose with odometry; 0 without."""
    return np.where(evidence.odometry, _weakness(evidence), 0.0)


def _weakness(evidence: TrackEvidence) -> Floats:
    return WEAK / np.maximum(evidence.observed, 1e-5)


def sparse(evidence: TrackEvidence) -> Floats:
    """Return the motion before each scan as a multiple of the bound for sparse sampling."""
    moved_m = np.linalg.norm(np.diff(evidence.xyyaw[:, :2], axis=0, prepend=evidence.xyyaw[:1, :2]), axis=1)
    return np.asarray(np.maximum(moved_m / SPARSE_M, turns_rad(evidence.xyyaw[:, 2]) / SPARSE_RAD))


def not_planar(evidence: TrackEvidence) -> Floats:
    """Return the visibility conflicts with the finished map, or the tilt if larger, as multiples of their bounds."""
    return np.asarray(np.maximum(evidence.conflicts / CONFLICTS, evidence.tilt_rad / TILT_RAD))


def few_points(evidence: TrackEvidence) -> Floats:
    """Return the bound for few points as a multiple of the matched points."""
    return FEW_POINTS / np.maximum(evidence.points, 1)


def gap(evidence: TrackEvidence) -> Floats:
    """Return the time since the last pose as a multiple of a long gap."""
    return np.diff(evidence.stamps_ns, prepend=evidence.stamps_ns[:1]) * NS / GAP_S


def symmetric(evidence: TrackEvidence) -> Floats:
    """Return the turn before each scan that fits at another heading as well, as a multiple of a sparse turn."""
    return np.where(evidence.heading_margins < LEAST_MARGIN, turns_rad(evidence.xyyaw[:, 2]) / SPARSE_RAD, 0.0)


def unclosed_loop(evidence: TrackEvidence) -> Floats:
    """Return the number of refused loops, if none was closed; equal for all scans."""
    return np.full(len(evidence.stamps_ns), 0.0 if evidence.closed else float(evidence.refused))


def odometry_contradicts(evidence: TrackEvidence) -> Floats:
    """Return 2 for all scans if the odometry of the log contradicts the track, and is not used; else 0."""
    return np.full(len(evidence.stamps_ns), 2.0 * evidence.contradicted)


def other_motion(evidence: TrackEvidence) -> Floats:
    """Return the share of scans that fit a second motion, at those scans, as a multiple of the bound."""
    return evidence.second_motion / LEAST_AGREEING


def placed_by_odometry(evidence: TrackEvidence) -> Floats:
    """Return the expected error of poses that odometry alone gives, as a multiple of the bound for wrong."""
    return evidence.by_odometry_m / WRONG_M


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
    DISAGREEMENT: Feature("two tracks disagree", disagreement, ONE_SCAN, 0.0, 1.32),
    "slip": Feature("slip", slip, ONE_SCAN, 0.99, 0.56),
    "weakly_constrained": Feature("weakly constrained pose", weak, MANY_SCANS, 2.01, 1.67),
    "weak_with_odometry": Feature("weakly constrained pose", weak_but_odometry, MANY_SCANS, 1.31, 0.73),
    "sparse_sampling": Feature("sampling too sparse for the motion", sparse, MANY_SCANS, 0.79, 0.66),
    "symmetric_place": Feature("symmetric place", symmetric, ONE_SCAN, 0.9, 0.1),
    "not_planar": Feature(NOT_PLANAR, not_planar, MANY_SCANS, 0.77, 0.66),
    "few_points": Feature("too few beams", few_points, MANY_SCANS, 0.48, 0.14),
    "gap": Feature("gap", gap, ONE_SCAN, 0.1, 0.16),
    "unclosed_loop": Feature("unclosed loop", unclosed_loop, ONE_SCAN, 0.62, 0.37),
    "second_motion": Feature(SECOND_MOTION, other_motion, ONE_SCAN, 1.78, 1.81),
    "placed_by_odometry": Feature("placed by odometry alone", placed_by_odometry, ONE_SCAN, 3.12, 3.25),
    "odometry_contradicts": Feature("odometry contradicts", odometry_contradicts, ONE_SCAN, 0.1, 0.1),
}
"""A slip shows at one scan, weak geometry at many. The weights are as printed by `python benchmarks/doubt.py fit`.

That of a second motion was fitted later (``fit --only``), and the others held. That of a part placed by odometry
follows from its meaning: it is wrong in half of the cases if the median error to be expected is the bound for wrong.
"""


class Weights(NamedTuple):
    """The log-odds of a track with all features at their least, and the increase by each doubling of a feature."""

    bias: float
    weights: Mapping[str, float]


ONE_TRACK: Final = Weights(-6.25, {name: feature.alone for name, feature in FEATURES.items() if feature.alone})
TWO_TRACKS: Final = Weights(-6.5, {name: feature.compared for name, feature in FEATURES.items()})
