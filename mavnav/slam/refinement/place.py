"""Put a finished map where it was asked for: along its walls, or with its first pose at a given one."""

from __future__ import annotations

from mavnav.slam.loop_closure.detection import rebuild_at
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.track import Track


def place_map(track: Track, refiner: Refiner) -> Track:
    """Put the map and its poses where the track's placement says, if it has one; not if the run is stopped early."""
    if track.placement is None or not refiner.builds_map:
        return track
    map_T_begin = track.placement(track.method.grid.by_rows())
    if map_T_begin is None:
        return track.with_warning("the map has no straight wall to be aligned by, and is not turned")
    rebuilt = rebuild_at(track, tracked_trajectory(track.steps).seen_from(map_T_begin))
    return rebuilt.with_findings(map_T_begin=map_T_begin) if rebuilt else track
