"""Evidence of the quality of a finished track, scan by scan."""

from __future__ import annotations

from itertools import compress
from math import pi
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.slam.doubt.second_motion import second_motion
from mavnav.slam.loop_closure.detection import points_of
from mavnav.slam.retries.attempt import COARSER
from mavnav.units import DEG

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.slam.methods.method import Refiner
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
