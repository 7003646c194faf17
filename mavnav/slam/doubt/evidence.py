"""What a finished track shows of its own quality, scan by scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.loop_closure.remap import points_of
from mavnav.slam.resampled_track import coarser
from mavnav.units import DEG

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.slam.method import Refiner
    from mavnav.slam.track import Track

    Floats = NDArray[np.float64]

SHARPEST, LEAST_TURN_RAD = 12, 30 * DEG
"""So many scans after the sharpest turns are compared with other headings; smaller turns confuse no two of them."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Arrays with a row for every tracked scan, and two counts.

    ``stamps_ns`` (n,); ``xyyaw`` (n, 3) the poses in the map frame, m and rad; ``points`` (n,) that were matched;
    ``observed`` and ``conflicts`` (n,) observability and visibility conflicts in the finished map; ``rivals`` (n,) by
    how much the best other heading costs more, as a share of the worst cost, inf where there is no sharp turn;
    ``resampled`` (n, 3) the poses of a track with coarser voxels, NaN where there is none; ``tilt_rad`` (n,) the tilt
    by an inertial sensor, 0 without one.
    ``period_s`` is the sensor's; ``odometry`` says whether it predicts the poses, ``contradicted`` whether it was left
    out; ``refused`` counts the loops that were found and not used, ``closed`` those that were.
    """

    period_s: float
    odometry: bool
    contradicted: bool
    refused: int
    closed: int
    stamps_ns: NDArray[np.int64]
    xyyaw: Floats
    points: NDArray[np.int64]
    observed: Floats
    conflicts: Floats
    rivals: Floats
    resampled: Floats
    tilt_rad: Floats


def evidence_of(track: Track, refiner: Refiner) -> Evidence:
    """Gather what the finished track shows without another one."""
    tracked = track.steps.column("tracked")
    xyyaw = track.steps.column("map_T_laser")[tracked]
    stamps_ns, rotation = track.steps.column("stamp_ns")[tracked], track.motion.rotation
    return Evidence(
        period_s=track.motion.period_s,
        odometry=track.motion.odometry is not None,
        contradicted=track.odometry_contradicts,
        refused=track.loops.refused,
        closed=len(track.loops.closed),
        stamps_ns=stamps_ns,
        xyyaw=xyyaw,
        points=track.steps.column("beams_used")[tracked],
        observed=track.observed[tracked],
        conflicts=track.conflicts[tracked],
        rivals=rivals(track, refiner, xyyaw[:, 2]),
        resampled=track.resampled[tracked] if len(track.resampled) else np.full(xyyaw.shape, np.nan),
        tilt_rad=np.zeros(len(stamps_ns)) if rotation is None else rotation.tilts_rad(stamps_ns),
    )


def wrapped(yaws_rad: Floats) -> Floats:
    """Bring angles to [-pi, pi)."""
    return (yaws_rad + pi) % (2.0 * pi) - pi


def turns_rad(yaws_rad: Floats) -> Floats:
    """Return by how much each of the headings (n,) differs from the one before, 0 for the first."""
    return np.abs(wrapped(np.diff(yaws_rad, prepend=yaws_rad[:1])))


def rivals(track: Track, refiner: Refiner, yaws_rad: Floats) -> Floats:
    """Compare the scans after the sharpest turns with all other headings; inf for the others."""
    out, turned = np.full(len(yaws_rad), np.inf), turns_rad(yaws_rad)
    sharpest = np.sort(np.argsort(-turned, kind="stable")[:SHARPEST])
    rows = sharpest[turned[sharpest] >= LEAST_TURN_RAD].tolist()
    if rows:
        steps = [step for step in track.steps if step.tracked]
        coming = points_of(track.log_scans, track.steps, refiner, rows)
        for row, points in zip(rows, coming, strict=False):
            out[row] = refiner.rival(points, steps[row].match)
    return out


def with_resampled_track(track: Track) -> Track:
    """Add the poses of a track with coarser voxels; none if the run is being stopped."""
    other = track.again(replace(track, config=coarser(track.config)))
    if other is None:
        return track
    again, poses = other.steps.column("tracked"), other.steps.column("map_T_laser")
    return replace(track, resampled=np.where(again[:, None], poses, np.nan))
