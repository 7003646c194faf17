"""A remedy for a track that is lost or doubtful: track the whole log once more, with finer voxels.

One wrong match bends all later poses, and other points rarely lead to the same wrong match. The resampled track of the
doubt decides between the two tracks: agreement of finer and coarser voxels is unlikely to be chance.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mavnav.slam import beam_order, odometry_check
from mavnav.slam.beginning import accepted
from mavnav.slam.doubt.features import FEATURES
from mavnav.slam.doubt.record import NOT_PLANAR, Remedy
from mavnav.slam.parts import lost_for_good, parts_of
from mavnav.slam.steps import lost_intervals

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.slam.track import Track

FINER, FINER_VOXELS = 3 / 4, "finer voxels"

INHERENT = (NOT_PLANAR, FEATURES["weakly_constrained"].reason)
"""Reasons for doubt that another track of the same scans cannot remove."""

MOST_DOUBT = 0.25
"""Largest doubt with which a remedy is used."""

KEPT_WARNINGS = (odometry_check.WARNING, beam_order.WARNING)
"""Warnings about the input that are kept: the remedy does not check it again."""


def with_remedy(track: Track, start: Track, whole: Callable[[Track], Track]) -> Track:
    """Track a log from its ``start`` on with finer voxels if the track is lost or doubtful; keep the better one.

    ``whole`` makes all passes up to the judgement. If the run is stopped early, the first track stays.
    """
    if track.doubt is None or not is_worth_a_remedy(track):
        return track
    on_step = track.on_step
    other = whole(
        replace(
            start,
            log_scans=track.log_scans,
            config=start.config.with_voxels(FINER),
            motion=track.motion,
            on_step=on_step and (lambda _, done: on_step("track again", done)),
            warnings=tuple(text for text in track.warnings if text in KEPT_WARNINGS),
            odometry_contradicts=track.odometry_contradicts,
            resampled=track.resampled,
        )
    )
    if other.doubt is None or len(other.steps) < len(track.steps):
        return track
    used = not is_lost(other) and other.doubt.probability <= MOST_DOUBT and accepted(other) >= accepted(track)
    remedy = Remedy(FINER_VOXELS, track.doubt.probability, other.doubt.probability, used)
    return replace(other if used else track, on_step=on_step, remedies=(remedy,))


def is_worth_a_remedy(track: Track) -> bool:
    """Return whether a track is lost for good or doubtful, for a reason that another track can remove."""
    inherent = track.doubt and track.doubt.reasons[:1] and track.doubt.reasons[0].name in INHERENT
    return not inherent and (is_lost(track) or bool(track.doubt and track.doubt.high))


def is_lost(track: Track) -> bool:
    """Return whether the log of a track is lost for good."""
    return lost_for_good(track.steps, list(lost_intervals(track.steps)), parts_of(track))
