"""A resampled track where scans are sparse: one slip in a sharp turn bends the whole map, a sharper map shows it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.steps import lost_intervals

if TYPE_CHECKING:
    from mavnav.config.models import Config
    from mavnav.slam.steps import Steps
    from mavnav.slam.track import Track

FEW_POINTS, SPARSE_SCANS = 80, 5
"""With so many scans accepted on fewer points a track is in doubt: a turn rests on a few walls then."""

COARSER = 4 / 3
"""Voxels of the second track: other points, and so other slips."""


def with_coarser_voxels(track: Track) -> Track:
    """Track again with coarser voxels where scans are sparse; keep the sharper of the two maps."""
    if track.refiner is None or not track.refiner.builds_map or not in_doubt(track.steps):
        return track
    other = track.again(replace(track, config=coarser(track.config)))
    if other is None:
        return track
    return replace(other if blur(other) < blur(track) else track, tracks_compared=2)


def in_doubt(steps: Steps) -> bool:
    """Return whether some accepted scans of a track have few points."""
    few = steps.column("beams_used") < FEW_POINTS
    return int(np.count_nonzero(few & steps.column("tracked"))) >= SPARSE_SCANS


def coarser(config: Config) -> Config:
    """Return the configuration of the second track."""
    robust = replace(config.robust, voxel_mm=COARSER * config.robust.voxel_mm)
    return replace(config, robust=robust)


def blur(track: Track) -> tuple[int, int]:
    """Rank a track, the better one first: scans lost, jumps included, then cells of its map that were hit."""
    lost = sum(max(1, interval.scans) for interval in lost_intervals(track.steps))
    return lost, int(np.count_nonzero(track.method.grid.hits))
