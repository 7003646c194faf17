"""Relations: true motions between two times.

The benchmark of Kuemmerle et al. 2009 ("On measuring the accuracy of SLAM algorithms", Autonomous Robots 27). It needs
no common frame, and drift only affects relations that span it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from msgspec import Struct

from mavnav.metrics.fields import Measured, number
from mavnav.pose import between
from mavnav.units import DEG

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.pose import Trajectory

TOLERANCE_NS: Final = 100_000_000
"""Largest time between a relation and the nearest pose; farther away, the relation is missing."""

LOOP_NS: Final = 20_000_000_000
"""Time above which a relation is a loop; the others are sequential."""


class Relations(Struct, frozen=True):
    """``stamps_ns`` (n, 2): two times; ``xyyaw`` (n, 3): the second pose in the frame of the first, m, m, rad."""

    stamps_ns: NDArray[np.int64]
    xyyaw: NDArray[np.float64]


class RelationErrors(Struct, frozen=True):
    """Errors over the relations that have poses at both times; null without one."""

    relations: Annotated[int, number("relations given")]
    scored: Annotated[int, number("relations with poses at both times")]
    share: Annotated[Measured, number("part of the relations that is scored; a short trajectory misses some")]
    translation_mean_m: Annotated[Measured, number("mean error of the translation")]
    translation_std_m: Annotated[Measured, number("standard deviation of the translation's error")]
    rotation_mean_deg: Annotated[Measured, number("mean error of the rotation")]
    rotation_std_deg: Annotated[Measured, number("standard deviation of the rotation's error")]


def relation_errors(relations: Relations, trajectory: Trajectory) -> dict[str, RelationErrors]:
    """Return the errors of a trajectory of the laser: over ``all`` relations, ``sequential`` ones and ``loops``."""
    loop = np.abs(np.diff(relations.stamps_ns, axis=1)[:, 0]) > LOOP_NS
    kinds = {"all": np.full(len(loop), fill_value=True), "sequential": ~loop, "loops": loop}
    if not len(trajectory):
        return {name: _errors(np.zeros((0, 3)), int(kind.sum())) for name, kind in kinds.items()}
    rows, gaps_ns = _nearest(trajectory.stamps_ns, relations.stamps_ns)
    poses = trajectory.xyyaw
    error = between(relations.xyyaw, between(poses[rows[:, 0]], poses[rows[:, 1]]))
    scored = (gaps_ns < TOLERANCE_NS).all(axis=1)
    return {name: _errors(error[kind & scored], int(kind.sum())) for name, kind in kinds.items()}


def _nearest(stamps_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the nearest row to each wanted time, and the time between both, ns."""
    after = np.clip(np.searchsorted(stamps_ns, wanted_ns), 0, len(stamps_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(wanted_ns - stamps_ns[before]) <= np.abs(wanted_ns - stamps_ns[after])
    rows = np.where(nearer, before, after)
    return rows, np.abs(wanted_ns - stamps_ns[rows])


def _errors(error: NDArray[np.float64], relations: int) -> RelationErrors:
    n = len(error)
    length_m, turn_deg = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]) / DEG
    return RelationErrors(
        relations=relations,
        scored=n,
        share=n / relations if relations else np.nan,
        translation_mean_m=float(length_m.mean()) if n else np.nan,
        translation_std_m=float(length_m.std()) if n else np.nan,
        rotation_mean_deg=float(turn_deg.mean()) if n else np.nan,
        rotation_std_deg=float(turn_deg.std()) if n else np.nan,
    )
