"""Panels: small pictures of one size, which a page arranges by its width, and sheets of them as files.

Text in a panel is sized for a panel some 300 to 600 pixels wide on a screen.
"""

from __future__ import annotations

import io
from base64 import b64encode
from typing import TYPE_CHECKING, Final

from PIL import Image

from mavnav.outputs.canvas import Canvas
from mavnav.outputs.plot import Axes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.outputs.canvas import Box

COLOURS: Final = 256
"""A picture of a palette is a third of one without; an octree of colours keeps the rare ones: ghosts and true walls."""

GAP_PIXELS: Final = 24
SHEET_PIXELS: Final = 2800
"""A sheet is not wider, unless a single panel is."""

FONT_PT: Final = 8.0


MAP_MARGINS: Final = (63, 40, 18, 36)
CHART_MARGINS: Final = (94, 40, 18, 63)
"""Left, top, right and bottom of the axes in a panel, in pixels."""
CHART: Final = (600, 255)
"""Width and height of a chart without its margins."""


def panel(size: tuple[int, int], title: str, margins: Box = MAP_MARGINS) -> tuple[Canvas, Box]:
    """Begin a panel; return it with the box of its axes, of a size given without the margins.

    The place of the axes does not depend on their labels, so that all panels have one scale.
    """
    (width, height), (left, top, right, bottom) = size, margins
    canvas = Canvas.of(left + width + right, top + height + bottom)
    canvas.text((left, top - 11), title, FONT_PT + 1.5, anchor="ls")
    return canvas, (left, top, left + width, top + height)


def chart(title: str, limits: tuple[float, float, float, float], names: tuple[str, str], name_left: int) -> Axes:
    """Begin a panel with a chart: limits of x and y, what they are with its unit, and how far left the name of y is."""
    axes = Axes.chart(*panel(CHART, title, CHART_MARGINS), limits)
    axes.names(*names, FONT_PT, name_left)
    return axes


def sheet(panels: Sequence[Image.Image], columns: int | None = None) -> Image.Image:
    """Lay panels in rows on white, as many as fit, or ``columns`` of them."""
    width, height = (max(p.size[k] for p in panels) + GAP_PIXELS for k in (0, 1))
    per_row = columns or max(1, SHEET_PIXELS // width)
    per_row = min(per_row, len(panels))
    rows = -(-len(panels) // per_row)
    paper = Image.new("RGB", (per_row * width, rows * height), "white")
    for k, panel in enumerate(panels):
        paper.paste(panel, (k % per_row * width + GAP_PIXELS // 2, k // per_row * height + GAP_PIXELS // 2))
    return paper


def stacked(sheets: Sequence[Image.Image]) -> Image.Image:
    """Lay pictures below one another."""
    paper = Image.new("RGB", (max(s.width for s in sheets), sum(s.height for s in sheets)), "white")
    top = 0
    for one in sheets:
        paper.paste(one, (0, top))
        top += one.height
    return paper


def png(image: Image.Image) -> bytes:
    """Return the bytes of a PNG of `COLOURS` colours."""
    held = io.BytesIO()
    image.quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
        held, format="PNG", optimize=True
    )
    return held.getvalue()


def data_uri(image: Image.Image, most_bytes: int) -> str:
    """Return the picture as a data URI, made smaller until it has at most ``most_bytes`` (or is a thumbnail)."""
    content = png(image)
    while len(content) > most_bytes and min(image.size) > 64:
        image = image.resize((image.width * 3 // 4, image.height * 3 // 4), Image.Resampling.LANCZOS)
        content = png(image)
    return "data:image/png;base64," + b64encode(content).decode("ascii")
