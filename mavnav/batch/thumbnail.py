"""A map as a picture of a few kilobytes."""

from __future__ import annotations

import io
from base64 import b64encode
from typing import TYPE_CHECKING, Final

import numpy as np
from PIL import Image, UnidentifiedImageError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

MAX_PIXELS: Final = 160
"""A thumbnail is not longer; it is shown at half of that, for screens with twice the pixels."""

_UNKNOWN: Final = 205
"""What map_server writes for a cell that no beam has crossed."""

_SHADES: Final = {"wall": 24, "unknown": 232, "free": 255}


def thumbnail(directory: Path) -> str | None:
    """Return a small picture of the map of a run as a data URI, cut to what was seen; None where there is no map."""
    try:
        with Image.open(directory / "map.pgm") as image:
            cells = np.asarray(image)
    except (OSError, UnidentifiedImageError):
        return None
    seen = _downsampled(_cropped(cells))
    shades = np.where(seen < _UNKNOWN, _SHADES["wall"], np.where(seen == _UNKNOWN, _SHADES["unknown"], _SHADES["free"]))
    buffer = io.BytesIO()
    Image.fromarray(shades.astype(np.uint8)).quantize(4).save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + b64encode(buffer.getvalue()).decode("ascii")


def _cropped(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Leave away the edges that nothing is known of."""
    known = cells != _UNKNOWN
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not rows.size:
        return cells[:1, :1]
    return cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _downsampled(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Let every pixel stand for a square of cells and show its darkest: a wall of one cell stays a line."""
    side = -(-max(cells.shape) // MAX_PIXELS)
    rows, columns = (-(-size // side) * side for size in cells.shape)
    padded = np.full((rows, columns), 255, dtype=np.uint8)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    blocks: NDArray[np.uint8] = padded.reshape(rows // side, side, columns // side, side).min(axis=(1, 3))
    return blocks
