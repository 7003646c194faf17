"""Pictures in pixels: text, and lines with smooth edges, on a white canvas; PNG bytes that repeat.

Some 30 ms a picture, where matplotlib takes 0.4 s to import alone: every replay makes two.
Lengths without a unit are pixels of a picture of density 1, y downwards; ``_pt`` are points of 1/72 inch at `DPI`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from math import ceil, floor
from pathlib import Path
from struct import pack
from typing import Any, Final
from zlib import compressobj, crc32

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Box = tuple[int, int, int, int]
"""Left, top, right and bottom."""
Points = list[tuple[float, float]]

START_BLUE, GOAL_RED, POSE_MAGENTA, TRUE_ORANGE = "#0033ff", "#e00000", "#d6009a", "#ff6a00"
MEASURED_BLUE = "#0077bb"
DOUBT_RED = "#d62728"
INK, MUTED, FREE_GREY, WALL_GREY, PATH_GREY = "#222222", "#666666", "#eef1f4", "#b9bec4", "#8a929a"
"""Colours of all pictures."""

FONTS: Final = Path(__file__).parent / "fonts"
DPI: Final = 150
SMOOTH: Final = 2
"""Lines are drawn on a mask so many times as large, which is then reduced: so their edges are smooth."""
POINT: Final = DPI / 72.0  # pixels

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_RGB, _FROM_ABOVE = 2, 2
"""Colour type and filter type of the PNG specification."""
_BAND_ROWS: Final = 64


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
def font(size_pt: float, *, bold: bool = False, density: int = 1) -> Any:  # noqa: ANN401
    """Load DejaVu Sans, which has the mathematical signs."""
    file = FONTS / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
    return ImageFont.truetype(str(file), round(size_pt * POINT) * density, layout_engine=ImageFont.Layout.BASIC)


class Canvas(Struct, frozen=True):
    """A white picture to draw on; ``image`` has ``density`` times its width and height, 1 or `SMOOTH`."""

    image: Image.Image
    draw: Any
    density: int = 1

    @classmethod
    def of(cls, width: int, height: int, density: int = 1) -> Canvas:
        """Begin a picture."""
        image = Image.new("RGB", (width * density, height * density), "white")
        return cls(image, ImageDraw.Draw(image), density)

    def part(self, box: Box) -> Canvas:
        """Copy what a box of a picture of density 1 shows, to draw on."""
        image = self.image.crop(box)
        return Canvas(image, ImageDraw.Draw(image))

    @property
    def width(self) -> int:
        """Width."""
        return self.image.width // self.density

    @property
    def height(self) -> int:
        """Height."""
        return self.image.height // self.density

    def line(self, xy: Sequence[float], colour: str | tuple[int, ...], width: int = 1) -> None:
        """Draw a line x, y, x, y and so on, without smoothing: horizontal or vertical ones."""
        last = self.density - 1  # a line of even width lies before its pixels
        self.draw.line([v * self.density + last for v in xy], fill=colour, width=width * self.density)

    def rectangle(
        self, box: Sequence[float], fill: str | None = None, outline: str | None = None, width: int = 1
    ) -> None:
        """Draw a rectangle with the pixels at its ends."""
        left, top, right, bottom = (v * self.density for v in box)
        last = self.density - 1
        self.draw.rectangle((left, top, right + last, bottom + last), fill, outline, width * self.density)

    def text(
        self, xy: tuple[float, float], text: str, size_pt: float = 8.0, colour: str = INK, anchor: str = "mm",
        *, bold: bool = False, upright: bool = False,
    ) -> None:  # fmt: skip
        """Write; ``anchor`` as Pillow's. Text that stands ``upright`` reads from below, about its middle."""
        face, side = font(size_pt, bold=bold, density=self.density), "left" if anchor[0] == "l" else "center"
        xy = xy[0] * self.density, xy[1] * self.density
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
        step = SMOOTH // self.density
        part = mask.reduce(step, (x0, y0, x1, y1))
        self.image.paste(rgb_of(colour), (left * self.density + x0 // step, top * self.density + y0 // step), part)

    def gradient(self, box: Box, colours: NDArray[np.uint8], *, upwards: bool = False) -> None:
        """Fill a box with colours (n, 3), from left to right or from below."""
        left, top, right, bottom = (v * self.density for v in box)
        strip = Image.fromarray(np.ascontiguousarray(colours[::-1, None] if upwards else colours[None]))
        self.image.paste(strip.resize((right - left, bottom - top), Image.Resampling.NEAREST), (left, top))

    def save(self, path: Path) -> None:
        """Write a PNG; the bytes follow from the picture alone."""
        path.write_bytes(png(self.image))


def png(image: Image.Image) -> bytes:
    """Encode an RGB image as PNG, each row as its difference from the row above.

    Pillow tries five encodings of every row, which takes four times as long for files of the same size. A band of rows
    stays in the processor's cache: 8 ms a picture instead of 20.
    """
    width, height = image.size
    stream, parts, above = compressobj(level=2), [], np.zeros(3 * width, np.uint8)
    rows = np.full((_BAND_ROWS, 1 + 3 * width), _FROM_ABOVE, np.uint8)
    for top in range(0, height, _BAND_ROWS):
        band = np.asarray(image.crop((0, top, width, min(top + _BAND_ROWS, height)))).reshape(-1, 3 * width)
        np.subtract(band[0], above, out=rows[0, 1:])
        np.subtract(band[1:], band[:-1], out=rows[1 : len(band), 1:])
        parts.append(stream.compress(rows[: len(band)].data))
        above = band[-1]
    header = pack(">IIBBBBB", width, height, 8, _RGB, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", b"".join((*parts, stream.flush()))), (b"IEND", b""))
    return _SIGNATURE + b"".join(pack(">I", len(d)) + name + d + pack(">I", crc32(name + d)) for name, d in chunks)


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
