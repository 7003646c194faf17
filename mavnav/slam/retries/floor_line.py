"""The floor ahead of a laser that is pitched down: returns of it move along with the vehicle, and are left out.

A beam 3 deg down meets the floor a few meters ahead. Along a corridor these returns are a line across the one direction
that walls leave open: a track that takes it for a wall stands still, every scan fits, and right odometry seems to err.
Every wall comes nearer while the vehicle drives straight on, the floor as often does not, however the pitch varies, and
no laser sees anything past it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import motions
from mavnav.scan import Line, Scan, scan_before
from mavnav.slam.matching.odometry_fit import LEAST_WINDOWS, MOST_WINDOWS, a_second_apart
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.retries.odometry import by_wheels
from mavnav.slam.track import LogScans, Track
from mavnav.units import DEG

Floats = NDArray[np.float64]


LEAST_MOVED_M: Final = 0.1
"""Motion in a second, m, by which the distance to a wall ahead clearly changes."""

STRAIGHT_RAD: Final = 5 * DEG
"""Largest turn in a second of a vehicle that drives straight on, as a curved wall stays along a curve, and angle to the
driving direction of the beams that look straight ahead, as others meet the sides of a corridor."""

MOST_OBLIQUE_RAD: Final = 45 * DEG
"""Largest angle by which the line is oblique: the laser rolls as much as it pitches, or is turned on the vehicle."""

VARIES, NEAREST = 0.33, 0.05
"""Share of its distance by which the floor is nearer or farther where the pitch varies by 1 deg, as on soft suspension,
and share of the scans in which it may be nearer than where it is taken to be."""

STAYS, NEAR = 0.5, 0.1
"""Share of the motion, across the line, by which most motions bring no floor nearer, nor farther in the median; and
share of its distance, as roll and noise change it, past which a scan sees nothing, and before which it is left out."""

APPROACHES: Final = 0.2
"""Share of the motion by which a wall comes nearer in the median where odometry counts too far; the floor does not."""

FEWEST_AHEAD, FARTHEST = 4, 5
"""Number of beams straight ahead that show a line, as three may meet two walls alike, and of points past the floor that
show that it is none; fewer may be stray returns."""

LEAST_SHARE, MOST_PAST = 0.3, 0.05
"""Share of the straight motions in which the floor must be ahead, and in which anything may be seen past it."""


def without_floor(track: Track) -> Track:
    """Return a track of scans without the floor, if odometry shows that they see it; not in causal mode."""
    line_m = floor_line(track) if track.refiner and track.motion.odometry else None
    if line_m is None:
        return track
    x_m, y_m = ((1.0 - NEAR) * line_m).tolist()
    cut = replace(track, log_scans=scans_before(track.log_scans, (x_m, y_m)))
    return cut.with_findings(floor_m=(x_m, y_m)).with_warning(floor_warning((x_m, y_m)))


def floor_warning(floor_m: Line) -> str:
    """Say that the returns from a line on are left out, and why."""
    return (
        f"what the laser sees {np.hypot(*floor_m) / (1.0 - NEAR):.2g} m ahead moves along with the vehicle, as the "
        "floor does if the laser is pitched down, or what is carried: returns from there on are left out; mount the "
        "laser level"
    )


def scans_before(log_scans: LogScans, floor_m: Line | None) -> LogScans:
    """Return the scans of a log without the returns at a line and past it, all returns without a line."""
    return log_scans if floor_m is None else lambda: (scan_before(scan, floor_m) for scan in log_scans())


def drives_along(track: Track, start: Track) -> bool:
    """Return whether a track drives where the odometry at its start does: wheels on a stand show no floor."""
    if track.motion.odometry is not None:
        return True
    path = tracked_trajectory(track.steps)
    by_wheels_m = np.hypot(*np.diff(by_wheels(start, path.stamps_ns)[:, :2], axis=0).T)
    return bool(path.length_m > STAYS * np.nansum(by_wheels_m))


def floor_line(track: Track) -> Floats | None:
    """Return the nearest point (2,) of the line in which the laser sees the floor, m, laser frame; None if it does not.

    The line is ahead or behind.
    """
    begins, ends, moved = straight_motions(track)
    if len(begins) < LEAST_WINDOWS:
        return None
    rows = np.unique((begins, ends))
    some = set(rows.tolist())
    scans = [scan for row, scan in enumerate(track.log_scans()) if row in some]
    if len(scans) < len(rows):  # the run is stopped
        return None
    begins, ends = np.searchsorted(rows, begins), np.searchsorted(rows, ends)
    axis = np.exp(0.5j * np.angle(np.square(moved[:, :2] @ (1.0, 1j)).sum()))  # of motions forward and backward
    for ahead in (np.array((axis.real, axis.imag)), -np.array((axis.real, axis.imag))):
        line_m = line_ahead([scans[row] for row in begins], ahead)
        distance_m = np.hypot(*line_m)
        across = line_m / max(distance_m, 1e-9)
        seen_m, farthest_m = np.array([reach_m(scan, ahead, across) for scan in scans]).T
        toward_m = moved[:, :2] @ across  # not sideways
        near = np.abs(seen_m[begins] - distance_m) < VARIES * distance_m
        past = farthest_m[begins] > (1.0 + NEAR) * np.clip(seen_m[begins], distance_m, (1.0 + VARIES) * distance_m)
        nearer = (seen_m[begins] - seen_m[ends]) / np.where(toward_m, toward_m, np.inf)
        straight = np.abs(moved[:, 2]) * distance_m < STAYS * np.abs(toward_m)  # along a curve walls may stay
        line = near & straight & ~past
        shown = line & (nearer < STAYS)
        if shown.mean() < LEAST_SHARE or past.mean() > MOST_PAST or ahead @ across < np.cos(MOST_OBLIQUE_RAD):
            continue
        if np.median(nearer[shown]) < APPROACHES and np.median(nearer[line]) > -STAYS:
            return np.asarray(np.quantile(seen_m[begins[shown]], NEAREST) * across)
    return None


def straight_motions(track: Track) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Return between which scans (n,) and (n,) odometry drives straight on, and the motions (n, 3), m and rad.

    They take about a second, and are ``MOST_WINDOWS`` at most, spread over the log.
    """
    stamps_ns = np.array([scan.stamp_ns for scan in track.log_scans()], np.int64)
    begins, ends = a_second_apart(stamps_ns)
    moved = motions(by_wheels(track, stamps_ns), begins, ends)
    driving = np.flatnonzero((np.hypot(*moved[:, :2].T) >= LEAST_MOVED_M) & (np.abs(moved[:, 2]) < STRAIGHT_RAD))
    driving = driving[:: 1 + len(driving) // MOST_WINDOWS]
    return begins[driving], ends[driving], moved[driving]


def line_ahead(scans: list[Scan], ahead: Floats) -> Floats:
    """Return the nearest point (2,) of the line through what beams straight ahead see, m; (0, 0) if they see nothing.

    ``ahead`` (2,) is a direction in the laser frame. The upper quartile over the scans counts: walls are before it.
    """
    directions = scans[0].spec.directions
    straight = directions @ ahead > np.cos(STRAIGHT_RAD)
    ranges_m = [np.nan_to_num(scan.ranges_m[straight]) for scan in scans if len(scan.ranges_m) == len(straight)]
    at_m = np.quantile(ranges_m, 0.75, axis=0, method="lower")
    seen = at_m > 0.0
    inverse = np.linalg.lstsq(directions[straight][seen] * at_m[seen, None], np.ones(seen.sum()), rcond=None)[0]
    return np.asarray(inverse / max(float(inverse @ inverse), 1e-9))


def reach_m(scan: Scan, ahead: Floats, across: Floats) -> tuple[float, float]:
    """Return how far most beams straight ahead see, 0 if nothing or too few, and how far the farthest points lie, m.

    Both are in the direction ``across`` (2,) of a line, of the beams about ``ahead`` (2,), laser frame.
    """
    along_m = np.nan_to_num(scan.ranges_m * (scan.spec.directions @ across))
    straight_m = along_m[scan.spec.directions @ ahead > np.cos(STRAIGHT_RAD)]
    few = min(FARTHEST, len(along_m))
    seen_m = float(np.median(straight_m)) if len(straight_m) >= FEWEST_AHEAD else 0.0
    return seen_m, float(np.partition(along_m, -few)[-few]) if few else 0.0
