"""A log that is lost in a given map is mapped alone, and its map is placed in the given one as a whole.

Maps of other tools have cells of 5 or 10 cm, walls of several cells and errors of their own. A single scan fits such a
map at many places, and its pose there is a rough one. All scans of a track together fit it at one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from msgspec.structs import replace

from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose
from mavnav.slam.loop_closure.detection import rebuild_at
from mavnav.slam.loop_closure.key_frames import key_rows
from mavnav.slam.matching.placement import PosedScan, place_together
from mavnav.slam.matching.scan_matching import empty_line_map
from mavnav.slam.matching.steps import evenly, tracked_trajectory
from mavnav.slam.methods.acceptance import Acceptance
from mavnav.slam.methods.registry import Refiner, make_method
from mavnav.slam.recovery.parts import is_lost
from mavnav.slam.retries.attempt import rank, try_again
from mavnav.slam.retries.beginning import track_from_good_beginning
from mavnav.slam.retries.odometry import FITTING_ODOMETRY
from mavnav.slam.track import Track

OWN_MAP: Final = "own map"

PLACED_SCANS: Final = 24
"""Number of scans that are placed together."""


def or_with_own_map(track: Track, start: Track) -> Track:
    """Return the track, or if the laser was lost for good in the given map, one with a map of its own that fits it.

    ``start`` is the track before its first scan. Another track is taken if it loses fewer scans, and has one place in
    the given map.
    """
    if not start.prior_map or not track.refiner or not is_lost(track.steps):
        return track
    method = make_method(track.config)
    alone = replace(start, log_scans=track.log_scans, method=method, prior_map=None, around_map=start.prior_map)
    other = try_again(track_from_good_beginning(alone), FITTING_ODOMETRY)
    kept = rank(other) < rank(track) and place_of(other) is not None
    return (other if kept else track).with_attempt(OWN_MAP, kept=kept)


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
    some = {rows[k] for k in evenly(len(rows), PLACED_SCANS)}
    for row, (step, scan, motion) in enumerate(track.placed_scans()):
        if row in some and track.refiner:
            yield step.match.map_T_laser, track.refiner.match_points(scan, motion)


def place_in_given_map(track: Track, _refiner: Refiner) -> Track:
    """Move a track with a map of its own to its place in the given map, and draw its map again there."""
    map_T_own = place_of(track)
    if map_T_own is None:
        return track
    other = rebuild_at(track, tracked_trajectory(track.steps).seen_from(map_T_own))
    return (other or track).with_warning(
        "scan by scan the laser was lost in the given map: the log was mapped alone, and its map placed in the "
        "given one as a whole; where that is bent, poses are off by as much: look at both in one frame, as in RViz"
    )
