"""Track a log again with one thing changed, and keep the better of the two tracks; with coarser voxels if sparse.

Where scans are sparse, a wrong match in a sharp turn bends the map, and blurs it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.slam.matching.steps import Steps, lost_intervals
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
    useless: list[Attempt] = []  # of this track
    for attempt in attempts:
        changed = None if attempt in useless else attempt.change(track)
        useless = [*useless, attempt] if changed is None else []
        other = changed and changed.over(changed.log_scans(), "track again")
        if other is None or len(other.steps) < len(track.steps):
            continue
        kept = attempt.better is None or attempt.better(other, track)
        refused_steps = None if kept else other.steps
        track = (other if kept else track).with_attempt(attempt.name, kept=kept, refused_steps=refused_steps)
    return track


FEW_POINTS, SPARSE_SCANS = 80, 5
"""Number of points below which an accepted scan is sparse, and number of sparse scans from which a track is in doubt.

The pose in a turn then depends on a few walls.
"""

COARSER = 4 / 3
"""Factor on the voxel size of the second track: with other points, other matches are wrong."""


def coarsen_voxels(track: Track) -> Track | None:
    """Return a track with coarser voxels where scans are sparse."""
    sparse = track.builds_map and has_sparse_scans(track.steps)
    return replace(track, config=track.config.with_voxels(COARSER)) if sparse else None


def is_sharper(other: Track, track: Track) -> bool:
    """Return whether another track has the better rank."""
    return rank(other) < rank(track)


COARSER_VOXELS: Final = Attempt("coarser voxels", coarsen_voxels, is_sharper)


def has_sparse_scans(steps: Steps) -> bool:
    """Return whether ``SPARSE_SCANS`` or more accepted scans of a track have few points."""
    few = steps.column("beams_used") < FEW_POINTS
    return int(np.count_nonzero(few & steps.column("tracked"))) >= SPARSE_SCANS


def rank(track: Track) -> tuple[int, int]:
    """Return the rank of a track, the lesser the better: scans lost, jumps included, then hit cells of its map."""
    lost = sum(max(1, interval.scans) for interval in lost_intervals(track.steps))
    return lost, int(np.count_nonzero(track.method.grid.hits))
