"""Plots on a canvas: axes with ticks and names, lines, marks, legends and colour bars.

Lengths without a unit are pixels, y downwards; values on the axes are in the units of their data, y upwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import ceil, floor, log10
from typing import Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.outputs.pictures.canvas import INK, MUTED, POINT, SMOOTH, Box, Canvas, Points, font, on_mask
from mavnav.pose import Pose, transform_points

XY = NDArray[np.float64]
Ticks = Iterable[tuple[float, str]]
"""Where a tick is, and its label."""

MARK_HALF: Final = 20
"""A mark lies in a square of twice this side; lines are narrower."""
EDGE: Final = 10
"""Between a name and the edge of the picture at least."""
AREA_HALF: Final = 9
"""Half the side of the square that stands for an area in the legend."""


class Axes(Struct, frozen=True):
    """A box of a canvas that shows values: ``limits`` are the least and largest x, the least and largest y.

    ``per_unit`` are the pixels of a unit of x and of y. Points are turned about their origin by ``turn_rad`` first.
    """

    canvas: Canvas
    box: Box
    limits: tuple[float, float, float, float]
    per_unit: tuple[float, float]
    turn_rad: float = 0.0

    @classmethod
    def chart(cls, canvas: Canvas, box: Box, limits: tuple[float, float, float, float]) -> Axes:
        """Stretch the limits over the box."""
        (left, top, right, bottom), (x0, x1, y0, y1) = box, limits
        return cls(canvas, box, limits, ((right - left) / (x1 - x0), (bottom - top) / (y1 - y0)))

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in values."""
        x0, x1, y0, y1 = self.limits
        return x1 - x0, y1 - y0

    def to_canvas(self, xy: XY) -> XY:
        """Bring points (n, 2) to pixels of the canvas."""
        xy = transform_points(Pose(yaw_rad=self.turn_rad), xy)
        x = self.box[0] + (xy[:, 0] - self.limits[0]) * self.per_unit[0]
        y = self.box[3] - (xy[:, 1] - self.limits[2]) * self.per_unit[1]
        return np.column_stack((x, y))

    def to_mask(self, xy: XY, box: Box) -> Points:
        """Bring points (n, 2) to pixels of the mask over a box."""
        return [(x, y) for x, y in ((self.to_canvas(xy) - box[:2]) * SMOOTH).tolist()]

    def _ink_box(self, parts: list[XY]) -> Box | None:
        """Return the part of the box that lines or marks at points (n, 2) may reach; None where there is nothing."""
        xy = self.to_canvas(np.concatenate([np.zeros((0, 2)), *parts]))
        if not len(xy):
            return None
        (left, top), (right, bottom) = xy.min(axis=0) - MARK_HALF, xy.max(axis=0) + MARK_HALF
        x0, y0 = max(self.box[0], floor(left)), max(self.box[1], floor(top))
        x1, y1 = min(self.box[2], ceil(right)), min(self.box[3], ceil(bottom))
        return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None

    def lines(self, line: Style, lines: Iterable[XY]) -> None:
        """Draw lines (n, 2); they are broken where a value is NaN."""
        parts = [part for xy in lines for part in _finite(xy) if len(part) > 1]
        if box := self._ink_box(parts):
            masked = [self.to_mask(part, box) for part in parts]
            self.canvas.smooth(box, line.colour, lambda on: [line.pen(on, part) for part in masked])

    def bars(self, ends: XY, heights: NDArray[np.float64], colour: str) -> None:
        """Draw bars between two values of x, (n, 2), from y = 0 upwards; none where the height is 0."""
        corners = (self.to_canvas(np.column_stack((x, heights))).tolist() for x in ends.T)
        for (x0, top), (x1, _) in zip(*corners, strict=True):
            if top < self.box[3]:
                self.canvas.rectangle((x0, top, x1, self.box[3]), colour)

    def mark(self, mark: Mark | Style, xy: XY) -> None:
        """Draw a mark at points (n, 2)."""
        if box := self._ink_box([xy]):
            places = self.to_mask(xy, box)
            self.canvas.smooth(box, mark.colour, lambda on: [mark.draw(on, x, y) for x, y in places])

    def borders(self) -> None:
        """Draw the borders on the left and below."""
        left, top, right, bottom = self.box
        self.canvas.line((left, top, left, bottom, right, bottom), MUTED)

    def ticks(self, x: Ticks = (), y: Ticks = (), length: int = 6, gap: int = 4) -> None:
        """Draw ticks, and their labels after a gap."""
        left, _, _, bottom = self.box
        for value, label in x:
            at = left + (value - self.limits[0]) * self.per_unit[0]
            self.canvas.line((at, bottom, at, bottom + length), MUTED)
            self.canvas.text((at, bottom + length + gap), label, colour=MUTED, anchor="ma")
        for value, label in y:
            at = bottom - (value - self.limits[2]) * self.per_unit[1]
            self.canvas.line((left - length, at, left, at), MUTED)
            self.canvas.text((left - length - gap, at), label, colour=MUTED, anchor="rm")

    def names(self, x: str, y: str, size_pt: float = 9.0, left: int = 62) -> None:
        """Write what the axes show; the name of x inside the picture, that of y this far to the left."""
        x0, y0, x1, y1 = self.box
        half = font(size_pt).getlength(x) / 2 + EDGE
        middle = max(min((x0 + x1) / 2, self.canvas.width - half), half)
        self.canvas.text((middle, y1 + 36), x, size_pt, anchor="ma")
        self.canvas.text((x0 - left, (y0 + y1) / 2), y, size_pt, upright=True)


