"""Self-consistency: distances between scans of the same place at their given poses.

No truth is needed. Neighbours in time show how well scans are matched, returns to a place how far the map has drifted.
"""

from __future__ import annotations

from typing import Annotated, Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.kernels.walls.overlap import scan_distances
from mavnav.metrics.fields import Measured, number
from mavnav.metrics.journey import PlacedScans, spread, used_beams
from mavnav.pose import Trajectory
from mavnav.units import DEG, MM

CAP_M: Final = 0.15
SHORT_GAP_NS: Final = (300_000_000, 3_000_000_000)
LONG_GAP_NS: Final = 10_000_000_000
LONG_DISTANCE_M: Final = 1.0
LONG_TURN_RAD: Final = 60.0 * DEG
PAIRS: Final = 1000
PARTNERS: Final = 4
"""Maximum number of revisits that a scan is paired with."""

EVERY: Final = 5
LEAST_POINTS, LEAST_TARGETS = 5, 20
_BLOCK: Final = 50_000
"""Number of pairs that are tested at a time."""

_GOLDEN: Final = 0.6180339887498949

APART: Final = "how far scans of a place lie from scans of the same place"


class Revisits(Struct, frozen=True):
    """Mean distances of scans that see the same walls; null without a pair.

    Neighbours are scans 0.3 to 3 s apart: distance of a point to the nearest one of the other scan, if that is within
    150 mm. Revisits are scans more than 10 s apart in time, within 1 m and 60 degrees of each other: distance over the
    points that the other scan could see, 150 mm at most.
    """

    nn_s_mm: Annotated[Measured, number("how far scans lie from their neighbors in time", title="neighbors")]
    nn_l_mm: Annotated[Measured, number(f"{APART} at another time", title="revisits", better="lower")]
    pairs: Annotated[int, number("pairs of scans at revisits")]
    visible_share: Annotated[Measured, number("part of the points of revisits that the other scan could see")]


class Pairs(NamedTuple):
    """Rows of the trajectory whose scans are compared, (n, 2) each: neighbours in time, and revisits of a place."""

    short: NDArray[np.intp]
    long: NDArray[np.intp]


def revisits(trajectory: Trajectory, pairs: Pairs, scans: PlacedScans | None) -> Revisits:
    """Return the self-consistency of a run; ``scans`` include those of the pairs' rows."""
    if scans is None:
        return Revisits(np.nan, np.nan, 0, np.nan)
    near, far = _distances(scans, trajectory, pairs.short), _distances(scans, trajectory, pairs.long)
    visible_share = float(far[:, 2].sum() / far[:, 4].sum()) if len(far) else np.nan
    return Revisits(_mean_mm(near[:, 0], near[:, 1]), _mean_mm(far[:, 2], far[:, 3]), len(far), visible_share)


def short_pairs(stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return pairs (n, 2) of scans with one 0.3 to 3 s before or after, evenly spread over the run."""
    rows = spread(len(stamps_ns), PAIRS)
    near, far = SHORT_GAP_NS
    older, younger = (stamps_ns[rows] + gap for gap in (-far, near))
    first, later = (np.searchsorted(stamps_ns, ends, side="right") for ends in (older, younger))
    counts, more = (
        np.searchsorted(stamps_ns, stamps_ns[rows] + gap) - start for gap, start in ((-near, first), (far, later))
    )
    number = (_fractions(len(rows)) * (counts + more)).astype(np.intp)
    partners = np.where(number < counts, first + number, later + number - counts)
    return np.column_stack((rows, partners))[counts + more > 0]


def long_pairs(trajectory: Trajectory) -> NDArray[np.intp]:
    """Return pairs (n, 2) of scans of the same place and heading, 10 s or more apart, evenly spread over the run."""
    rows, pairs = spread(len(trajectory), PAIRS), [np.zeros((0, 2), np.intp)]
    band = max(1, _BLOCK // max(len(trajectory), 1))
    for first in range(0, len(rows), band):
        here = slice(first, first + band)
        pairs.append(_partners(trajectory, rows[here], _fractions(len(rows))[here]))
    candidates = np.concatenate(pairs)
    return candidates[spread(len(candidates), PAIRS)]


def _partners(trajectory: Trajectory, rows: NDArray[np.intp], fractions: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return pairs (n, 2) of rows with up to ``PARTNERS`` of their revisits, chosen by the fractions (rows,)."""
    t, (x, y, yaw) = trajectory.stamps_ns, trajectory.xyyaw.T
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = x - x[rows, None], y - y[rows, None]
    close = dx * dx + dy * dy < LONG_DISTANCE_M**2
    close &= c * c[rows, None] + s * s[rows, None] > np.cos(LONG_TURN_RAD)
    close &= np.abs(t - t[rows, None]) > LONG_GAP_NS
    at, near = np.nonzero(close)
    counts = np.bincount(at, minlength=len(rows))
    parts = (fractions[:, None] + np.arange(PARTNERS) / PARTNERS) % 1.0
    chosen = np.sort((parts * counts[:, None]).astype(np.intp), axis=1)
    fresh = (counts > 0)[:, None] & (np.diff(chosen, axis=1, prepend=-1) > 0)
    places = (np.cumsum(counts) - counts)[:, None] + chosen
    return np.column_stack((np.broadcast_to(rows[:, None], chosen.shape)[fresh], near[places[fresh]]))


def _fractions(n: int) -> NDArray[np.float64]:
    """Return a sequence that fills 0 to 1 evenly, (n,), for choices without random numbers."""
    return np.arange(n) * _GOLDEN % np.float64(1.0)


def _distances(scans: PlacedScans, trajectory: Trajectory, pairs: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the sums of `scan_distances` for the pairs of rows with enough points."""
    spec = scans.spec
    beams = used_beams(spec)
    points = np.count_nonzero((scans.ranges_m >= beams.near_m) & (scans.ranges_m <= beams.far_m), axis=1)
    order = np.argsort(scans.stamps_ns)
    there = np.searchsorted(scans.stamps_ns, trajectory.stamps_ns[pairs], sorter=order)
    numbers = order[np.minimum(there, len(order) - 1)]
    has_scans = (scans.stamps_ns[numbers] == trajectory.stamps_ns[pairs]).all(axis=1)
    enough = (points[numbers[:, 0]] > EVERY * (LEAST_POINTS - 1)) & (points[numbers[:, 1]] >= LEAST_TARGETS)
    return scan_distances(
        scans.ranges_m,
        scans.poses,
        np.ascontiguousarray(numbers[has_scans & enough], np.int64),
        spec.directions,
        np.array(beams),
        CAP_M,
        EVERY,
    )


def _mean_mm(counts: NDArray[np.float64], sums_m: NDArray[np.float64]) -> float:
    return float(sums_m.sum() / counts.sum()) / MM if counts.sum() else np.nan
