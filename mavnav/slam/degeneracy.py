"""Degenerate geometry: where motion along the walls in sight is not observable without odometry (docs/method.md).

Along a plain corridor, before a single wall and in a round room every scan fits as well a little farther on: cost,
inliers and the figures of the map are then as good as ever (Zhang, Kaess and Singh 2016, "On degeneracy of
optimization-based state estimation problems").
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.steps import LOST_SCANS
from mavnav.units import NS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.slam.steps import Steps

LEAST_OBSERVABILITY = 0.01
"""Below this ``kernels.observability`` a scan may slide: 0.033 at the least on the recordings, 0.002 or less in
plain corridors, before a wall and in round rooms."""

UNMEASURED = 1.0
"""The observability of a scan without a pose."""


def degeneracy_warning(steps: Steps, observed: NDArray[np.float64], *, contradicted: bool = False) -> str:
    """Return a warning where so many scans in a row could slide; ``observed`` (n,) are those of the steps, in order.

    Empty where none do. ``contradicted``: the log has odometry that is not used.
    """
    padded = np.concatenate(([False], observed < LEAST_OBSERVABILITY, [False])).astype(np.int8)
    starts, ends = (np.flatnonzero(np.diff(padded) == turn) for turn in (1, -1))
    long = ends - starts >= LOST_SCANS
    if not long.any():
        return ""
    stamps_ns, starts, ends = steps.column("stamp_ns"), starts[long], ends[long]
    from_s, to_s = (float(stamps_ns[k] - stamps_ns[0]) * NS for k in (starts[0], ends[0] - 1))
    share = 100.0 * float((ends - starts).sum()) / len(steps)
    when = f"from {from_s:.1f} to {to_s:.1f} s" + (f", and {len(starts) - 1} more" if len(starts) > 1 else "")
    advice = "correct the odometry" if contradicted else "record odometry"
    return (
        f"the walls that {share:.0f} % of the scans see leave a direction open ({when}): the path "
        f"may be too short, too long or turned there; {advice}, or see whether map.png is true"
    )
