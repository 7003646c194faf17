"""Judging a finished track: cheap features first, and a second track where they raise doubt."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mavnav.profiling import timed
from mavnav.slam.doubt.evidence import evidence_of, resampled_poses
from mavnav.slam.doubt.model import doubt_of

if TYPE_CHECKING:
    from mavnav.slam.methods.method import Refiner
    from mavnav.slam.track import Track

WORTH_A_TRACK = 0.1
"""Minimum probability with which the log is tracked once more."""

LEAST_SHARE = 0.2
"""Minimum share of scans with a pose of a track that is worth another one: with fewer the log is lost in any case."""

FEWEST = 2
"""Minimum number of tracked scans of a track that is judged."""

RESAMPLED = "resampled track"


def judge_track(track: Track, refiner: Refiner) -> Track:
    """Add the probability that a track is wrong; not in causal mode, in a given map, or if nothing was tracked."""
    if not refiner.builds_map or len(track.findings.observed) < len(track.steps):
        return track
    if track.steps.column("tracked").sum() < FEWEST:
        return track
    return judge_by_features(track, refiner)


@timed("doubt")
def judge_by_features(track: Track, refiner: Refiner) -> Track:
    """Judge a track by its features; compare it with a resampled track if these raise doubt."""
    evidence = evidence_of(track, refiner)
    doubt = doubt_of(evidence)
    worthwhile = doubt.probability >= WORTH_A_TRACK and track.steps.share("tracked") >= LEAST_SHARE
    resampled = resampled_poses(track) if worthwhile else None
    if resampled is not None:
        doubt = doubt_of(replace(evidence, resampled=resampled), (RESAMPLED,))
    return track.with_findings(doubt=doubt)
