"""Poses in a given map that its walls and its free space contradict: the laser was elsewhere, or the map is another.

After a gap one scan that fits places the laser. In a room that is not in the map, or in the map of another building,
it can fit somewhere by chance, and the scans after it as well. Then beams pass through walls of the map, or end where
it is free, in all scans up to the next gap.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import LOST_SCANS, Steps, jumps, lost_intervals, tracked_trajectory
from mavnav.slam.methods.registry import Refiner, make_method
from mavnav.slam.track import Track
from mavnav.units import NS, pluralize

CONTRADICTED, GIVEN_UP = 0.05, 0.1
"""Mean shares of visibility conflicts above which a warning doubts a stretch, and above which it may be given up.

Simulated floors: 0.03 to 0.18 at wrong poses, up to 0.01 at right ones, 0.02 to 0.10 where furniture moved. Parts of
fr079 in the maps of others: up to 0.13 at right poses.
"""

TIMES_MORE, LEAST_SCANS = 3.0, 10
"""A stretch is given up if its conflicts are so many times those of the longest one, of so many scans at least, that
the map does not contradict. Where furniture moved all over the map, or people crowd it, no stretch is like that."""


def drop_contradicted(track: Track, refiner: Refiner) -> Track:
    """Give up the stretches of poses in a given map that it contradicts most, if it does not contradict others.

    Stretches end at gaps and jumps. A warning names those that are given up, and another one those that the map
    contradicts less. A laser that is followed all along is at the right place, in a map with noise too.
    """
    if refiner.builds_map or not any(lost_intervals(track.steps)):
        return track
    placed = ((refiner.match_points(scan, motion), step.match) for step, scan, motion in track.placed_scans())
    conflicts = np.array([refiner.conflicts(points, match) for points, match in placed])
    if not len(conflicts):  # nothing was tracked, or the run is stopped
        return track
    rows = np.flatnonzero(track.steps.column("tracked"))[: len(conflicts)]  # fewer where the run is stopped
    runs = stretches(track.steps, rows)
    given_up, doubtful = contradicted_stretches([conflicts[part] for part in runs])
    if doubtful:
        scans = _scans(track.steps, [rows[runs[k]] for k in doubtful])
        track = track.with_warning(
            f"the poses of {scans} may be wrong, the given map contradicts them: it is of another place, or much has "
            "changed there; compare both maps with mavnav diff"
        )
    return _without_stretches(track, [rows[runs[k]] for k in given_up]) if given_up else track


def stretches(steps: Steps, rows: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return the stretches of tracked steps ``rows`` (n,) between gaps and jumps, as indices into ``rows``."""
    path = tracked_trajectory(Steps(steps[k] for k in rows.tolist()))
    ends = (np.diff(rows) > LOST_SCANS) | jumps(path)[0]
    return np.split(np.arange(len(rows)), np.flatnonzero(ends) + 1)


def contradicted_stretches(conflicts: list[NDArray[np.float64]]) -> tuple[list[int], list[int]]:
    """Return which stretches are given up, and which others are doubtful, by the conflicts (n,) of their scans."""
    means = [float(some.mean()) for some in conflicts]
    clean = [some for some, mean in zip(conflicts, means, strict=True) if mean <= CONTRADICTED]
    longest = max(clean, key=len, default=np.zeros(0))
    most = max(GIVEN_UP, TIMES_MORE * float(longest.mean())) if len(longest) >= LEAST_SCANS else np.inf
    given_up = [k for k, mean in enumerate(means) if mean > most]
    return given_up, [k for k, mean in enumerate(means) if CONTRADICTED < mean <= most]


def _without_stretches(track: Track, given_up: list[NDArray[np.intp]]) -> Track:
    """Return a track without the poses of some steps, and its map drawn again without their scans."""
    steps = Steps(track.steps)
    for row in np.concatenate(given_up).tolist():
        step = steps[row]
        steps[row] = step._replace(match=no_match(step.match.map_T_laser, step.match.beams_used), tracked=False)
    other = replace(track, method=make_method(track.config, track.prior_map), steps=steps)
    for step, scan, motion in other.placed_scans():
        other.method.insert(scan, step.match.map_T_laser, motion)
    return other.with_warning(
        f"the given map contradicts {_scans(track.steps, given_up)}: the laser was outside of the map, or much has "
        "changed there; these have no pose"
    )


def _scans(steps: Steps, parts: list[NDArray[np.intp]]) -> str:
    """Write how many scans some stretches have, and when they were, in s after the first scan."""
    first_ns, count = steps[0].stamp_ns, sum(map(len, parts))
    times_s = [[(steps[int(part[k])].stamp_ns - first_ns) * NS for k in (0, -1)] for part in parts]
    when = ", ".join(f"{start_s:.1f} to {end_s:.1f} s" for start_s, end_s in times_s[:3])
    return f"{pluralize(count, 'scan')} ({when}{f' and {len(times_s) - 3} more' if len(times_s) > 3 else ''})"
