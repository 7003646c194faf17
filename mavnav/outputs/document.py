"""The documents that machines read: run.json and metrics.json."""

from __future__ import annotations

import json
import platform
import sys
from dataclasses import asdict
from hashlib import sha256
from importlib.metadata import version
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav import __version__
from mavnav.outputs.run import base_frame
from mavnav.units import DEG, MM, NS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.metrics.wall_thickness import WallThickness
    from mavnav.outputs.run import Run

SCHEMA_VERSION: Final = 1
LIBRARIES: Final = ("numpy", "numba", "scipy", "mcap", "rosbags", "pillow", "pydantic", "pyyaml")

Document = dict[str, Any]


def run_document(run: Run, outputs: dict[str, str]) -> Document:
    """Describe a run; ``outputs`` maps the files written to their SHA-256. Times in s, lengths in m unless named."""
    return {
        "schema_version": SCHEMA_VERSION,
        "mavnav_version": __version__,
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in LIBRARIES},
        "input": _input(run),
        "config": run.config.document(),
        "method": run.config.method,
        "grid": str(run.config.grid),
        "azimuth": run.config.azimuth,
        **({} if run.mission is None else {"scenario": run.mission.scenario}),
        **metrics(run),
        "timing": _timing(run),
        "damage": [asdict(d) for d in run.log.damage],
        "warnings": [*run.log.warnings, *run.slam.warnings],
        "outputs": outputs,
        "partial": run.stopped is not None,
        "exit_code": int(run.exit_code),
    }


def _version(library: str) -> str:
    """Return a library's version: where it is loaded its own word, which is quicker than the package's papers."""
    return str(getattr(sys.modules.get(library), "__version__", None) or version(library))


def metrics(run: Run) -> Document:
    """Return the part that depends on log, configuration and version alone: no clock, no machine."""
    return {
        "scans": _scans(run),
        "cleaning": dict(run.log.cleaning),
        "tracking": _tracking(run),
        "loop_closure": _loop_closure(run),
        **({} if run.localisation is None else {"localisation": run.localisation}),
        "search": _search(run),
        "wall_thickness": {str(k): thickness_document(t) for k, t in run.thickness.items()},
        "map_quality": None if run.quality is None else asdict(run.quality),
        **({} if run.reference is None else {"reference": run.reference}),
        "map": _map(run),
        **({} if run.mission is None else {"mission": run.mission.mission, "truth": run.mission.truth}),
    }


def write_metrics(run: Run, path: Path) -> None:
    """Write metrics.json."""
    path.write_text(to_json({"schema_version": SCHEMA_VERSION, **metrics(run)}), encoding="utf-8")


def to_json(document: Document) -> str:
    """Write as JSON; numbers that JSON has no word for (NaN, infinities) become null."""
    return json.dumps(plain(document), indent=2, allow_nan=False) + "\n"


def plain(value: Any) -> Any:  # noqa: ANN401  any JSON value
    """Bring numpy's numbers and numbers that JSON lacks to plain ones."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    return None if isinstance(value, float) and not isfinite(value) else value


def _input(run: Run) -> Document:
    log = run.log
    odometry = log.odometry
    mounting = log.base_T_laser
    return {
        **_file(run),
        "topic": log.topic,
        "frame_id": log.frame_id,
        "stamp_source": log.stamp_source,
        "first_stamp_s": log.first_ns * NS,
        "duration_s": (log.last_ns - log.first_ns) * NS,
        "base_frame": log.base_frame,
        "base_T_laser": None if mounting is None else mounting._asdict(),
        "mounting_source": log.mounting_source,
        "odometry": None if odometry is None else {"topic": odometry.topic, "source": odometry.source},
    }


def _file(run: Run) -> Document:
    """Name what the user named: a log, or the scenario that the recorded mission follows from."""
    if run.mission is None:
        log = run.log
        path = run.address or str(log.path)
        return {"path": path, "sha256": log.sha256, "size_bytes": log.size_bytes, "format": log.format}
    content = run.mission.path.read_bytes()
    return {
        "path": str(run.mission.path),
        "sha256": sha256(content).hexdigest(),
        "size_bytes": len(content),
        "format": "scenario",
    }


def _scans(run: Run) -> Document:
    steps, counts = run.slam.steps, run.log.counts
    tracked = len(run.slam.trajectory)
    return {
        "total": counts.total,
        "usable": counts.usable,
        "processed": len(steps),
        "tracked": tracked,
        "accepted": tracked,
        "rejected": len(steps) - tracked,
        "skipped": dict(counts.skipped),
        "suspect": counts.suspect,
    }


def _tracking(run: Run) -> Document:
    """Say where the track was lost: seconds from the first scan's stamp; ``lost`` means for good."""
    slam, first_ns = run.slam, run.log.first_ns
    return {
        "lost": slam.lost_for_good,
        "intervals": [
            {
                "start_s": (i.start_ns - first_ns) * NS,
                "end_s": (i.end_ns - first_ns) * NS,
                "scans": i.scans,
                "recovered": i.recovered,
            }
            for i in slam.lost
        ],
        "tracked_share": slam.tracked_share,
        "opinions": slam.tracks_compared,
        "path_length_m": slam.trajectory.length_m,
        "frames": {"trajectory.tum": ["map", run.log.frame_id]}
        | ({} if run.log.base_T_laser is None else {"trajectory_base.tum": ["map", base_frame(run)]}),
    }


