"""Beam order: whether a laser fires its beams in the listed order or in reverse (docs/method.md).

Some drivers reverse the list of beams but keep the time between them positive. De-skewing in the wrong order doubles
the blur of every turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from math import nan, pi
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.scan import Scan
from mavnav.slam.matching.motion_model import GAP_S, LONGEST_S, motion_at
from mavnav.slam.matching.scan_matching import Match
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.retries.attempt import Attempt
from mavnav.slam.retries.beginning import UNTIL_LOST
from mavnav.slam.retries.odometry import LEAST_TURN_RAD
from mavnav.slam.track import LogScans, Track
from mavnav.units import NS

Floats = NDArray[np.float64]
Change = Callable[[Scan], Scan]
"""Return a scan as of a laser that takes its beams at other times."""
Pairs = list[tuple[Match, Match]]
"""Matches of the same scans, as listed and changed."""


STRETCH_SCANS = 80
"""Number of scans, those with most rotation, that are compared."""

LEAST_COMPARED = 10
"""Minimum number of scans tracked in both orders for a comparison."""

BETTER = 0.9
"""Ratio of the mean costs, of scans de-skewed anew to de-skewed as stated, below which the new way is used."""

SAMPLE_EVERY, LISTED_RATIO = 8, 1.6
"""Step between scans that are matched in both ways in the map of the track, and the cost ratio that decides at once.

Above it, changed to listed, they are used as listed. On 19 logs, a simulated one and their reverse, also with parts of
scans or beams removed, that of reverse order is 1.09 to 10.3 where the listed order is right, and 0.36 to 1.41 where it
is wrong: the map was made in the listed order, and favors it. With eight times as many scans it is up to 1.52 where it
is wrong. That of another time of the sweep is 0.29 to 1.18 where the stated one is wrong (17 logs).
"""

WARNING = "beams were fired in the reverse of the listed order, judged by the turns, and are de-skewed so"


def reverse_beams(track: Track) -> Track | None:
    """Return a track with the beams in reverse order if that is the order of the laser."""
    if not has_reversed_order(track):
        return None
    return replace(track.with_warning(WARNING), log_scans=partial(reversed_scans, track.log_scans))


REVERSED_BEAMS: Final = Attempt("reversed beams", reverse_beams)


def reversed_scans(log_scans: LogScans) -> Iterator[Scan]:
    """Yield all scans of a log with the last beam fired first."""
    return map(reversed_scan, log_scans())


def has_reversed_order(track: Track) -> bool:
    """Return whether the reverse order fits better where the laser turned most.

    A few scans are matched in both orders in the map of the track. Unless they decide for the listed one, both orders
    are tracked, each on a separate map.
    """
    refiner = track.method.refiner
    if refiner is None or track.config.robust.deskew != "auto":
        return False
    stretch = turning_stretch(track.steps.column("map_T_laser")[:, 2])
    scans = list(islice(track.log_scans(), stretch.start, stretch.stop))
    if not any(scan.spec.time_increment_s for scan in scans):
        return False
    in_map = cost_ratio_in_map(scans, stretch, track, reversed_scan)
    return not in_map > LISTED_RATIO and next(cost_ratios(scans, stretch, track, [reversed_scan])) < BETTER


def cost_ratio_in_map(scans: list[Scan], stretch: range, track: Track, change: Change) -> float:
    """Match some scans of a stretch as listed and changed in the map of a track; return their `cost_ratio`."""
    refiner, along = track.method.refiner, track.motion._replace(odometry=None)
    steps, pairs = track.steps[stretch.start : stretch.stop], []
    for before, step, scan in islice(zip(steps, steps[1:], scans[1:], strict=False), 0, None, SAMPLE_EVERY):
        if refiner and before.tracked and step.tracked:
            motion = motion_at(along, step, before)
            both = (refiner.match_points(each, motion) for each in (scan, change(scan)))
            listed, other = (refiner.refine(points, step.match) for points in both)
            pairs.append((listed, other))
    return cost_ratio(pairs)


def cost_ratios(scans: list[Scan], stretch: range, track: Track, changes: Iterable[Change]) -> Iterator[float]:
    """Track the scans of a stretch as listed and with each change, on separate maps; yield the `cost_ratio` of each.

    The path of the track predicts the poses. The tracks end where they are lost. The ratio is
    NaN with fewer than ``LEAST_COMPARED`` scans.
    """
    some = [scans[row - stretch.start] for row in turning_scans(stretch, track)]
    path = partial(tracked_trajectory(track.steps).at, max_gap_ns=int(LONGEST_S / NS))
    alone = replace(track, prior_map=None, begin=0, motion=track.motion._replace(odometry=path))
    listed = alone.over(some, until=UNTIL_LOST).steps
    for change in changes:
        other = alone.over(map(change, some), until=UNTIL_LOST).steps
        both = [(a.match, b.match) for a, b in zip(listed, other, strict=False) if a.tracked and b.tracked]
        yield cost_ratio(both if len(both) >= LEAST_COMPARED else [])


def turning_scans(stretch: range, track: Track) -> list[int]:
    """Return the numbers of the tracked scans of a stretch, without a long gap, that turn most."""
    steps = track.steps
    rows = stretch.start + np.flatnonzero(steps.column("tracked")[stretch.start : stretch.stop])
    apart_s = np.diff(steps.column("stamp_ns")[rows]) * NS
    runs = np.diff(np.flatnonzero(np.concatenate(([True], apart_s > LONGEST_S, [True]))))
    part = turning_stretch(steps.column("map_T_laser")[rows, 2], int(runs.max()) - 1, 0.0, apart_s)
    chosen: list[int] = rows[part.start : part.stop].tolist()
    return chosen


def reversed_scan(scan: Scan) -> Scan:
    """Return the scan with the beams fired in reverse order."""
    return replace(scan, spec=replace(scan.spec, time_increment_s=-scan.spec.time_increment_s))


def turning_stretch(
    yaws_rad: Floats, scans: int = STRETCH_SCANS, least_rad: float = LEAST_TURN_RAD, apart_s: Floats | None = None
) -> range:
    """Return the range of up to ``scans`` scans over which the headings (n,) turn most.

    It is empty where they turn by less than ``least_rad``. With the times between the scans, (n - 1,), turns across a
    gap of more than ``GAP_S`` do not count, and the range has no gap of more than ``LONGEST_S``.
    """
    turns = np.abs((np.diff(yaws_rad) + pi) % (2.0 * pi) - pi)
    if apart_s is not None:
        turns[apart_s > GAP_S] = 0.0
        turns[apart_s > LONGEST_S] = -np.inf
    length = min(scans, STRETCH_SCANS, len(turns))
    if length <= 0:
        return range(0)
    sums = np.convolve(turns, np.ones(length), "valid")
    first = int(np.argmax(sums))
    return range(first, first + length) if sums[first] >= least_rad else range(0)


def cost_ratio(pairs: Pairs) -> float:
    """Return the ratio of the mean costs, changed to listed, of scans matched in both ways; NaN without any."""
    both = np.array([(listed.cost_m2, other.cost_m2) for listed, other in pairs]).reshape(-1, 2)
    costs = both[np.isfinite(both).all(axis=1)]
    return float(costs[:, 1].mean() / costs[:, 0].mean()) if len(costs) else nan
