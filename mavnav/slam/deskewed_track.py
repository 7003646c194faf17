"""The poses of a finished track, from scans that are de-skewed by it: the final pass takes scans as they are.

A turn of 1 rad/s moves the poses of a scan of 240 degrees by up to 20 mm, which no map shows and a calibration does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mavnav.slam.redraw import motions_along
from mavnav.slam.steps import Steps, tracked_trajectory

if TYPE_CHECKING:
    from mavnav.slam.track import Track


def match_deskewed(track: Track) -> Track:
    """Match every tracked scan once more against the finished map, de-skewed by the motion along the track.

    Where the run is being stopped, the later steps stay as they are.
    """
    if track.refiner is None:
        return track
    steps = Steps(track.steps)
    tracked = ((step, scan) for step, scan in zip(track.steps, track.log_scans(), strict=False) if step.tracked)
    motions = motions_along(tracked_trajectory(track.steps), track.motion)
    for (step, scan), motion in zip(tracked, motions, strict=False):
        match = track.refiner.refine(track.refiner.match_points(scan, motion), step.match)
        steps[step.index] = step._replace(match=match)
    return replace(track, steps=steps)
