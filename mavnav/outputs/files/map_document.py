"""The part of run.json that every map has, also that of a merge."""

from __future__ import annotations

import platform
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.metrics.wall_spread import wall_report
from mavnav.outputs.documents import run_json as model
from mavnav.units import MM
from mavnav.version import __version__, installed_version

if TYPE_CHECKING:
    from mavnav.config.models import Config
    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.metrics.map_quality import MeasuredMap

SCHEMA_VERSION: Final = 1
LIBRARIES: Final = ("numpy", "numba", "scipy", "mcap", "rosbags", "pillow", "msgspec", "pyyaml")


@cache
def versions() -> dict[str, str]:
    """Return the version of each library."""
    return {name: installed_version(name) for name in LIBRARIES}


def map_section(grid: Grid, accepted_share: float) -> model.Map:
    """Describe the known part of a map, which has the scans of a share of 0 to 1."""
    rows, cols = grid.hits.shape
    return model.Map(
        cell_mm=grid.cell_m / MM,
        rows=rows,
        cols=cols,
        cells=int(np.count_nonzero(grid.hits)),
        hits=int(grid.hits.sum(dtype=np.int64)),
        size_m=[cols * grid.cell_m, rows * grid.cell_m],
        origin_xy_m=list(grid.origin_xy_m),
        accepted_share=accepted_share,
    )


def map_document(grid: Grid, measured: MeasuredMap, config: Config, accepted_share: float) -> dict[str, Any]:
    """Return the keys of run.json for a map alone, whoever made it: what it was made with, and how good it is."""
    return {
        "schema_version": SCHEMA_VERSION,
        "mavnav_version": __version__,
        "python": platform.python_version(),
        "libraries": versions(),
        "config": config,
        "method": config.method,
        "grid": str(config.grid),
        "azimuth": config.azimuth,
        "wall_thickness": wall_report(measured.sections, measured.published, measured.cuts, grid.cell_m),
        "map_quality": measured.quality,
        "map": map_section(grid, accepted_share),
        "partial": False,
    }
