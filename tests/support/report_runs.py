"""Run directories as far as a page is drawn from them, made from a run in memory."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from mavnav.mapping.occupancy_grid import Grid
from mavnav.outputs.files import gridmap, replay_log
from mavnav.outputs.files.document import run_document, to_json
from mavnav.outputs.files.gridmap import write_npz
from mavnav.outputs.files.trajectory import write_csv
from mavnav.outputs.report.page import single


def leave(run, folder: Path, *, recording: bool = False, **changes) -> dict:
    """Write what the page reads of a run, some of run.json changed, and return the cell of a comparison."""
    folder.mkdir(parents=True)
    write_npz(run, folder / "hits.npz")
    write_csv(run, folder / "trajectory.csv")
    gridmap.write_walls(run, folder / gridmap.WALLS_FILE)
    if recording:
        replay_log.write(run, folder / "result.mcap")
    document = json.loads(to_json(run_document(run, {}))) | changes
    (folder / "run.json").write_text(json.dumps(document))
    return single(document, folder.name)["cells"][0]


def doubled(run):
    """Return the run with a second wall of 1.2 m planted 20 cells beside nothing."""
    grid = run.slam.grid
    hits = grid.hits.copy()
    row, col = np.array(hits.shape) // 2
    hits[row : row + 2, col : col + 60] = 9
    return replace(run, slam=replace(run.slam, grid=Grid(grid.cell_m, grid.origin_xy_m, hits, grid.passes)))


def quality(*, meaningful=True, ghosts=0.0):
    place = {"x_m": 1.0, "y_m": 2.0, "direction_deg": 30.0, "length_m": ghosts, "offset_mm": 80.0}
    walls = {"count": int(ghosts > 0), "length_m": ghosts, "places": [place] if ghosts else []}
    return {
        "profile": "map-quality/2",
        "meaningful": meaningful,
        "why": [] if meaningful else ["2 % of the scans"],
        "ghost_walls": walls,
        "support": {"wall_m": 20.0, "sections": 900, "mapped_share": 0.85},
    }
