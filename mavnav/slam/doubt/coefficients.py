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
    -7.91,
    {
        "slip": 0.93,
        "weakly_constrained": 2.34,
        "weak_with_odometry": 1.55,
        "sparse_sampling": 1.45,
        "symmetric_place": 0.7,
        "not_planar": 1.62,
        "few_points": 0.1,
        "gap": 0.1,
        "unclosed_loop": 0.61,
        "odometry_contradicts": 0.1,
    },
)
"""Of a track alone."""

TWO_TRACKS: Final = Weights(
    -8.7,
    {
        "tracks_disagree": 1.23,
        "slip": 0.72,
        "weakly_constrained": 2.21,
        "weak_with_odometry": 1.13,
        "sparse_sampling": 1.31,
        "symmetric_place": 0.1,
        "not_planar": 1.64,
        "few_points": 0.1,
        "gap": 0.34,
        "unclosed_loop": 0.28,
        "odometry_contradicts": 0.1,
    },
)
"""Of a track that was compared with a resampled one."""
