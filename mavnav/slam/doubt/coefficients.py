"""The coefficients of doubt, as `python benchmarks/doubt.py fit` prints them (docs/method.md, "Doubt")."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping


class Weights(NamedTuple):
    """The log-odds of a track that shows nothing, and what each doubling of a feature adds."""

    bias: float
    weights: Mapping[str, float]


ONE_TRACK: Final = Weights(
    -4.28,
    {
        "slip": 0.1,
        "weakly_constrained": 1.52,
        "weak_with_odometry": 1.01,
        "sparse_sampling": 0.57,
        "symmetric_place": 0.59,
        "not_planar": 1.11,
        "few_points": 0.1,
        "gap": 0.16,
        "unclosed_loop": 0.92,
        "odometry_contradicts": 0.1,
    },
)
"""Of a track alone."""

TWO_TRACKS: Final = Weights(
    -5.6,
    {
        "tracks_disagree": 1.51,
        "slip": 0.13,
        "weakly_constrained": 1.41,
        "weak_with_odometry": 0.53,
        "sparse_sampling": 0.14,
        "symmetric_place": 0.1,
        "not_planar": 0.77,
        "few_points": 0.1,
        "gap": 0.8,
        "unclosed_loop": 0.59,
        "odometry_contradicts": 0.1,
    },
)
"""Of a track that was compared with a resampled one."""
