"""Returns of no wall: a value that a driver writes where nothing is in range, and the robot's own body.

The value is none of REP-117 and within the limits; taken for returns, it draws a ring around the laser wherever that
goes. Beams on the body see the same near thing all along, while the others see more: posts, plates and cables move with
the laser. Matched with the map, they hold a track back, and draw a trail.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.scan import Floats, LaserSpec, runs_of
from mavnav.units import DEG

MOST_SCANS, LEAST_SCANS = 128, 20
"""Number of scans of a log that are compared, evenly over all of it, and fewest that show anything."""

FARTHEST_M, SPREAD_M = 1.5, 0.1
"""Range within which the body lies, and by which a beam on it may vary, between the outer `QUANTILES`."""

QUANTILES: Final = 0.02, 0.5, 0.98
"""Quantiles of the ranges of a beam, with room for a few outliers, but not for a drive after a long rest at a dock."""

SHARE: Final = 0.75
"""Share of the scans in which a beam on the body has a return."""

MOVES_M, MOVING_SHARE = 0.3, 1 / 3
"""Variation of range, and share of the other beams that vary more: else the laser may be at rest."""

JUMP, BESIDE = 1.5, 0.01
"""Ratio of the ranges of the body and of what lies beside it, and share of the beams up to there: edges are blurred.

A wall that the laser moves along stays at one distance as well, but goes on beside those beams.
"""

LEAST_SHARE, LEAST_LEFT = 0.01, 0.5
"""Share of the beams on the body that makes a difference, and least number of other returns as a share of its own."""


class ScanSample(Struct):
    """Up to ``MOST_SCANS`` of many scans, evenly over all; ``ranges_m`` are theirs."""

    ranges_m: list[Floats] = field(default_factory=list)
    step: int = 1
    count: int = 0

    def add(self, ranges_m: Floats) -> None:
        """Take in one of every ``step`` scans, with its ranges (beams,), m."""
        if self.count % self.step == 0:
            self.ranges_m.append(ranges_m)
        self.count += 1
        if len(self.ranges_m) > MOST_SCANS:
            self.ranges_m, self.step = self.ranges_m[::2], 2 * self.step


def own_beams(sample: ScanSample) -> NDArray[np.bool_] | None:
    """Return which beams (n,) see the robot itself; None if hardly any do, or nothing shows it.

    Scans of other numbers of beams than most have their beams at the same angles.
    """
    if len(sample.ranges_m) < LEAST_SCANS:
        return None
    ((beams, _),) = Counter(map(len, sample.ranges_m)).most_common(1)
    ranges_m = np.sort([spread_over(each, beams) for each in sample.ranges_m], axis=0)  # NaN is last
    returns, columns = np.isfinite(ranges_m).sum(axis=0), np.arange(beams)
    low, middle, high = (ranges_m[(q * (returns - 1)).astype(np.intp), columns] for q in QUANTILES)
    constant = (returns >= SHARE * len(ranges_m)) & (high - low <= SPREAD_M) & (high <= FARTHEST_M)
    others = (high - low)[~constant & (returns > 0)]
    if np.count_nonzero(others > MOVES_M) <= MOVING_SHARE * len(others):
        return None
    own, reach = np.zeros(beams, np.bool_), max(round(BESIDE * beams), 1)
    for run in runs_of(constant):
        before, after = max(run.start - reach, 0), min(run.stop + reach, beams)
        ends = (run[0], before), (run[-1], after - 1)
        if all(beside in {0, beams - 1} or apart(middle[at], middle[beside]) for at, beside in ends):
            own[before:after] |= low[before:after] <= JUMP * max(middle[run[0]], middle[run[-1]])
    matters = own.sum() >= LEAST_SHARE * beams and returns[~own].sum() >= LEAST_LEFT * returns[own].sum()
    return own if matters else None


def apart(range_m: float, beside_m: float) -> bool:
    """Return whether two ranges are of two things; NaN is nothing in range."""
    return not 1.0 / JUMP <= beside_m / range_m <= JUMP


def without_beams(ranges_m: Floats, own: NDArray[np.bool_]) -> Floats:
    """Return ranges (n,), m, without those of beams (m,) at the same angles."""
    return np.where(spread_over(own, len(ranges_m)), np.nan, ranges_m)


def spread_over(values: NDArray[Any], beams: int) -> NDArray[Any]:
    """Return values of beams (n,) for another number of beams over the same angle: drivers of cheap lasers vary it."""
    if len(values) == beams:
        return values
    return values[np.round(np.linspace(0, len(values) - 1, beams)).astype(np.intp)]


def body_warning(own: NDArray[np.bool_], spec: LaserSpec) -> str:
    """Say which beams see the robot itself, and that they are left out."""
    angles_deg = spec.angles_rad / DEG
    sectors = [f"{angles_deg[run[0]]:.0f} to {angles_deg[run[-1]]:.0f}" for run in runs_of(own)]
    named = ", ".join(sectors[:4]) + ", ..." * (len(sectors) > 4)
    return (
        f"{own.sum()} of {len(own)} beams (at {named} deg) see the same within {FARTHEST_M:g} m all along, the robot's "
        "own parts: they are left out"
    )


LEAST_NONE, LEAST_BEAMS, MOST_NONE = 0.01, 3, 0.99
"""Shares of all returns, and number a scan, between which that value lies. More are a round room, from its centre."""

LEAST_NONE_SCANS = 5
"""Number of scans from which a value may be a driver's habit."""

NEAR, NEAR_M, RARE = 0.05, 0.3, 0.1
"""Part of the value, at least so many meters, up to which others are near, and largest count of any of these, and of
all beyond, as a share of its own: the distances of a wall are spread, also those of a laser that rounds them."""


def no_return_m(sample: ScanSample) -> float | None:
    """Return the largest or least range, m, that stands for no return in a sample of scans; None if none does."""
    ranges_m = np.concatenate([np.zeros(0), *sample.ranges_m])
    values_m, counts = np.unique(ranges_m[np.isfinite(ranges_m)], return_counts=True)
    if not len(counts) or len(sample.ranges_m) < LEAST_NONE_SCANS:
        return None
    k, total = int(np.argmax(counts)), int(counts.sum())
    count = int(counts[k])
    near_m = max(NEAR * values_m[k], NEAR_M)
    first, last = np.searchsorted(values_m, (values_m[k] - near_m, values_m[k] + near_m))
    near, beyond = np.delete(counts[first:last], k - first), min(counts[:k].sum(), counts[k + 1 :].sum())
    least = max(LEAST_NONE * total, LEAST_BEAMS * len(sample.ranges_m))
    stands_out = max(near.max(initial=0), beyond) <= RARE * count
    return float(values_m[k]) if least <= count <= MOST_NONE * total and stands_out else None


def without_value(ranges_m: Floats, none_m: float) -> Floats:
    """Return ranges (n,), m, with NaN in place of the one that stands for no return."""
    return np.where(ranges_m == none_m, np.nan, ranges_m)


def no_return_warning(none_m: float) -> str:
    """Say which value is taken for no return."""
    return f"many ranges are exactly {none_m:g} m, and hardly any are near that: this value is taken for no return"
