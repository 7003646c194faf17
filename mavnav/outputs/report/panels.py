"""Panels: small pictures of equal size, which a page arranges by its width, and sheets of panels as files.

The text of a panel is sized for a width of 300 to 600 pixels on a screen.
"""

from __future__ import annotations

import io
from base64 import b64encode
from typing import TYPE_CHECKING, Final

from PIL import Image

from mavnav.outputs.pictures.canvas import Canvas

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.outputs.pictures.canvas import Box

COLOURS: Final = 256
"""Number of colors of a PNG file: a palette reduces its size to a third, and the octree method keeps rare colors, those
of ghost walls and true walls.
"""

DENSITY: Final = 2
"""Pictures of a page have twice the pixels of their size on the screen, for screens of that density."""

GAP_PIXELS: Final = 24 * DENSITY
SHEET_PIXELS: Final = 2800 * DENSITY
"""Maximum width of a sheet in pixels, unless a single panel is wider."""

FONT_PT: Final = 8.0


MAP_MARGINS: Final = (90, 40, 18, 63)
CHART_MARGINS: Final = (94, 40, 18, 63)
"""Left, top, right and bottom of the axes in a panel, in pixels."""
CHART: Final = (600, 255)
"""Width and height of a chart without its margins."""


def panel(size: tuple[int, int], title: str, margins: Box = MAP_MARGINS) -> tuple[Canvas, Box]:
    """Return a new panel and the box of its axes, for a size without the margins.

    The position of the axes does not depend on their labels, so that all panels have the same scale.
    """
    (width, height), (left, top, right, bottom) = size, margins
    canvas = Canvas.of(left + width + right, top + height + bottom, DENSITY)
    canvas.text((left, top - 11), title, FONT_PT + 1.5, anchor="ls")
    return canvas, (left, top, left + width, top + height)


def sheet(panels: Sequence[Image.Image], columns: int | None = None) -> Image.Image:
    """Return an image of panels in rows on white, with ``columns`` panels per row, by default as many as fit."""
    width, height = (max(p.size[k] for p in panels) + GAP_PIXELS for k in (0, 1))
    per_row = min(columns or max(1, SHEET_PIXELS // width), len(panels))
    rows = -(-len(panels) // per_row)
    canvas = Image.new("RGB", (per_row * width, rows * height), "white")
    for k, panel in enumerate(panels):
        canvas.paste(panel, (k % per_row * width + GAP_PIXELS // 2, k // per_row * height + GAP_PIXELS // 2))
    return canvas


def stack(sheets: Sequence[Image.Image]) -> Image.Image:
    """Return an image of pictures below one another."""
    canvas = Image.new("RGB", (max(s.width for s in sheets), sum(s.height for s in sheets)), "white")
    top = 0
    for one in sheets:
        canvas.paste(one, (0, top))
        top += one.height
    return canvas


def png(image: Image.Image) -> bytes:
    """Return the bytes of a PNG file with `COLOURS` colors, those of every second row and column: lines are wider."""
    sample = image.resize([max(side // 2, 1) for side in image.size], Image.Resampling.NEAREST)
    palette = sample.quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    image.quantize(palette=palette, dither=Image.Dither.NONE).save(buffer, format="PNG", compress_level=4)
    return buffer.getvalue()


def data_uri(image: Image.Image, max_bytes: int) -> str:
    """Return the picture as a data URI, scaled down until it has at most ``max_bytes`` or a side of 64 pixels."""
    content = png(image)
    while len(content) > max_bytes and min(image.size) > 64:
        image = image.resize((image.width * 3 // 4, image.height * 3 // 4), Image.Resampling.LANCZOS)
        content = png(image)
    return "data:image/png;base64," + b64encode(content).decode("ascii")
