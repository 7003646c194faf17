"""Degenerate geometry: where motion along the visible walls is not observable without odometry (docs/method.md).

Along a plain corridor, before a single wall and in a round room a shifted or turned pose fits a scan equally well.
Cost, inliers and map metrics do not show it (Zhang, Kaess and Singh 2016, "On degeneracy of optimization-based state
estimation problems").
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.matching.steps import LOST_SCANS
from mavnav.units import NS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.slam.matching.steps import Steps

LEAST_OBSERVABILITY = 0.01
"""Minimum ``kernels.observability`` of a constrained scan.

It is at least 0.033 on the recordings, and at most 0.002 in plain corridors, before a wall and in round rooms.
"""

UNMEASURED = 1.0
"""Observability that stands for a scan without a pose."""


def degeneracy_warning(steps: Steps, observed: NDArray[np.float64], *, contradicted: bool = False) -> str:
    """Return a warning if ``LOST_SCANS`` or more successive scans are degenerate, else an empty string.

    ``observed`` (n,) is the observability of the steps. ``contradicted``: the log has odometry that is not used.
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
        f"degenerate geometry in {share:.0f} % of the scans ({when}): motion in one direction is not observable, "
        f"and the path may be too short, too long or turned there; {advice}, or check map.png"
    )
