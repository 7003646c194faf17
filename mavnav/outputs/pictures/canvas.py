"""Pictures in pixels: text, and lines with smooth edges, on a white canvas; PNG bytes that repeat.

Some 30 ms a picture, where matplotlib takes 0.4 s to import alone: every replay makes two.
Lengths without a unit are pixels, y downwards; ``_pt`` are points of 1/72 inch at `DPI`.
"""

from __future__ import annotations

from functools import cache
from math import ceil, floor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct
from PIL import Image, ImageDraw, ImageFont

from mavnav.outputs.pictures.viewport import DPI, INK

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    Box = tuple[int, int, int, int]
    """Left, top, right and bottom."""
    Points = list[tuple[float, float]]

FONTS: Final = Path(__file__).parent / "fonts"
SMOOTH: Final = 2
"""Lines are drawn on a mask so many times as large, which is then reduced: so their edges are smooth."""
POINT: Final = DPI / 72.0  # pixels

COMPRESSION: Final = 3
"""Level of zlib for PNG: 6 takes a third longer for files that are a fifth smaller."""


def rgb_of(colour: str) -> tuple[int, int, int]:
    """Read ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def ramp(colours: Iterable[str], n: int = 256) -> NDArray[np.uint8]:
    """Blend colours into a colour scale, (n, 3)."""
    anchors = np.array([rgb_of(c) for c in colours], float)
    at = np.linspace(0.0, len(anchors) - 1.0, n)
    blended = [np.interp(at, np.arange(len(anchors)), part) for part in anchors.T]
    return np.column_stack(blended).round().astype(np.uint8)


@cache
def font(size_pt: float, *, bold: bool = False) -> Any:  # noqa: ANN401
    """Load DejaVu Sans, which has the mathematical signs."""
    file = FONTS / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
    return ImageFont.truetype(str(file), round(size_pt * POINT), layout_engine=ImageFont.Layout.BASIC)


class Canvas(Struct, frozen=True):
    """A white picture to draw on.

    ``draw`` is Pillow's drawing on it, without smoothing: for horizontal and vertical lines, and areas.
    """

    image: Image.Image
    draw: Any

    @classmethod
    def of(cls, width: int, height: int) -> Canvas:
        """Begin a picture."""
        image = Image.new("RGB", (width, height), "white")
        return cls(image, ImageDraw.Draw(image))

    def text(
        self, xy: tuple[float, float], text: str, size_pt: float = 8.0, colour: str = INK, anchor: str = "mm",
        *, bold: bool = False, upright: bool = False,
    ) -> None:  # fmt: skip
        """Write; ``anchor`` as Pillow's. Text that stands ``upright`` reads from below, about its middle."""
        face, side = font(size_pt, bold=bold), "left" if anchor[0] == "l" else "center"
        if not upright:
            self.draw.multiline_text(xy, text, fill=colour, font=face, anchor=anchor, align=side)
            return
        left, top, right, bottom = face.getbbox(text)
        mask = Image.new("L", (int(right - left) + 2, int(bottom - top) + 2))
        ImageDraw.Draw(mask).text((1 - left, 1 - top), text, fill=255, font=face)
        mask = mask.transpose(Image.Transpose.ROTATE_90)
        corner = (round(xy[0] - mask.width / 2), round(xy[1] - mask.height / 2))
        self.image.paste(rgb_of(colour), corner, mask)

    def smooth(self, box: Box, colour: str, draw: Callable[[Any], object]) -> None:
        """Draw in one colour within a box; ``draw`` gets the mask: `SMOOTH` times as large, 255 covers."""
        left, top, right, bottom = box
        mask = Image.new("L", ((right - left) * SMOOTH, (bottom - top) * SMOOTH))
        draw(ImageDraw.Draw(mask))
        inked = mask.getbbox()
        if inked is None:
            return
        x0, y0 = (SMOOTH * floor(v / SMOOTH) for v in inked[:2])
        x1, y1 = (SMOOTH * ceil(v / SMOOTH) for v in inked[2:])
        part = mask.crop((x0, y0, x1, y1)).reduce(SMOOTH)
        self.image.paste(rgb_of(colour), (left + x0 // SMOOTH, top + y0 // SMOOTH), part)

    def gradient(self, box: Box, colours: NDArray[np.uint8], *, upwards: bool = False) -> None:
        """Fill a box with colours (n, 3), from left to right or from below."""
        left, top, right, bottom = box
        strip = Image.fromarray(np.ascontiguousarray(colours[::-1, None] if upwards else colours[None]))
        self.image.paste(strip.resize((right - left, bottom - top), Image.Resampling.NEAREST), (left, top))

    def save(self, path: Path) -> None:
        """Write a PNG; the bytes follow from the picture alone."""
        self.image.save(path, "png", compress_level=COMPRESSION)


def stroke(on: Any, points: Points, width_pt: float, opacity: float = 1.0) -> None:  # noqa: ANN401
    """Draw a line on a mask; a wide one with round joints and ends."""
    width, fill = on_mask(width_pt), round(255 * opacity)
    on.line(points, fill=fill, width=width)
    if width > on_mask(1.0):
        half = (width - 1) / 2.0
        for x, y in points:
            on.ellipse((x - half, y - half, x + half, y + half), fill=fill)


def draw_dashes(on: Any, points: Points, dash_pt: float = 3.6, gap_pt: float = 2.7) -> None:  # noqa: ANN401
    """Draw a line of dashes on a mask."""
    xy = np.array(points)
    along = np.concatenate(([0.0], np.hypot(*np.diff(xy, axis=0).T).cumsum()))
    dash, gap = (v * POINT * SMOOTH for v in (dash_pt, gap_pt))
    for start in np.arange(0.0, along[-1], dash + gap):
        ends = np.array((start, min(start + dash, along[-1])))
        x, y = np.interp(ends, along, xy[:, 0]), np.interp(ends, along, xy[:, 1])
        on.line((x[0], y[0], x[1], y[1]), fill=255, width=on_mask(0.9))


def on_mask(length_pt: float) -> int:
    """Return a length in pixels of a mask."""
    return round(length_pt * POINT * SMOOTH)
