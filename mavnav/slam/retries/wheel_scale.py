"""The scale of wheels where walls show little along the motion: what matches ask for beside wheels, over a whole log.

A match that is fused with wheels follows them where it knows little, and its map with it: the scale of the path is
theirs. What each match asks for beyond its prediction is small, but of one sign. A track with the scale right shows
none of it; something that moves along with the laser does so at every scale.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from mavnav.slam.matching.steps import Steps
from mavnav.slam.retries.beginning import UNTIL_LOST
from mavnav.slam.retries.odometry import SCALES
from mavnav.slam.track import Track

FIRST_LONGER, LAST_LONGER = 0.05, 0.01
"""Share by which motions are longer than wheels say from which their scale is changed, and from which again."""

MOST_LEFT: Final = 0.04
"""Largest share that is left, in the typical stretch, too, where a scale explains all: 0.03 in made logs where it is
right, from 0.05 on where people or vehicles that move along were taken for walls."""

STRETCHES: Final = 20
"""Parts of a track that show how sure the share is: errors of scans in a row are alike."""

SURE, AGREEING = 3.0, 0.8
"""Standard deviations that their mean must have, else the part of them that must agree in sign with their median."""

STEP, MOST_STEP = 0.5, 0.3
"""Part of the share by which the scale is changed, as poses lag behind what matches ask for; more if that is too
little; its limit."""

MOST_TRACKS: Final = 6


def with_scaled_wheels(track: Track) -> Track:
    """Return a track with the scale of wheels at which matches ask for no other; the given one if there is none."""
    odometry, fit, longer = track.log_odometry, track.findings.odometry, longer_than_wheels(track.steps)
    if odometry is None or abs(longer.share) < FIRST_LONGER or longer.typical < MOST_LEFT:
        return track
    scaled, tried = track, {fit.distance_scale: longer.share}
    least, largest = (limit * fit.distance_scale for limit in SCALES)
    while len(tried) <= MOST_TRACKS and abs(longer.share) >= LAST_LONGER:
        scale = min(max(next_scale(tried), least), largest)
        if scale in tried:
            break
        fit = fit._replace(distance_scale=scale)
        other = track.with_odometry(odometry, fit).over(track.log_scans(), "track again", UNTIL_LOST)
        if len(other.steps) < len(track.steps):
            break
        scaled, longer = other, longer_than_wheels(other.steps)
        tried[scale] = longer.share
    kept = max(abs(longer.share), longer.typical) < MOST_LEFT
    return (scaled if kept else track).with_attempt("scaled wheels", kept=kept)


class Longer(NamedTuple):
    """By what share motions are longer than wheels say.

    ``share`` is the mean by information if a jackknife shows that it is sure, else the median of stretches, 0 where
    these do not agree: what moves along for a while decides neither. ``typical`` is the median of their sizes.
    """

    share: float = 0.0
    typical: float = 0.0


def longer_than_wheels(steps: Steps) -> Longer:
    """Return by what share the motions of a track are longer than wheels say; 0 if too few show it."""
    weights = steps.column("longer_weight") * steps.column("tracked")
    moving = weights > 0.0
    if np.count_nonzero(moving) < STRETCHES:
        return Longer()
    sums = np.array((steps.column("longer") * weights, weights))[:, moving]
    parts = np.array([part.sum(axis=1) for part in np.array_split(sums, STRETCHES, axis=1)])
    total = parts.sum(axis=0)
    mean, (shares, without) = total[0] / total[1], (some[:, 0] / some[:, 1] for some in (parts, total - parts))
    typical = float(np.median(np.abs(shares)))
    if abs(mean) >= SURE * np.sqrt((STRETCHES - 1) * without.var()):
        return Longer(float(mean), typical)
    agreeing = max(np.count_nonzero(shares > 0.0), np.count_nonzero(shares < 0.0))
    return Longer(float(np.median(shares)) if agreeing >= AGREEING * STRETCHES else 0.0, typical)


def next_scale(tried: dict[float, float]) -> float:
    """Return the scale to try after others with the shares that they show: between two of which one is too small.

    ``tried`` is in the order of the trials.
    """
    small = max((scale for scale, longer in tried.items() if longer > 0.0), default=None)
    large = min((scale for scale, longer in tried.items() if longer < 0.0), default=None)
    if small is not None and large is not None:
        more, less = tried[small], tried[large]
        return (more * large - less * small) / (more - less)
    scale, longer = next(reversed(tried.items()))
    return scale * (1.0 + float(np.clip(STEP * len(tried) * longer, -MOST_STEP, MOST_STEP)))
