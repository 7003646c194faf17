"""Quick pictures: a part of the map as pixels, in a frame of metres, with marks and text; PNG bytes that repeat.

Some 30 ms a picture, where a plotting library takes a second to load and another to draw: every replay makes two.
Lengths without a unit are pixels, y downwards. Marks are drawn twice as large and reduced, so that edges are smooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from math import ceil, floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mavnav.mapping.tiled_arrays import as_it_is, pooled
from mavnav.outputs.viewport import DPI, GOAL_RED, INK, MAX_CELLS, MUTED, POSE_MAGENTA, START_BLUE, TRUE_ORANGE, Window

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.mapping.tiled_arrays import Told

    Box = tuple[int, int, int, int]
    XY = NDArray[np.float64]

SMOOTH: Final = 2
SPINE: Final = "#cccccc"
POINT: Final = DPI / 72.0  # pixels

VIRIDIS: Final = ("#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b")
TURBO: Final = (
    "#30123b", "#4662d7", "#36aaf9", "#1ae4b6", "#72fe5e", "#c8ef34", "#faba39", "#f66b19", "#cb2a04", "#7a0403",
)  # fmt: skip


def rgb_of(colour: str) -> tuple[int, int, int]:
    """Read ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def ramp(colours: Iterable[str], n: int = 256) -> NDArray[np.uint8]:
    """Blend colours into a scale, (n, 3)."""
    anchors = np.array([rgb_of(c) for c in colours], float)
    at = np.linspace(0.0, len(anchors) - 1.0, n)
    blended = [np.interp(at, np.arange(len(anchors)), part) for part in anchors.T]
    return np.column_stack(blended).round().astype(np.uint8)


@cache
def font(size_pt: float, *, bold: bool = False) -> Any:  # noqa: ANN401
    """Load a typeface that knows the signs of mathematics; matplotlib brings it, and is not imported for it."""
    found = find_spec("matplotlib")
    folder = Path(found.origin or "").parent if found else Path()
    file = folder / "mpl-data" / "fonts" / "ttf" / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
    return ImageFont.truetype(str(file), round(size_pt * POINT), layout_engine=ImageFont.Layout.BASIC)


@dataclass(frozen=True, slots=True)
class Canvas:
    """A white picture to draw on."""

    image: Any

    @classmethod
    def of(cls, width: int, height: int) -> Canvas:
        """Begin a picture."""
        return cls(Image.new("RGB", (width, height), "white"))

    def text(
        self, xy: tuple[float, float], text: str, size_pt: float = 8.0, colour: str = INK, anchor: str = "mm",
        *, bold: bool = False, upright: bool = False,
    ) -> None:  # fmt: skip
        """Write; ``anchor`` as Pillow's. Text that stands ``upright`` reads from below, about its middle."""
        face, side = font(size_pt, bold=bold), "left" if anchor[0] == "l" else "center"
        if not upright:
            ImageDraw.Draw(self.image).multiline_text(xy, text, fill=colour, font=face, anchor=anchor, align=side)
            return
        left, top, right, bottom = face.getbbox(text)
        mask = Image.new("L", (int(right - left) + 2, int(bottom - top) + 2))
        ImageDraw.Draw(mask).text((1 - left, 1 - top), text, fill=255, font=face)
        mask = mask.transpose(Image.Transpose.ROTATE_90)
        corner = (round(xy[0] - mask.width / 2), round(xy[1] - mask.height / 2))
        self.image.paste(rgb_of(colour), corner, mask)

    def marks(self, box: Box, colour: str, draw: Callable[[Any], object]) -> None:
        """Draw marks of one colour within a box; ``draw`` gets a drawing whose pixels are half as large."""
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

    def save(self, path: Path) -> None:
        """Write a PNG; the bytes follow from the picture alone."""
        self.image.save(path, format="PNG", compress_level=2)


