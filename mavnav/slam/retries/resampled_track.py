"""A resampled track where scans are sparse: a wrong match in a sharp turn bends the map, and blurs it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from mavnav.slam.matching.steps import lost_intervals
from mavnav.slam.retries.attempt import Attempt

if TYPE_CHECKING:
    from mavnav.slam.matching.steps import Steps
    from mavnav.slam.track import Track

FEW_POINTS, SPARSE_SCANS = 80, 5
"""Number of points below which an accepted scan is sparse, and number of sparse scans from which a track is in doubt.

The pose in a turn then depends on a few walls.
"""

COARSER = 4 / 3
"""Factor on the voxel size of the second track: with other points, other matches are wrong."""


def coarsen_voxels(track: Track) -> Track | None:
    """Return a track with coarser voxels where scans are sparse."""
    if not track.builds_map or not has_sparse_scans(track.steps):
        return None
    return replace(track, config=track.config.with_voxels(COARSER))


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
