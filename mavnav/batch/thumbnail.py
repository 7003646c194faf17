"""Thumbnails of maps, a few kilobytes each."""

from __future__ import annotations

import io
from base64 import b64encode
from typing import TYPE_CHECKING, Final

import numpy as np
from PIL import Image

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

MAX_PIXELS: Final = 160
"""Maximum width and height of a thumbnail, in pixels; it is shown at half that size, for high-density screens."""

_UNKNOWN: Final = 205
"""Gray level of map_server for a cell that no beam has crossed."""

_SHADES: Final = {"wall": 24, "unknown": 232, "free": 255}


def thumbnail(directory: Path) -> str | None:
    """Return a small image of the map of a run as a data URI, cropped to the known cells; None without a map."""
    try:
        with Image.open(directory / "map.pgm") as image:
            cells = np.asarray(image)
    except (OSError, ValueError):  # the latter before pillow 13, for a file that is cut
        return None
    seen = _downsample(_crop(cells))
    shades = np.where(seen < _UNKNOWN, _SHADES["wall"], np.where(seen == _UNKNOWN, _SHADES["unknown"], _SHADES["free"]))
    buffer = io.BytesIO()
    Image.fromarray(shades.astype(np.uint8)).quantize(4).save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + b64encode(buffer.getvalue()).decode("ascii")


def _crop(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Crop the unknown borders."""
    known = cells != _UNKNOWN
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not rows.size:
        return cells[:1, :1]
    return cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _downsample(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Reduce squares of cells to one pixel with their minimum, so that a wall of one cell remains visible."""
    side = -(-max(cells.shape) // MAX_PIXELS)
    rows, columns = (-(-size // side) * side for size in cells.shape)
    padded = np.full((rows, columns), 255, dtype=np.uint8)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    blocks: NDArray[np.uint8] = padded.reshape(rows // side, side, columns // side, side).min(axis=(1, 3))
    return blocks
