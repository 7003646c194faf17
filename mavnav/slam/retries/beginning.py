"""The beginning of the map: a later one if the first scans do not fit those that follow.

A partial sweep while the laser spins up, a blocked laser or a fast turn can make a map that no later scan matches.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Final

import numpy as np
from msgspec.structs import replace

from mavnav.slam.matching.budget import DOUBTFUL_SCANS, LONG_LOST_SCANS
from mavnav.slam.matching.steps import LOST_SCANS, Step, Steps
from mavnav.slam.retries.odometry import while_odometry_fits
from mavnav.slam.track import Track, Until

EARLY_SCANS = 30
"""Largest number of scans of a map that is given up.

It is given up if ``LONG_LOST_SCANS`` usable ones in a row do not match it, ``DOUBTFUL_SCANS`` after a later beginning.
"""

MOST_TRIES = 8
"""Maximum number of beginnings that are tried; their least distance doubles each time, to 255 scans in all."""

LATER_BEGINNING: Final = "later beginning"

LEAST_TRACKED_SHARE = 0.5
"""Share of the scans that must have a pose: else the log is lost, and its beginning not taken at once."""


def track_from_good_beginning(track: Track) -> Track:
    """Track the log, from a later scan on if the next scans do not match the map of the first ones.

    A beginning with poses for most of the scans after it is taken at once; otherwise that with most poses when its map
    was given up is tracked to the end.
    """
    refiner, least_points = track.method.refiner, track.config.robust.min_points
    if refiner is None or not refiner.builds_map:
        return while_odometry_fits(track)

    def until(most_missed: int) -> Until:
        return partial(until_missing, least_points=least_points, most_missed=most_missed)

    first = best = while_odometry_fits(track, "track", until(LONG_LOST_SCANS))
    begin = early_loss(first.steps, least_points)
    if begin is None:
        return first
    for tried in range(MOST_TRIES):
        other = while_odometry_fits(replace(track, begin=begin), "track again", until(DOUBTFUL_SCANS))
        lost = early_loss(other.steps, least_points)
        enough = max(LEAST_TRACKED_SHARE * (len(other.steps) - begin), count_accepted(first) + 1)
        whole = lost is None and count_accepted(other) >= enough
        best = other if whole or count_accepted(other) > count_accepted(best) else best
        if lost is None:
            break
        begin = max(lost, begin + (1 << tried))
    if early_loss(best.steps, least_points) is not None:
        best = while_odometry_fits(best, "track again")
    return after_another(best, first).with_attempt(LATER_BEGINNING, kept=best.begin > 0)


def after_another(track: Track, first: Track) -> Track:
    """Return a track with the scans that a first track has before its beginning as a separate part."""
    before = tuple(step for step in first.steps[: track.begin] if step.tracked)
    return track.with_findings(parts=(before,) if before else ())


def count_accepted(track: Track) -> int:
    """Return the number of scans with a pose."""
    return int(np.count_nonzero(track.steps.column("tracked")))


def early_loss(steps: Steps, least_points: int) -> int | None:
    """Return the first of the scans at the end of a track that do not match a map of few scans; None if it is kept.

    Scans of fewer than ``least_points`` points do not count.
    """
    held = np.flatnonzero(steps.column("tracked"))
    if not 0 < len(held) <= EARLY_SCANS:
        return None
    missed = held[-1] + 1 + np.flatnonzero(steps.column("beams_used")[held[-1] + 1 :] >= least_points)
    return int(missed[0]) if len(missed) >= LOST_SCANS else None


def until_missing(
    steps: Iterable[Step], least_points: int, most_missed: int = LONG_LOST_SCANS, most_held: float = EARLY_SCANS
) -> Iterator[Step]:
    """Yield the steps of a track until ``most_missed`` usable scans in a row do not match its map.

    Only a map of at most ``most_held`` scans ends the track.
    """
    held, missed = 0, 0
    for step in steps:
        yield step
        if step.tracked:
            held, missed = held + 1, 0
        elif held and step.match.beams_used >= least_points:
            missed += 1
        if held <= most_held and missed >= most_missed:
            return


UNTIL_LOST: Final = partial(until_missing, least_points=0, most_missed=LOST_SCANS, most_held=np.inf)
"""What ends a track that is compared with another one: where it is lost it shows nothing, and takes long."""