def _finite(line: XY) -> list[XY]:
    """Split a line (n, 2) where a value is NaN."""
    known = np.isfinite(line).all(axis=1)
    if known.all():
        return [line]
    return [part for part in np.split(line, np.flatnonzero(np.diff(known)) + 1) if np.isfinite(part[0]).all()]


def colour_bar(axes: Axes, colours: NDArray[np.uint8], ticks: Ticks, name: str) -> None:
    """Draw a colour scale (n, 3) on the right of axes; ticks are shares of it, counted from below."""
    canvas, (_, top, right, bottom) = axes.canvas, axes.box
    left, right = right + 24, right + 44
    canvas.gradient((left, top, right, bottom), colours, upwards=True)
    for share, label in ticks:
        y = top + (bottom - top) * (1.0 - share)
        canvas.line((right, y, right + 5, y), MUTED)
        canvas.text((right + 9, y), label, anchor="lm")
    canvas.text((right + 66, top + (bottom - top) * 0.5), name, 9.0, upright=True)


class Mark(Struct, frozen=True):
    """A sign at points, and in the legend: colour, name, and how it is drawn on a mask at a pixel (x, y) of it."""

    colour: str
    name: str
    draw: Callable[[Any, float, float], object]


class Style(Struct, frozen=True):
    """A style of lines: colour, name in the legend, and how a line is drawn on a mask."""

    colour: str
    name: str
    pen: Callable[[Any, Points], object]

    def draw(self, on: Any, x: float, y: float) -> None:  # noqa: ANN401
        """Draw a short piece for the legend."""
        half = 10.0 * POINT
        self.pen(on, [(x - half, y), (x + half, y)])


class Area(Struct, frozen=True):
    """A colour of areas, in the legend: a filled square with an outline."""

    colour: str
    name: str


Sign = Mark | Style | Area


def cross(on: Any, x: float, y: float, size_pt: float, width_pt: float) -> None:  # noqa: ANN401
    """Draw an x on a mask."""
    half, width = 0.5 * size_pt * POINT * SMOOTH, on_mask(width_pt)
    on.line((x - half, y - half, x + half, y + half), fill=255, width=width)
    on.line((x - half, y + half, x + half, y - half), fill=255, width=width)


def circle(on: Any, x: float, y: float, size_pt: float, width_pt: float) -> None:  # noqa: ANN401
    """Draw a circle on a mask."""
    half = 0.5 * size_pt * POINT * SMOOTH
    on.ellipse((x - half, y - half, x + half, y + half), outline=255, width=on_mask(width_pt))


