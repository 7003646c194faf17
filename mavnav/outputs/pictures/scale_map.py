"""map_scale.png and map_scale.yaml: the map in map_server's scale mode, how often each cell stopped a beam."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from PIL import Image

from mavnav.mapping.occupancy_grid import OCCUPIED_SHARE
from mavnav.mapping.tiled_arrays import bands
from mavnav.outputs.files.gridmap import yaml_text

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.outputs.run import RunResult

PICTURE: Final = "map_scale.png"
FREE_SHARE: Final = 0.002
"""Below one step of the 255 shades: a cell that no beam ended in is free."""

HALF_A_SHADE: Final = 0.5 / 255.0


def write(run: RunResult, path: Path) -> None:
    """Write the picture or its description, by the name of the file.

    A pixel is darker the larger the share of the beams that ended in the cell, of those that reached it; black for all.
    Unknown cells are transparent, as map_server has it. From `OCCUPIED_SHARE` on a cell is occupied, as in map.pgm.
    """
    if path.suffix == ".yaml":
        path.write_text(_description(run), encoding="ascii")
        return
    hits, pixels = run.known.hits, np.empty((*run.known.hits.shape, 2), np.uint8)
    for _, _, band in bands(hits.shape):
        seen = hits[band].astype(np.float64) + run.known.passes[band]
        share = hits[band] / np.maximum(seen, 1.0)
        pixels[band] = np.dstack((np.round(255.0 * (1.0 - share)), np.where(seen > 0, 255, 0)))
    Image.fromarray(pixels[::-1]).save(path, format="PNG")


def _description(run: RunResult) -> str:
    """Return map.yaml's text with another picture, mode and thresholds."""
    changed = {
        "image": PICTURE,
        "mode": "scale",
        "occupied_thresh": f"{OCCUPIED_SHARE - HALF_A_SHADE:.4f}",
        "free_thresh": f"{FREE_SHARE}",
    }
    lines = [line.partition(":") for line in yaml_text(run).splitlines()]
    return "".join(f"{key}: {changed.get(key, value.strip())}\n" for key, _, value in lines)
