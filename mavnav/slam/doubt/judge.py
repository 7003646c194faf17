"""Judging a finished track: cheap features first, and a second track where they raise doubt."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mavnav.profiling import timed
from mavnav.slam.doubt.evidence import evidence_of, with_resampled_track
from mavnav.slam.doubt.model import doubt_of

if TYPE_CHECKING:
    from mavnav.slam.method import Refiner
    from mavnav.slam.track import Track

WORTH_A_TRACK = 0.1
"""From this probability on the log is tracked once more."""

FEWEST = 2
"""A track of fewer scans shows nothing."""

RESAMPLED = "resampled track"


def judge_track(track: Track) -> Track:
    """Give a track its probability to be wrong; not on line, in a known map, nor where nothing was tracked."""
    refiner = track.refiner
    if refiner is None or not refiner.builds_map or len(track.observed) < len(track.steps):
        return track
    if track.steps.column("tracked").sum() < FEWEST:
        return track
    return judged(track, refiner)


@timed("doubt")
def judged(track: Track, refiner: Refiner) -> Track:
    """Judge by the features of the track, and compare it with another one where that is worth it."""
    evidence = evidence_of(track, refiner)
    doubt = doubt_of(evidence)
    if not len(track.resampled) and doubt.probability >= WORTH_A_TRACK:
        track = with_resampled_track(track)
    if len(track.resampled):
        resampled = track.resampled[track.steps.column("tracked")]
        doubt = doubt_of(replace(evidence, resampled=resampled), (RESAMPLED,))
    return replace(track, doubt=doubt)
