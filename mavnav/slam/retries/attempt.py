"""Track a log again with one thing changed, and keep the better of the two tracks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mavnav.slam.track import Track


class Attempt(Struct, frozen=True):
    """Another track of the same log.

    ``change`` returns the track with its new settings and its warnings, None where the attempt does not apply.
    ``better`` returns whether the new track (first) is better than the old one; without it the new one is kept.
    """

    name: str
    change: Callable[[Track], Track | None]
    better: Callable[[Track, Track], bool] | None = None


def try_again(track: Track, attempts: Iterable[Attempt]) -> Track:
    """Make the attempts that apply, in order, each with the track kept so far; none counts if the run is stopped."""
    for attempt in attempts:
        changed = attempt.change(track)
        other = changed and changed.over(changed.log_scans(), "track again")
        if other is None or len(other.steps) < len(track.steps):
            continue
        kept = attempt.better is None or attempt.better(other, track)
        track = (other if kept else track).with_attempt(attempt.name, kept=kept)
    return track
