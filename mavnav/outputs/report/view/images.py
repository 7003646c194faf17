"""The pictures of a map for the interactive page: laser hits, free space, slices by height; a pixel is a cell."""

from __future__ import annotations

import re
from math import ceil, sqrt
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from PIL import Image

from mavnav.mapping.occupancy_grid import FREE, known_area, occupancy
from mavnav.mapping.tiled_arrays import max_pool
from mavnav.outputs.pictures.canvas import rgb_of
from mavnav.outputs.pictures.map_axes import HIT_COLOURS
from mavnav.outputs.pictures.slices_picture import height_colours
from mavnav.outputs.report.entry import file_in
from mavnav.outputs.report.view.packing import palette_png

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid

MAX_PIXELS: Final = 4_000_000
"""Maximum size of a picture; cells of a larger map are pooled, as few as that takes."""

_PLACED: Final = re.compile(r"resolution: (\S+)\norigin: \[(\S+), (\S+), ")
"""Cell and origin in a description of a map that `mavnav.outputs.files.gridmap` wrote."""

SHADES: Final = 32
FREE_COLOUR: Final = "#dde5ee"


def map_images(grid: Grid, top_hits: float, max_pixels: int = MAX_PIXELS) -> list[dict[str, Any]]:
    """Return free space and laser hits of a map, the hits on a logarithmic scale from 1 to ``top_hits``."""
    known = known_area(grid)
    factor = max(1, ceil(sqrt(known.hits.size / max_pixels)))
    free = max_pool(occupancy(known), factor, value_of=lambda cells: (cells == FREE).astype(np.uint8))
    hits = _shades(max_pool(known.hits, factor), top_hits)
    box = _box(known.origin_xy_m, hits.shape, known.cell_m * factor)
    picked = HIT_COLOURS[np.linspace(0, len(HIT_COLOURS) - 1, SHADES).astype(np.intp)]
    return [
        {"id": "free", "title": "Free space", "box": box, "src": _png(free, np.array([rgb_of(FREE_COLOUR)], np.uint8))},
        {"id": "hits", "title": "Laser hits", "box": box, "src": _png(hits, picked)},
    ]


def slice_images(folder: Path, slices: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the occupied cells of the maps by height that a run directory has, each in the color of its height."""
    colours = height_colours(max(len(slices), 2))
    return [_slice_image(folder, layer, colour[None]) for layer, colour in zip(slices, colours, strict=False)]


def _slice_image(folder: Path, layer: dict[str, Any], colour: NDArray[np.uint8]) -> dict[str, Any]:
    path = file_in(folder, layer["map"])
    cell_m, x_m, y_m = map(float, _PLACED.findall(path.read_text(encoding="ascii"))[0])
    with Image.open(path.with_suffix(".pgm"), formats=("PPM",)) as picture:
        occupied = (np.asarray(picture) == 0).astype(np.uint8)[::-1]
    box = _box((x_m, y_m), occupied.shape, cell_m)
    title = f"Slice {layer['from_m']:z.2f} to {layer['to_m']:z.2f} m"
    key = f"#{bytes(colour[0]).hex()}"
    return {"id": layer["map"], "title": title, "box": box, "src": _png(occupied, colour), "colour": key}


def _shades(hits: NDArray[Any], top_hits: float) -> NDArray[np.uint8]:
    """Return the shade of each cell, 1 to `SHADES`, 0 for cells without a hit."""
    share = np.log(np.maximum(hits, 1), dtype=np.float32) / np.float32(np.log(top_hits))
    return np.where(hits > 0, 1 + np.minimum(share * SHADES, SHADES - 1).astype(np.uint8), 0).astype(np.uint8)


def _png(pixels: NDArray[np.uint8], colours: NDArray[np.uint8]) -> str:
    """Draw cells (rows, cols), row 0 at the minimum y, in ``colours`` (n, 3), of which pixel 1 is the first."""
    return palette_png(pixels[::-1], np.vstack((np.zeros((1, 3), np.uint8), colours)))


def _box(origin_xy_m: Sequence[float], shape: tuple[int, ...], cell_m: float) -> list[float]:
    """Return minimum x and y, and maximum x and y of a picture, m."""
    (x_m, y_m), (rows, cols) = origin_xy_m, shape
    return [round(float(value), 6) for value in (x_m, y_m, x_m + cols * cell_m, y_m + rows * cell_m)]
