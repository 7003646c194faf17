"""Factors to SI, the largest coordinate, and counts in texts.

``250 * MM`` is 0.25 m; only configuration and reports are in mm and deg.
"""

from math import pi
from typing import Final

MM: Final = 1e-3
MM2: Final = 1e-6
DEG: Final = pi / 180.0
MS: Final = 1e-3
NS: Final = 1e-9

LARGEST_COORDINATE_M: Final = 1e8
"""Largest coordinate of a pose or a map: map coordinates of the whole earth, m; kernels cannot count cells beyond."""


def pluralize(count: int, noun: str) -> str:
    """Return a count with its noun, which takes an s or es unless there is one."""
    ending = "" if count == 1 else "es" if noun.endswith("ch") else "s"
    return f"{count} {noun}{ending}"
