"""The document of a run of nothing: it has the names that every run.json has, before there is one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mavnav.logs import Log, ScanCounts
from mavnav.mapping.occupancy_grid import Grid
from mavnav.metrics.journey import Journey
from mavnav.metrics.map_quality import map_quality
from mavnav.metrics.wall_thickness import sections_by_hits
from mavnav.outputs.document import plain, run_document
from mavnav.outputs.run import Run, Timing
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec
from mavnav.slam.result import SlamResult
from mavnav.slam.steps import Steps

if TYPE_CHECKING:
    from mavnav.config.models import Config


def blank_document(config: Config) -> dict[str, Any]:
    """Return run.json as a log without scans would leave it: numbers are 0 or null, and lists are empty."""
    grid, way = Grid(1.0), Trajectory.of([], [])
    sections = sections_by_hits(grid.hits, grid.cell_m)
    run = Run(
        log=_blank_log(),
        config=config,
        slam=SlamResult(Steps(), way, grid, ()),
        sections=sections,
        timing=Timing(0.0, 0.0, 0.0),
        quality=map_quality(grid, Journey(way, lambda: iter(()), 0.0), sections=sections),
    )
    document: dict[str, Any] = plain(run_document(run, {}))
    return document


def _blank_log() -> Log:
    return Log(
        path=Path(),
        format="",
        size_bytes=0,
        sha256="",
        topics=(),
        topic="",
        frame_id="",
        sensor=LaserSpec(0.0, 0.0, 0, 0.0, 0.0),
        counts=ScanCounts(0, 0, {}),
        cleaning={},
        first_ns=0,
        last_ns=0,
        period_s=0.0,
        gaps=(),
        stamp_source="header",
        window_s=(None, None),
        base_T_laser=None,
        mounting_source=None,
        base_frame=None,
        upside_down=False,
        odometry=None,
        damage=(),
        warnings=(),
        strict=False,
        _order=np.empty(0, np.int64),
        _stamps_ns=np.empty(0, np.int64),
    )