@dataclass(frozen=True, slots=True)
class Frame:
    """A part of a canvas that shows a window of the map."""

    canvas: Canvas
    window: Window
    left: int
    top: int
    width: int
    height: int

    @property
    def box(self) -> Box:
        """Left, top, right and bottom."""
        return self.left, self.top, self.left + self.width, self.top + self.height

    @property
    def per_m(self) -> float:
        """Pixels of a metre."""
        return self.width / self.window.size_m[0]

    def cells(
        self,
        grid: Grid,
        cells: NDArray[Any],
        colour_of: Callable[[NDArray[Any]], NDArray[np.uint8]],
        told: Told = as_it_is,
    ) -> None:
        """Show an array of the grid's shape; zeros are transparent, ``colour_of`` gives (n, 3) for the others.

        Of the array, or of what is ``told`` of it, as `pooled` takes it, the largest of some cells are shown.
        """
        first_col, end_col, first_row, end_row = self.window.cells_of(grid)
        factor = max(1, ceil(max(self.window.size_m) / grid.cell_m / MAX_CELLS))
        shown = pooled(cells[first_row:end_row, first_col:end_col], factor, told=told)[::-1]
        pixels = np.zeros((*shown.shape, 4), np.uint8)
        some = shown > 0
        pixels[some, :3], pixels[some, 3] = colour_of(shown[some]), 255
        x0_m = grid.origin_xy_m[0] + first_col * grid.cell_m
        y0_m = grid.origin_xy_m[1] + first_row * grid.cell_m
        rows, cols = shown.shape
        corners = np.array([[x0_m, y0_m + rows * factor * grid.cell_m], [x0_m + cols * factor * grid.cell_m, y0_m]])
        (x0, y0), (x1, y1) = np.round(self.to_canvas(corners)).astype(int).tolist()
        picture = Image.fromarray(pixels).resize((max(x1 - x0, 1), max(y1 - y0, 1)), Image.Resampling.NEAREST)
        left, top = max(self.left - x0, 0), max(self.top - y0, 0)
        right, bottom = (
            min(picture.width, self.left + self.width - x0),
            min(picture.height, self.top + self.height - y0),
        )
        if right > left and bottom > top:
            picture = picture.crop((left, top, right, bottom))
            self.canvas.image.paste(picture, (x0 + left, y0 + top), picture)

    def mark(self, mark: Mark, xy_m: XY) -> None:
        """Draw a mark at points (n, 2) of the map."""
        places = self.to_marks(xy_m)

        def draw(on: Any) -> None:  # noqa: ANN401
            for x, y in places:
                mark.draw(on, x, y)

        self.canvas.marks(self.box, mark.colour, draw)

    def to_canvas(self, xy_m: XY) -> XY:
        """Bring points (n, 2) of the map frame to the canvas."""
        x = self.left + (xy_m[:, 0] - self.window.x0_m) * self.per_m
        y = self.top + self.height - (xy_m[:, 1] - self.window.y0_m) * self.per_m
        return np.column_stack((x, y))

    def to_marks(self, xy_m: XY) -> list[tuple[float, float]]:
        """Bring points of the map frame to the finer pixels of ``Canvas.marks`` in this frame's box."""
        xy = (self.to_canvas(xy_m) - (self.left, self.top)) * SMOOTH
        return [(x, y) for x, y in xy.tolist()]

    def dress(self) -> None:
        """Draw the spines, ticks and names of the axes."""
        draw, (left, top, right, bottom) = ImageDraw.Draw(self.canvas.image), self.box
        draw.rectangle((left, top, right, bottom), outline=SPINE)
        for x_m in ticks(self.window.x0_m, self.window.x1_m):
            x = left + (x_m - self.window.x0_m) * self.per_m
            draw.line((x, bottom, x, bottom + 6), fill=MUTED)
            self.canvas.text((x, bottom + 10), f"{x_m:g}", colour=MUTED, anchor="ma")
        for y_m in ticks(self.window.y0_m, self.window.y1_m):
            y = bottom - (y_m - self.window.y0_m) * self.per_m
            draw.line((left - 6, y, left, y), fill=MUTED)
            self.canvas.text((left - 10, y), f"{y_m:g}", colour=MUTED, anchor="rm")
        self.canvas.text(((left + right) / 2, bottom + 36), "x [m]", 9.0, anchor="ma")
        self.canvas.text((left - 62, (top + bottom) / 2), "y [m]", 9.0, upright=True)


@dataclass(frozen=True, slots=True)
class Bar:
    """The colour bar right of a frame, from ``left`` on; shares of the scale count from below."""

    frame: Frame
    left: int
    wide: int = 20

    def _y(self, share: float) -> float:
        return self.frame.top + self.frame.height * (1.0 - share)

    def gradient(self, scale: NDArray[np.uint8]) -> None:
        """Fill it with a scale (n, 3), the last on top."""
        column = Image.fromarray(np.ascontiguousarray(scale[::-1, None]))
        self.frame.canvas.image.paste(
            column.resize((self.wide, self.frame.height), Image.Resampling.NEAREST), (self.left, self.frame.top)
        )

    def tick(self, share: float, text: str, *, line: bool = True) -> None:
        """Name a value."""
        right, y = self.left + self.wide, self._y(share)
        if line:
            ImageDraw.Draw(self.frame.canvas.image).line((right, y, right + 5, y), fill=MUTED)
        self.frame.canvas.text((right + 9, y), text, anchor="lm")

    def name(self, text: str) -> None:
        """Say what the scale is of."""
        self.frame.canvas.text((self.left + self.wide + 66, self._y(0.5)), text, 9.0, upright=True)