def arrow(on: Any, x: float, y: float, size_pt: float, width_pt: float) -> None:  # noqa: ANN401
    """Draw an arrow to the right on a mask."""
    half, side = 0.5 * size_pt * POINT * SMOOTH, on_mask(2.0 * width_pt)
    on.line((x - half, y, x + 0.2 * half, y), fill=255, width=on_mask(width_pt))
    on.polygon(((x + half, y), (x + 0.1 * half, y - side), (x + 0.1 * half, y + side)), fill=255)


def square(on: Any, x: float, y: float, size_pt: float, width_pt: float) -> None:  # noqa: ANN401
    """Draw a square on a mask."""
    half = 0.5 * size_pt * POINT * SMOOTH
    on.rectangle((x - half, y - half, x + half, y + half), outline=255, width=on_mask(width_pt))


def crossed_circle(on: Any, x: float, y: float, size_pt: float, width_pt: float) -> None:  # noqa: ANN401
    """Draw a circle with an x inside on a mask."""
    circle(on, x, y, size_pt, width_pt)
    cross(on, x, y, size_pt * 0.7, width_pt)


def stamp(canvas: Canvas, mark: Mark | Style, x: int, y: int) -> None:
    """Draw a mark at a pixel."""
    box = (x - MARK_HALF, y - MARK_HALF, x + MARK_HALF, y + MARK_HALF)
    Axes(canvas, box, (-1.0, 1.0, -1.0, 1.0), (MARK_HALF, MARK_HALF)).mark(mark, np.zeros((1, 2)))


def legend(canvas: Canvas, marks: Sequence[Sign], y: int, left: float, size_pt: float = 8.5) -> None:
    """Name the marks in a row."""
    for mark in marks:
        middle = round(left) + MARK_HALF
        if isinstance(mark, Area):
            corners = (middle - AREA_HALF, y - AREA_HALF, middle + AREA_HALF, y + AREA_HALF)
            canvas.rectangle(corners, mark.colour, MUTED)
        else:
            stamp(canvas, mark, middle, y)
        canvas.text((middle + MARK_HALF + 2, y), mark.name, size_pt, anchor="lm")
        left += legend_width([mark], size_pt)


def centred_legend(canvas: Canvas, marks: Sequence[Sign]) -> None:
    """Name the marks in the middle of the lower edge of a picture."""
    legend(canvas, marks, canvas.height - 28, (canvas.width - legend_width(marks)) / 2.0)


def legend_room(marks: Sequence[Sign]) -> int:
    """Return how wide a picture is at least whose legend is whole."""
    return ceil(legend_width(marks)) + 20


def legend_width(marks: Sequence[Sign], size_pt: float = 8.5) -> float:
    """Return how long the row of a legend is."""
    return float(sum(54 + font(size_pt).getlength(mark.name) for mark in marks))


def heading(
    canvas: Canvas, title: str, about: str, title_pt: float = 12.0, about_y: int = 74, colour: str = INK
) -> None:
    """Write the title of a picture, and below it what one has to know of it, in a few lines."""
    middle = canvas.width / 2
    canvas.text((middle, 26), title, title_pt, colour, bold=True)
    canvas.text((middle, about_y), about, 8.5, MUTED)


def ticks(low: float, high: float, most: int = 9) -> list[float]:
    """Choose round numbers between two ends, at most so many."""
    step = tick_step(low, high, most)
    return [round(k * step, 10) + 0.0 for k in range(ceil(low / step), floor(high / step) + 1)]


def tick_step(low: float, high: float, most: int) -> float:
    """Return the distance of these numbers."""
    least = (high - low) / most
    power = 10.0 ** floor(log10(least))
    return next(f * power for f in (1.0, 2.0, 5.0, 10.0) if f * power >= least)


def label_ticks(values: Iterable[float]) -> list[tuple[float, str]]:
    """Label ticks with their values."""
    return [(value, f"{value:g}") for value in values]
