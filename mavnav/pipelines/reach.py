"""How far returns are used: beyond the default where most of a log's returns are."""

from __future__ import annotations

from itertools import islice
from typing import Final

import numpy as np
from msgspec.structs import replace

from mavnav.config.models import Config, RobustConfig
from mavnav.logs import Log
from mavnav.logs.preprocessing import FARTHEST_M
from mavnav.units import MM

LOOKED_AT: Final = 200
"""Number of scans that are looked at."""

MOST_BEYOND: Final = 0.5
"""Share of the returns beyond the default from which the laser's own limit takes its place."""


def with_reach(config: Config, log: Log) -> tuple[Config, tuple[str, ...]]:
    """Return a configuration that uses the returns of a log, and a warning if it is another.

    A ``robust.far_mm`` that is not the default stays.
    """
    far_m = config.robust.far_m
    limit_m = min(log.sensor.range_max_m, FARTHEST_M)
    if config.method != "robust" or config.robust.far_mm != RobustConfig().far_mm or limit_m <= far_m:
        return config, ()
    ranges_m = np.concatenate([scan.ranges_m for scan in islice(log.scans(), LOOKED_AT)])
    returns_m = ranges_m[np.isfinite(ranges_m)]
    beyond = np.count_nonzero(returns_m >= far_m) / max(len(returns_m), 1)
    if beyond <= MOST_BEYOND:
        return config, ()
    text = f"{100 * beyond:.0f} % of the returns are farther than {far_m:g} m; returns up to {limit_m:g} m are used"
    reaching = replace(config, robust=replace(config.robust, far_mm=limit_m / MM))
    return reaching, (f"{text}: set robust.far_mm to choose another limit",)
