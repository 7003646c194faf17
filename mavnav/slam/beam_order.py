"""In which order a laser fires its beams: as the log tells, or backwards (docs/method.md).

Some drivers turn the list of beams round and leave the time between them positive; undoing the motion of a sweep
the wrong way round then blurs every turn twice over.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mavnav.scan import Scan
    from mavnav.slam.scan_matching import Match

STRETCH_SCANS = 80
"""Both orders are tried on so many scans, where the laser turns most."""

LEAST_TURN_RAD = 90 * DEG
"""A stretch that turns less tells nothing."""

CLEARLY = 0.9
"""The told order is kept unless the other one costs less than this share of it."""

GLANCE_EVERY, PLAINLY = 8, 1.33
"""Every so manieth scan of the stretch is placed in both orders in the map of the track; where the other order costs
so many times as much there, it is not tried. Of four logs and their reverse: 1.37 to 2.5 where the told order is right,
0.5 to 1.02 where it is wrong; 1.28 of a simulated one, whose map has taken on the wrong order."""


def backwards(scan: Scan) -> Scan:
    """Return the scan with its last beam fired first."""
    return replace(scan, spec=replace(scan.spec, time_increment_s=-scan.spec.time_increment_s))


def turning_stretch(yaws_rad: NDArray[np.float64]) -> range:
    """Find the ``STRETCH_SCANS`` scans over which the headings (n,) turn most; empty where they hardly do."""
    turns = np.abs((np.diff(yaws_rad) + pi) % (2.0 * pi) - pi)
    length = min(STRETCH_SCANS, len(turns))
    if length == 0:
        return range(0)
    sums = np.convolve(turns, np.ones(length), "valid")
    first = int(np.argmax(sums))
    return range(first, first + length) if sums[first] >= LEAST_TURN_RAD else range(0)


def is_plainly_told(told: Sequence[Match], other: Sequence[Match]) -> bool:
    """Judge by a few scans of the stretch, matched in either order with the map that the told one made."""
    costs = _costs(told, other)
    return len(costs) > 0 and bool(costs[:, 1].mean() > PLAINLY * costs[:, 0].mean())


def is_backwards(told: Sequence[Match], other: Sequence[Match]) -> bool:
    """Judge by the matches of the same scans, tracked with either order: the right one makes the sharper map."""
    costs = _costs(told, other)
    return len(costs) > 0 and bool(costs[:, 1].mean() < CLEARLY * costs[:, 0].mean())


def _costs(told: Sequence[Match], other: Sequence[Match]) -> NDArray[np.float64]:
    """Return the costs (n, 2) of the scans that either order could be matched in."""
    both = [(a.cost_m2, b.cost_m2) for a, b in zip(told, other, strict=True)]
    return np.array([pair for pair in both if np.isfinite(pair).all()]).reshape(-1, 2)
