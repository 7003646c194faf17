"""Doubt of a finished track and its reasons: a logistic model over features, and a second track where it is worthwhile.

The coefficients are from benchmarks/doubt.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from math import exp, log2

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.profiling import as_stage
from mavnav.slam.doubt.features import (
    DISAGREEMENT,
    FEATURES,
    ONE_TRACK,
    TWO_TRACKS,
    TrackEvidence,
    Weights,
    evidence_of,
    resampled_poses,
)
from mavnav.slam.findings import Doubt, Reason
from mavnav.slam.matching.steps import Steps
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.methods.robust import Robust
from mavnav.slam.refinement.refine import refine_poses
from mavnav.slam.track import Track
from mavnav.units import NS

Limits = tuple[float, float]
"""Probabilities between which the log is tracked once more."""

UNDECIDED: Limits = (0.1, 0.8)
"""Outside of these limits a second track hardly ever changes the verdict."""

ALWAYS: Limits = (0.0, 1.0)
UNASKED: Limits = (1.0, 0.0)

LEAST_SHARE = 0.2
"""Minimum share of scans with a pose of a track that is worth another one: with fewer the log is lost in any case."""

FEWEST = 2
"""Minimum number of tracked scans of a track that is judged."""

RESAMPLED = "resampled track"


def judge_track(track: Track, refiner: Refiner) -> Track:
    """Add the probability that a track is wrong; not in a given map, or if nothing was tracked."""
    return judge(track, refiner, UNDECIDED) if refiner.builds_map else track


def judge_flown(track: Track, refiner: Refiner) -> Track:
    """Add that probability to the track of a mission, which is always compared with another one.

    Its commands, which the prediction follows, tell nothing of where the vehicle is; so nothing else contradicts it.
    """
    return judge(track, refiner, ALWAYS)


def judge_redrawn(track: Track) -> Track:
    """Judge a track that no pass may change by its own map, or by one of its scans at their poses.

    Such are a causal track, one in a given map, and that of another method, which is always compared with a track of
    the default one.
    """
    default, method = track.config.method == "robust", track.method
    drawn = (
        deepcopy(method)
        if isinstance(method, Robust) and method.builds_map
        else redraw(track, recorded=track.refiner is not None)
    )
    limits, gaps = UNDECIDED if default else ALWAYS, track.prior_map is None
    judged = judge(match_again(track, drawn), drawn, limits, gaps=gaps)
    return track.with_findings(doubt=judged.findings.doubt)


def redraw(track: Track, *, recorded: bool) -> Robust:
    """Return the default method with a new map, of the scans of a track at their poses.

    These are of the scans as ``recorded``, else of the laser at mid-sweep.
    """
    drawn = Robust(replace(track.config, method="robust"))
    for step, scan, motion in track.placed_scans("doubt"):
        sweep_T_mid = drawn.sweep_T_mid(scan, motion) if recorded else Pose()
        drawn.insert(scan, step.match.map_T_laser @ sweep_T_mid, motion)
    return drawn


def match_again(track: Track, drawn: Robust) -> Track:
    """Return a track of the default method, every scan matched against a map, from which dynamic cells are removed."""
    drawn.remove_dynamic_cells()
    config, motion = replace(track.config, method="robust", final_pass=True), track.motion._replace(expects_rest=False)
    alone = replace(track, config=config, method=drawn, motion=motion, steps=Steps(track.steps), prior_map=None)
    return refine_poses(alone, drawn)


@as_stage("doubt")
def judge(track: Track, refiner: Refiner, limits: Limits, *, gaps: bool = True) -> Track:
    """Judge a track by its features; compare it with a resampled track if its doubt is within ``limits``.

    In a given map, where a lost laser is found in all of it, ``gaps`` are no reason.
    """
    if len(track.findings.observed) < len(track.steps) or track.steps.column("tracked").sum() < FEWEST:
        return track
    evidence = evidence_of(track, refiner, gaps=gaps)
    doubt = doubt_of(evidence)
    worthwhile = limits[0] <= doubt.probability <= limits[1] and track.steps.share("tracked") >= LEAST_SHARE
    resampled = resampled_poses(track) if worthwhile else None
    if resampled is not None:
        doubt = doubt_of(replace(evidence, resampled=resampled), (RESAMPLED,))
    return track.with_findings(doubt=doubt)


LEAST, MOST_DOUBLINGS = 0.25, 6.0
"""Value from which a feature counts, and maximum number of its doublings that count."""

MUCH = 1.0
"""Minimum value of a feature that is reported as a reason."""

JOINED_S, MOST_STRETCHES = 2.0, 5
"""Longest time between scans of one stretch, and maximum number of stretches of a reason, the strongest ones."""


def doubt_of(evidence: TrackEvidence, tried: tuple[str, ...] = ()) -> Doubt:
    """Return the doubt of a track, and its reasons with the largest contribution first.

    ``tried`` names what was done because of the doubt.
    """
    shown = {name: feature.of(evidence) for name, feature in FEATURES.items()}
    values = {name: feature.total(shown[name]) for name, feature in FEATURES.items()}
    log_odds = contributions(values)
    reasons: list[Reason] = []
    for name in sorted(log_odds, key=lambda name: -log_odds[name]):
        if log_odds[name] > 0.0 and values[name] >= MUCH:
            reasons += stretches(FEATURES[name].reason, shown[name], evidence.stamps_ns)
    return Doubt(probability(values), tuple(reasons), tried)


def contributions(values: Mapping[str, float], one: Weights = ONE_TRACK, two: Weights = TWO_TRACKS) -> dict[str, float]:
    """Return the contribution of each feature to the log-odds; the weights differ with and without a second track."""
    _, weights = two if np.isfinite(values[DISAGREEMENT]) else one
    return {name: weight * doublings(values[name]) for name, weight in weights.items()}


def probability(values: Mapping[str, float], one: Weights = ONE_TRACK, two: Weights = TWO_TRACKS) -> float:
    """Return the probability that a track with these features is wrong; it increases with each of them."""
    bias, _ = two if np.isfinite(values[DISAGREEMENT]) else one
    return 1.0 / (1.0 + exp(-bias - sum(contributions(values, one, two).values())))


def doublings(value: float) -> float:
    """Return how often a feature doubles above ``LEAST``."""
    return min(log2(max(value, LEAST) / LEAST), MOST_DOUBLINGS)


def stretches(name: str, shown: NDArray[np.float64], stamps_ns: NDArray[np.int64]) -> list[Reason]:
    """Return the stretches in which a feature (n,) is a reason, in order of time."""
    rows = np.flatnonzero(shown >= MUCH)
    parts = np.split(rows, np.flatnonzero(np.diff(stamps_ns[rows]) * NS > JOINED_S) + 1)
    reasons = [Reason(name, int(stamps_ns[p[0]]), int(stamps_ns[p[-1]]), float(shown[p].max())) for p in parts]
    return sorted(sorted(reasons, key=lambda r: -r.value)[:MOST_STRETCHES], key=lambda r: r.start_ns)
