"""Beam order: in which order a laser fires its beams, as the log lists them or backwards (docs/method.md).

Some drivers turn the list of beams round and leave the time between them positive; undoing the motion of a sweep
in the wrong order then blurs every turn twice over.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import islice
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.beginning import until_missing
from mavnav.slam.steps import LOST_SCANS
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from mavnav.scan import Scan
    from mavnav.slam.method import Refiner
    from mavnav.slam.motion_model import Motion
    from mavnav.slam.scan_matching import Match
    from mavnav.slam.steps import Step
    from mavnav.slam.track import LogScans, Track

STRETCH_SCANS, LEAST_SCANS, TRIAL_SHARE = 80, 40, 0.25
"""Both orders are compared on so many scans, where the laser turns most; they are tracked on no more than this share
of a log, but on the second number of scans at least."""

LEAST_COMPARED = 10
"""Scans that both orders must have tracked to be compared."""

LEAST_TURN_RAD = 90 * DEG
"""A stretch that turns less decides nothing."""

CLEARLY = 0.9
"""The listed order is kept unless the other one costs less than this share of it."""

GLANCE_EVERY, PLAINLY = 8, 1.33
"""Every so manieth scan of the stretch is matched with both orders in the map of the track; if the other order costs
so many times as much there, it is not tried. On four logs and their reverse the factor is 1.37 to 2.5 where the listed
order is right, 0.5 to 1.02 where it is wrong; 1.28 on a simulated log whose map was made with the wrong order."""


WARNING = "beams were fired in the reverse of the listed order, judged by the turns, and are de-skewed so"


def with_reversed_beams(track: Track) -> Track:
    """Track again with the beams in reverse where that is their order."""
    if not fires_backwards(track):
        return track
    turned = track.again(replace(track, log_scans=partial(all_backwards, track.log_scans)))
    return turned.with_warning(WARNING) if turned else track


def all_backwards(log_scans: LogScans) -> Iterator[Scan]:
    """Give all scans of a log with their last beam fired first."""
    return map(backwards, log_scans())


def fires_backwards(track: Track) -> bool:
    """Try both beam orders where the laser turned most, each on a map of its own, unless a few matches decide it."""
    refiner = track.method.refiner
    if refiner is None or track.config.robust.deskew != "auto":
        return False
    stretch = turning_stretch(track.steps.column("map_T_laser")[:, 2])
    scans = list(islice(track.log_scans(), stretch.start, stretch.stop))
    if not any(scan.spec.time_increment_s for scan in scans):
        return False
    if is_plainly_listed(*glance(scans, track.steps[stretch.start : stretch.stop], track.motion, refiner)):
        return False
    return is_backwards(*trial(scans, stretch, track))


def trial(scans: list[Scan], stretch: range, track: Track) -> tuple[list[Match], list[Match]]:
    """Track the scans of a stretch that turn most on a map of their own, in both orders, as long as both go well."""
    yaws_rad = track.steps.column("map_T_laser")[stretch.start : stretch.stop + 1, 2]
    part = turning_stretch(yaws_rad, max(LEAST_SCANS, int(TRIAL_SHARE * len(track.steps))), 0.0)
    some, alone = scans[part.start : part.stop], replace(track, prior_map=None, begin=0)
    until = partial(until_missing, least_points=0, most_missed=LOST_SCANS, most_held=np.inf)
    listed, other = (alone.over(s, until=until).steps for s in (some, map(backwards, some)))
    both = [(a.match, b.match) for a, b in zip(listed, other, strict=False) if a.tracked and b.tracked]
    return ([a for a, _ in both], [b for _, b in both]) if len(both) >= LEAST_COMPARED else ([], [])


def glance(scans: list[Scan], steps: list[Step], motion: Motion, refiner: Refiner) -> tuple[list[Match], list[Match]]:
    """Match every 8th tracked scan once more in both beam orders, in the map that the listed one made."""
    listed, other = [], []
    for before, step, scan in islice(zip(steps, steps[1:], scans[1:], strict=False), 0, None, GLANCE_EVERY):
        if before.tracked and step.tracked:
            here = motion.started_at(step.match.map_T_laser, step.stamp_ns)
            here = here.coming_from(before.match.map_T_laser, before.stamp_ns)
            listed.append(refiner.refine(refiner.match_points(scan, here), step.match))
            other.append(refiner.refine(refiner.match_points(backwards(scan), here), step.match))
    return listed, other


def backwards(scan: Scan) -> Scan:
    """Return the scan with its last beam fired first."""
    return replace(scan, spec=replace(scan.spec, time_increment_s=-scan.spec.time_increment_s))


def turning_stretch(
    yaws_rad: NDArray[np.float64], scans: int = STRETCH_SCANS, least_rad: float = LEAST_TURN_RAD
) -> range:
    """Find so many scans over which the headings (n,) turn most; empty where they turn less than ``least_rad``."""
    turns = np.abs((np.diff(yaws_rad) + pi) % (2.0 * pi) - pi)
    length = min(scans, STRETCH_SCANS, len(turns))
    if length == 0:
        return range(0)
    sums = np.convolve(turns, np.ones(length), "valid")
    first = int(np.argmax(sums))
    return range(first, first + length) if sums[first] >= least_rad else range(0)


def is_plainly_listed(listed: Sequence[Match], other: Sequence[Match]) -> bool:
    """Judge by a few scans of the stretch, matched in either order with the map that the listed one made."""
    costs = _costs(listed, other)
    return len(costs) > 0 and bool(costs[:, 1].mean() > PLAINLY * costs[:, 0].mean())


def is_backwards(listed: Sequence[Match], other: Sequence[Match]) -> bool:
    """Judge by the matches of the same scans, tracked with either order: the right one makes the sharper map."""
    costs = _costs(listed, other)
    return len(costs) > 0 and bool(costs[:, 1].mean() < CLEARLY * costs[:, 0].mean())


def is_costlier(listed: Sequence[Match], other: Sequence[Match]) -> bool:
    """Judge by the same scans, matched in either order in one map: whether the listed order costs more."""
    costs = _costs(listed, other)
    return len(costs) >= LEAST_COMPARED and bool(costs[:, 1].mean() < costs[:, 0].mean())


def _costs(listed: Sequence[Match], other: Sequence[Match]) -> NDArray[np.float64]:
    """Return the costs (n, 2) of the scans that either order could be matched in."""
    both = [(a.cost_m2, b.cost_m2) for a, b in zip(listed, other, strict=True)]
    return np.array([pair for pair in both if np.isfinite(pair).all()]).reshape(-1, 2)
