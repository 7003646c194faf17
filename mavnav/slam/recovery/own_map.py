"""A log that is lost in a given map is mapped by itself, and its map is placed in the given one as a whole.

Maps of other tools have cells of 5 or 10 cm, walls of several cells and errors of their own. A single scan fits such a
map at many places, and its pose there is a rough one. All scans of a track together fit it at one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.slam.loop_closure.key_frames import key_rows
from mavnav.slam.matching.placement import place_together
from mavnav.slam.matching.scan_matching import empty_line_map
from mavnav.slam.matching.steps import Steps, lost_intervals, tracked_trajectory
from mavnav.slam.methods.acceptance import Acceptance
from mavnav.slam.methods.registry import make_method
from mavnav.slam.recovery.parts import SEARCHED_AFTER_PAUSE, evenly, lost_for_good
from mavnav.slam.retries.attempt import Attempt, rank

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.pose import Pose
    from mavnav.slam.matching.placement import PosedScan
    from mavnav.slam.methods.registry import Refiner
    from mavnav.slam.track import Track


def map_alone(track: Track) -> Track | None:
    """Return the track with a map of its own if the laser was lost for good in the given one."""
    given = track.prior_map
    if given is None or not track.refiner or not lost_for_good(track.steps, list(lost_intervals(track.steps))):
        return None
    return replace(track, prior_map=None, around_map=given)


def fits_given_map(other: Track, track: Track) -> bool:
    """Return whether a track with a map of its own loses fewer scans, and has one place in the given map."""
    return rank(other) < rank(track) and place_of(other) is not None


OWN_MAP: Final = Attempt("own map", map_alone, fits_given_map)


def place_of(track: Track) -> Pose | None:
    """Return the pose of the track's own frame in the given map; None if its scans do not fit at just one."""
    given, config = track.around_map, track.config
    if given is None:
        return None
    lines, grid = empty_line_map(config, given.grid.cell_m), GridBuilder.of(given.grid)
    lines.insert(given.walls_xy_m)
    match = place_together(list(_key_scans(track)), lines, grid, config, given.start)
    return match.map_T_laser if match and Acceptance(config.robust).is_good(match) else None


def _key_scans(track: Track) -> Iterator[PosedScan]:
    """Yield some scans of the track, at places all along it, with their poses."""
    rows, _ = key_rows(tracked_trajectory(track.steps).xyyaw)
    some = {rows[k] for k in evenly(len(rows), SEARCHED_AFTER_PAUSE)}
    for row, (step, scan, motion) in enumerate(track.placed_scans()):
        if row in some and track.refiner:
            yield step.match.map_T_laser, track.refiner.match_points(scan, motion)


def place_in_given_map(track: Track, _refiner: Refiner) -> Track:
    """Move a track with a map of its own to its place in the given map, and draw its map again there."""
    map_T_own = place_of(track)
    if map_T_own is None:
        return track
    moved = (s._replace(match=s.match._replace(map_T_laser=map_T_own @ s.match.map_T_laser)) for s in track.steps)
    other = replace(track, method=make_method(track.config), steps=Steps(moved))
    for step, scan, motion in other.placed_scans():
        other.method.insert(scan, step.match.map_T_laser, motion)
    return other.with_warning(
        "scan by scan the laser was lost in the given map: the log was mapped by itself, and its map placed in the "
        "given one as a whole; where that is bent, poses are off by as much: see both with mavnav diff"
    )
