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
    -7.57,
    {
        "slip": 1.26,
        "weakly_constrained": 2.17,
        "weak_with_odometry": 1.49,
        "sparse_sampling": 1.13,
        "symmetric_place": 0.72,
        "not_planar": 1.01,
        "few_points": 0.94,
        "gap": 0.1,
        "unclosed_loop": 0.45,
        "odometry_contradicts": 0.1,
    },
)
"""Of a track alone."""

TWO_TRACKS: Final = Weights(
    -8.34,
    {
        "tracks_disagree": 1.47,
        "slip": 0.73,
        "weakly_constrained": 1.94,
        "weak_with_odometry": 0.92,
        "sparse_sampling": 0.99,
        "symmetric_place": 0.1,
        "not_planar": 1.15,
        "few_points": 0.88,
        "gap": 0.21,
        "unclosed_loop": 0.11,
        "odometry_contradicts": 0.1,
    },
)
"""Of a track that was compared with a resampled one."""
