"""Panels: small pictures of one size each, that a page lays out as it is wide, and a sheet of them for people to paste.

Text in a panel is sized for a panel some 300 to 600 pixels wide on a screen.
"""

from __future__ import annotations

import io
import warnings
from base64 import b64encode
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from PIL import Image

from mavnav.outputs import drawing

if TYPE_CHECKING:
    from collections.abc import Sequence

COLOURS: Final = 256
"""A picture of a palette is a third of one without; an octree of colours keeps the rare ones: ghosts and true walls."""

GAP_PIXELS: Final = 24
SHEET_PIXELS: Final = 2800
"""A sheet is not wider, unless a single panel is."""

FONT_PT: Final = 8.0


@dataclass(frozen=True, slots=True)
class Frame:
    """The room between the axes and the edges of a panel, in inches: for labels and the title."""

    left: float = 0.42
    right: float = 0.12
    bottom: float = 0.24
    top: float = 0.27


MAP_FRAME: Final = Frame()
CHART_FRAME: Final = Frame(left=0.56, bottom=0.42)


class Canvas:
    """The axes of a panel, ``width_in`` by ``height_in`` without its frame, and the picture of what is drawn on them.

    The place of the axes is given, not found out from the labels, so that all panels have one scale and are drawn in
    half the time.
    """

    def __init__(self, width_in: float, height_in: float, title: str, frame: Frame = MAP_FRAME) -> None:
        width, height = width_in + frame.left + frame.right, height_in + frame.bottom + frame.top
        self._fig = drawing.figure(width, height)
        self._fig.set_layout_engine("none")
        self.axes: Any = self._fig.add_axes(
            (frame.left / width, frame.bottom / height, width_in / width, height_in / height)
        )
        self.axes.set_title(title, fontsize=FONT_PT + 1.5, color=drawing.INK, loc="left", pad=5)
        self.axes.tick_params(colors=drawing.MUTED, labelsize=FONT_PT)

    def image(self) -> Image.Image:
        """Draw, and return the picture."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Glyph .* missing")
            self._fig.canvas.draw()
        return Image.fromarray(np.asarray(self._fig.canvas.buffer_rgba())).convert("RGB")


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
