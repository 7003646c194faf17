"""A remedy for a track that is lost or doubtful: track the log once more, with finer voxels.

One wrong match bends all later poses, and other points rarely lead to the same wrong match. The resampled track of the
doubt decides between the two tracks: agreement of finer and coarser voxels is unlikely to be chance.
"""

from __future__ import annotations

from collections import deque
from math import nan
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from mavnav.pose import Pose
from mavnav.slam.doubt.features import FEATURES, WINDOWS_S, WRONG_M, WRONG_RAD
from mavnav.slam.doubt.judge import LEAST_SHARE
from mavnav.slam.findings import NOT_PLANAR, SECOND_MOTION, Remedy
from mavnav.slam.matching.steps import lost_intervals
from mavnav.slam.recovery.parts import lost_for_good, parts_of
from mavnav.slam.retries import beam_order, odometry_check
from mavnav.slam.retries.beginning import accepted, with_good_beginning
from mavnav.slam.retries.resampled_track import has_sparse_scans
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from mavnav.slam.matching.steps import Step
    from mavnav.slam.track import Pass, Track, Until

FINER, FINER_VOXELS = 3 / 4, "finer voxels"

INHERENT = (NOT_PLANAR, FEATURES["weakly_constrained"].reason, SECOND_MOTION)
"""Reasons for doubt that another track of the same scans cannot remove."""

MOST_DOUBT = 0.25
"""Largest doubt with which a remedy is used."""

MOST_DISAGREEMENT = 5.0
"""Largest difference from the resampled track over 10 s, in 0.2 m or 5 deg: alone it makes the doubt too high."""

MORE_MISSED = 64
"""Number of scans that the other track may miss more than the first one up to the same scan.

Scans after the last pose of the first track do not count: the other one must come farther. The whole map is searched at
16 and 64 lost scans.
"""

KEPT_WARNINGS = (odometry_check.WARNING, odometry_check.JITTER_WARNING, beam_order.WARNING)
"""Beginnings of warnings about the input that are kept: the remedy does not check it again."""


def with_remedy(track: Track, start: Track, recovered: Pass, judged: Pass) -> Track:
    """Track a log once more with finer voxels if its track is lost or doubtful; keep the better one.

    ``start`` has the settings of the run. ``recovered`` looks for the lost scans of a track, ``judged`` corrects and
    judges it. Both are left out where the other track cannot be better any more; it then has no doubt (NaN).
    """
    if track.doubt is None or not is_worth_a_remedy(track):
        return track
    other = finer_track(track, start)
    if len(other.steps) == len(track.steps):
        other = recovered(other)
        other = judged(other) if can_replace(other, track) else other
    doubt_after = other.doubt.probability if other.doubt else nan
    remedy = Remedy(FINER_VOXELS, track.doubt.probability, doubt_after, used=doubt_after <= MOST_DOUBT)
    return replace(other if remedy.used else track, on_step=track.on_step, remedies=(remedy,))


def is_worth_a_remedy(track: Track) -> bool:
    """Return whether a track is lost for good or doubtful, for a reason that another track can remove.

    Where scans are sparse, finer voxels do not give more points, and coarser ones have been compared already.
    """
    inherent = track.doubt and track.doubt.reasons[:1] and track.doubt.reasons[0].name in INHERENT
    hopeless = track.steps.share("tracked") < LEAST_SHARE  # other points do not help
    if inherent or hopeless or has_sparse_scans(track.steps):
        return False
    return is_lost(track) or bool(track.doubt and track.doubt.high)


def finer_track(track: Track, start: Track) -> Track:
    """Track a log with finer voxels; the track ends where it cannot replace the first one any more."""
    on_step, enough = track.on_step, until_missed(missed_so_far(track.steps.column("tracked")))
    other = replace(
        start,
        log_scans=track.log_scans,
        config=start.config.with_voxels(FINER),
        motion=track.motion,
        on_step=on_step and (lambda _, done: on_step("track again", done)),
        warnings=tuple(text for text in track.warnings if text.startswith(KEPT_WARNINGS)),
        odometry_contradicts=track.odometry_contradicts,
        resampled=track.resampled,
    )
    return with_good_beginning(other, lambda steps: enough(until_disagreeing(steps, track.resampled)))


def missed_so_far(tracked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return how many scans have no pose up to each scan (n,), without those after the last one with a pose."""
    found = np.flatnonzero(tracked)
    before_the_last = found[-1] + 1 - len(found) if len(found) else 0
    return np.minimum(np.cumsum(~tracked), before_the_last)


def until_missed(by_first: NDArray[np.int64]) -> Until:
    """Return what ends the tracks of a log from several beginnings when they have missed too many scans in all.

    That is ``MORE_MISSED`` scans more than the first track had missed by then, (n,), or than they have poses: a track
    of fewer than half of the scans is lost.
    """
    missed = found = 0

    def until(steps: Iterable[Step]) -> Iterator[Step]:
        nonlocal missed, found
        begun = False
        for step in steps:
            yield step
            begun, found = begun or step.tracked, found + step.tracked
            missed += begun and not step.tracked
            if missed > min(by_first[step.index], found) + MORE_MISSED:
                return

    return until


def until_disagreeing(steps: Iterable[Step], resampled: NDArray[np.float64]) -> Iterator[Step]:
    """Yield the steps of a track until its motion differs too much from that of the resampled poses (n, 3).

    ``resampled`` is NaN for scans without a pose there, and empty without a resampled track.
    """
    recent: deque[tuple[int, Pose, Pose]] = deque()
    for step in steps:
        yield step
        if not step.tracked or not len(resampled) or np.isnan(resampled[step.index, 0]):
            continue
        here, there = step.match.map_T_laser, Pose(*resampled[step.index].tolist())
        recent.append((step.stamp_ns, here, there))
        while (step.stamp_ns - recent[0][0]) * NS > max(WINDOWS_S):
            recent.popleft()
        _, then, then_there = recent[0]
        off_m, off_rad = then.between(here).gap(then_there.between(there))
        if max(off_m / WRONG_M, off_rad / WRONG_RAD) > MOST_DISAGREEMENT:
            return


def can_replace(other: Track, track: Track) -> bool:
    """Return whether another track of a log has as many scans as the first one, and is not lost for good."""
    return not is_lost(other) and accepted(other) >= accepted(track)


def is_lost(track: Track) -> bool:
    """Return whether the log of a track is lost for good."""
    return lost_for_good(track.steps, list(lost_intervals(track.steps)), parts_of(track))
