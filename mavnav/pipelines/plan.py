"""The pipeline of ``mavnav plan``: the map of a run or of a map file -> floor plan -> drawing and document."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mavnav.errors import UsageError
from mavnav.ground_truth.map_file import map_files
from mavnav.kernels.machine.building import prepare
from mavnav.metrics.floor_plan import floor_plan
from mavnav.outputs.directory import check_apart, check_file, write_file
from mavnav.outputs.pictures.vector_map import write_dxf, write_svg
from mavnav.pipelines.diff import read_grid, run_verdict_at
from mavnav.profiling import Progress
from mavnav.units import DEG
from mavnav.version import DOCUMENT_HEAD


def draw_plan(source: Path, target: Path, ratio: float, progress: Progress, *, force: bool) -> dict[str, Any]:
    """Draw the floor plan of a run directory or a map's YAML file at 1:``ratio``, and return the document.

    Raises UsageError for what is no map, where no straight wall is found, and OutputError.
    """
    suffix = target.suffix.lower()
    check_file(target, suffix if suffix in {".svg", ".dxf"} else ".svg", force=force)
    check_apart({"--output": target}, map_files(source))
    grid, map_T_grid = read_grid(source)
    prepare(progress)
    progress("finding walls", 0, None)
    plan = floor_plan(grid, map_T_grid)
    if not len(plan.walls):
        raise UsageError(f"{source}: the map has no straight wall; name a map with walls")
    write = write_dxf if suffix == ".dxf" else partial(write_svg, title=source.stem, ratio=ratio)
    write_file(target, lambda path: write(plan, path=path), force=force)
    size_m = np.ptp(plan.walls.reshape(-1, 2), axis=0)
    walls_m, openings_m = (np.hypot(*(lines[:, 2:] - lines[:, :2]).T) for lines in (plan.walls, plan.openings))
    return {
        **DOCUMENT_HEAD,
        "input": str(source),
        "output": str(target),
        "verdict": run_verdict_at(source),
        "yaw_deg": round(plan.plan_T_map.yaw_rad / DEG, 3),
        "size_m": size_m.round(3).tolist(),
        "wall_m": round(float(walls_m.sum()), 3),
        "walls": [_line(line, m) for line, m in zip(plan.walls, walls_m, strict=True)],
        "openings": [_line(line, m) for line, m in zip(plan.openings, openings_m, strict=True)],
    }


def _line(line: Any, length_m: float) -> dict[str, Any]:  # noqa: ANN401  a row of an array
    """Describe a line by its ends in the frame of the plan and its length, m."""
    ends_m = line.round(3).tolist()
    return {"from_m": ends_m[:2], "to_m": ends_m[2:], "length_m": round(float(length_m), 3)}
