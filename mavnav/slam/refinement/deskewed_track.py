"""The poses of a finished track, from scans that are de-skewed by it: the final pass takes scans as they are.

A turn of 1 rad/s moves the poses of a scan of 240 degrees by up to 20 mm, which no map shows and a calibration does.
"""

from __future__ import annotations

from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from mavnav.slam.matching.steps import Steps
from mavnav.slam.retries.beam_order import WARNING, is_costlier, reversed_scan, reversed_scans
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.scan import Scan
    from mavnav.slam.matching.scan_matching import Match
    from mavnav.slam.methods.method import Refiner
    from mavnav.slam.track import Track

TURNING_RAD_S: Final = 15 * DEG
"""At this rate and above a scan shows in which order its beams were fired."""

COMPARED_EVERY, MOST_COMPARED = 4, 100
"""Step between the scans in turns that are matched in both orders, and their maximum number."""


def match_deskewed(track: Track, refiner: Refiner) -> Track:
    """Match every tracked scan once more against the finished map, de-skewed by the motion along the track.

    In turns both beam orders are compared, now that the motion is known. Where the run is being stopped, the later
    steps stay as they are.
    """
    if WARNING not in track.findings.warnings and _fits_backwards(track, refiner):
        track = replace(track.with_warning(WARNING), log_scans=partial(reversed_scans, track.log_scans))
    steps = Steps(track.steps)
    for step, scan, motion in track.placed_scans():
        match = refiner.refine(refiner.match_points(scan, motion), step.match)
        steps[step.index] = step._replace(match=match)
    return replace(track, steps=steps)


def _fits_backwards(track: Track, refiner: Refiner) -> bool:
    """Return whether the scans in turns fit the map better with their last beam fired first."""
    if track.config.robust.deskew != "auto":
        return False
    turning = (each for each in track.placed_scans() if each[1].sweep_s and abs(each[2].twist[2]) >= TURNING_RAD_S)
    some = list(islice(turning, 0, COMPARED_EVERY * MOST_COMPARED, COMPARED_EVERY))

    def matches(order: Callable[[Scan], Scan]) -> list[Match]:
        return [refiner.refine(refiner.match_points(order(scan), motion), step.match) for step, scan, motion in some]

    return is_costlier(matches(lambda scan: scan), matches(reversed_scan))