def _loop_closure(run: Run) -> Document:
    """Tell the closed loops: both scans, seconds from the first scan's stamp, what the later one was off by."""
    slam, first_ns = run.slam, run.log.first_ns
    scans = slam.steps.column("index")[slam.steps.column("tracked")].tolist()
    stamps_ns = slam.trajectory.stamps_ns
    return {
        "closures": [
            {
                "from_scan": scans[loop.start],
                "to_scan": scans[loop.end],
                "from_s": (int(stamps_ns[loop.start]) - first_ns) * NS,
                "to_s": (int(stamps_ns[loop.end]) - first_ns) * NS,
                "correction_m": loop.correction.distance_m,
                "correction_deg": loop.correction.yaw_rad / DEG,
                "inliers": loop.inliers,
            }
            for loop in slam.loops.closed
        ],
        "rejected": slam.loops.refused,
        "corrected": slam.loops.map_T_laser is not None,
    }


def _search(run: Run) -> Document:
    steps = run.slam.steps
    costs_m2 = steps.column("cost_m2")
    return {
        "evaluations_per_scan": _spread(steps.column("evaluations")),
        "iterations_per_scan": _spread(steps.column("iterations")),
        "converged_share": steps.share("converged"),
        "cost_m2": _spread(costs_m2[np.isfinite(costs_m2)]),
        "beams_used": _spread(steps.column("beams_used")),
        "inliers": _spread(steps.column("inliers")),
    }


def _spread(values: NDArray[Any]) -> Document:
    if not len(values):
        return {"mean": None, "median": None, "min": None, "max": None}
    low, high = values.min().item(), values.max().item()
    return {"mean": np.mean(values), "median": np.median(values), "min": low, "max": high}


def thickness_document(thickness: WallThickness) -> Document:
    """Describe the wall thickness at one threshold."""
    return {k: v for k, v in asdict(thickness).items() if k != "hits"}


def _map(run: Run) -> Document:
    grid = run.known
    rows, cols = grid.hits.shape
    return {
        "cell_mm": grid.cell_m / MM,
        "rows": rows,
        "cols": cols,
        "cells": int(np.count_nonzero(grid.hits)),
        "hits": int(grid.hits.sum(dtype=np.int64)),
        "size_m": [cols * grid.cell_m, rows * grid.cell_m],
        "origin_xy_m": list(grid.origin_xy_m),
        "accepted_share": run.slam.tracked_share,
    }


def _timing(run: Run) -> Document:
    """Say what the run took; the rates leave out the compilation, which a second run does not pay."""
    t, scans = run.timing, len(run.slam.steps)
    duration_s = (run.log.last_ns - run.log.first_ns) * NS
    work_s = max(t.wall_s, 1e-9)
    return {
        **asdict(t),
        "stages": dict(t.stages),
        "scans_per_s": scans / work_s,
        "realtime_factor": duration_s / work_s,
    }
