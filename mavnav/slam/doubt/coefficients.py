"""The coefficients of doubt, as printed by `python benchmarks/doubt.py fit` (docs/method.md, "Doubt")."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping


class Weights(NamedTuple):
    """The log-odds of a track with all features at their least, and the increase by each doubling of a feature."""

    bias: float
    weights: Mapping[str, float]


ONE_TRACK: Final = Weights(
    -6.25,
    {
        "slip": 0.99,
        "weakly_constrained": 2.01,
        "weak_with_odometry": 1.31,
        "sparse_sampling": 0.79,
        "symmetric_place": 0.9,
        "not_planar": 0.77,
        "few_points": 0.48,
        "gap": 0.1,
        "unclosed_loop": 0.62,
        "second_motion": 1.78,
        "placed_by_odometry": 3.12,
        "odometry_contradicts": 0.1,
    },
)
"""Weights without a second track. That of a second motion was fitted later (``fit --only``), and the others held.

That of a part placed by odometry follows from its meaning: it is wrong in half of the cases if the median error to be
expected is the bound for wrong.
"""

TWO_TRACKS: Final = Weights(
    -6.5,
    {
        "tracks_disagree": 1.32,
        "slip": 0.56,
        "weakly_constrained": 1.67,
        "weak_with_odometry": 0.73,
        "sparse_sampling": 0.66,
        "symmetric_place": 0.1,
        "not_planar": 0.66,
        "few_points": 0.14,
        "gap": 0.16,
        "unclosed_loop": 0.37,
        "second_motion": 1.81,
        "placed_by_odometry": 3.25,
        "odometry_contradicts": 0.1,
    },
)
"""Weights of a track that was compared with a resampled one."""
