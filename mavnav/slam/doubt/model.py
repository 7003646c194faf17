"""How doubtful a track is, and why: a logistic model over features, with coefficients fitted by benchmarks/doubt.py."""

from __future__ import annotations

from math import exp, log2
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.doubt.coefficients import ONE_TRACK, TWO_TRACKS
from mavnav.slam.doubt.features import DISAGREEMENT, FEATURES
from mavnav.slam.doubt.record import Doubt, Reason
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from mavnav.slam.doubt.evidence import Evidence

LEAST, MOST_DOUBLINGS = 0.25, 5.0
"""Features below the first count nothing; above, each doubling counts the same, up to so many."""

MUCH = 1.0
"""From this value on a feature that counts is a reason."""

JOINED_S, MOST_STRETCHES = 2.0, 5
"""Scans that show a reason at most so far apart are one stretch; of a reason the strongest stretches are reported."""


def doubt_of(evidence: Evidence, tried: tuple[str, ...] = ()) -> Doubt:
    """Judge a track by its evidence."""
    shown = {name: feature.of(evidence) for name, feature in FEATURES.items()}
    values = {name: feature.total(shown[name]) for name, feature in FEATURES.items()}
    log_odds = contributions(values)
    strongest = sorted(log_odds, key=lambda name: -log_odds[name])
    reasons: list[Reason] = []
    for name in strongest:
        if log_odds[name] > 0.0 and values[name] >= MUCH:
            reasons += stretches(FEATURES[name].reason, shown[name], evidence.stamps_ns)
    return Doubt(probability(values), tuple(reasons), tried)


def contributions(values: Mapping[str, float]) -> dict[str, float]:
    """Return what each feature adds to the log-odds; a comparison of tracks counts where there was one."""
    _, weights = TWO_TRACKS if np.isfinite(values[DISAGREEMENT]) else ONE_TRACK
    return {name: weight * doublings(values[name]) for name, weight in weights.items()}


def probability(values: Mapping[str, float]) -> float:
    """Return the probability that a track of these features is wrong; it grows with each of them."""
    bias, _ = TWO_TRACKS if np.isfinite(values[DISAGREEMENT]) else ONE_TRACK
    return 1.0 / (1.0 + exp(-bias - sum(contributions(values).values())))


def doublings(value: float) -> float:
    """Count how often a feature doubles from where it begins to count."""
    return min(log2(max(value, LEAST) / LEAST), MOST_DOUBLINGS)


def stretches(name: str, shown: NDArray[np.float64], stamps_ns: NDArray[np.int64]) -> list[Reason]:
    """Return where scans show much of a feature (n,), in the order of time."""
    rows = np.flatnonzero(shown >= MUCH)
    parts = np.split(rows, np.flatnonzero(np.diff(stamps_ns[rows]) * NS > JOINED_S) + 1)
    found = [Reason(name, int(stamps_ns[p[0]]), int(stamps_ns[p[-1]]), float(shown[p].max())) for p in parts]
    return sorted(sorted(found, key=lambda r: -r.value)[:MOST_STRETCHES], key=lambda r: r.start_ns)