@dataclass(frozen=True, slots=True)
class Mark:
    """A sign at points of the map, and in the legend: colour, name, and how one is drawn at a place of the marks."""

    colour: str
    name: str
    draw: Callable[..., None]


def _cross(size: float, width: float) -> Callable[..., None]:
    half, wide = 0.5 * size * POINT * SMOOTH, round(width * POINT * SMOOTH)

    def draw(on: Any, x: float, y: float) -> None:  # noqa: ANN401
        on.line((x - half, y - half, x + half, y + half), fill=255, width=wide)
        on.line((x - half, y + half, x + half, y - half), fill=255, width=wide)

    return draw


def _circle(size: float, width: float, *, crossed: bool = False) -> Callable[..., None]:
    half, wide = 0.5 * size * POINT * SMOOTH, round(width * POINT * SMOOTH)
    cross = _cross(size * 0.7, width)

    def draw(on: Any, x: float, y: float) -> None:  # noqa: ANN401
        on.ellipse((x - half, y - half, x + half, y + half), outline=255, width=wide)
        if crossed:
            cross(on, x, y)

    return draw


def _dash(on: Any, x: float, y: float) -> None:  # noqa: ANN401
    reach = 10.0 * POINT
    dashed(on, [(x - reach, y), (x + reach, y)])


def _stroke(on: Any, x: float, y: float) -> None:  # noqa: ANN401
    reach = 10.0 * POINT
    on.line((x - reach, y, x + reach, y), fill=255, width=3)


def dashed(on: Any, line: list[tuple[float, float]], dash_pt: float = 3.6, gap_pt: float = 2.7) -> None:  # noqa: ANN401
    """Draw a line of dashes, in marks."""
    xy = np.array(line)
    along = np.concatenate(([0.0], np.hypot(*np.diff(xy, axis=0).T).cumsum()))
    dash, gap = (v * POINT * SMOOTH for v in (dash_pt, gap_pt))
    for start in np.arange(0.0, along[-1], dash + gap):
        ends = np.array((start, min(start + dash, along[-1])))
        x, y = np.interp(ends, along, xy[:, 0]), np.interp(ends, along, xy[:, 1])
        on.line((x[0], y[0], x[1], y[1]), fill=255, width=round(0.9 * POINT * SMOOTH))


START: Final = Mark(START_BLUE, "start", _cross(10.0, 2.4))
END: Final = Mark(GOAL_RED, "end", _circle(13.0, 1.4, crossed=True))
GOAL: Final = Mark(GOAL_RED, "goal", END.draw)
POSE: Final = Mark(POSE_MAGENTA, "estimated pose", _circle(4.0, 0.8))
TRUE_POSE: Final = Mark("#000000", "true pose", _cross(3.5, 0.7))
LOOP: Final = Mark(INK, "closed loop", _stroke)
TRUE_WALL: Final = Mark(TRUE_ORANGE, "true wall", _dash)


def legend(canvas: Canvas, marks: list[Mark], y: int) -> None:
    """Name the marks in one row about the middle of the canvas."""
    face = font(8.5)
    widths = [54 + face.getlength(mark.name) for mark in marks]
    x = (canvas.image.width - sum(widths)) / 2.0
    for mark, width in zip(marks, widths, strict=True):
        at = (round(x), y - 20)
        canvas.marks((*at, at[0] + 40, y + 20), mark.colour, partial(mark.draw, x=40.0, y=40.0))
        canvas.text((at[0] + 42, y), mark.name, 8.5, anchor="lm")
        x += width


def ticks(low: float, high: float, most: int = 9) -> list[float]:
    """Choose round numbers between two ends, at most so many."""
    least = (high - low) / most
    power = 10.0 ** floor(log10(least))
    step = next(f * power for f in (1.0, 2.0, 5.0, 10.0) if f * power >= least)
    return [round(k * step, 10) + 0.0 for k in range(ceil(low / step), floor(high / step) + 1)]
