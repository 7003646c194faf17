"""The entries of ``walls``: shapes, their segments, arcs and plates, and the world of them. World frame, m and deg."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf
from typing import Annotated

import numpy as np
from msgspec import Meta
from msgspec.structs import asdict

from mavnav.config.models import Strict, setting
from mavnav.simulation.world.geometry import Array, World
from mavnav.units import DEG

Metre = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
Length = Annotated[float, Meta(gt=0.0, le=1000.0)]
Height = Annotated[float, Meta(ge=0.0, le=1000.0)]
Degrees = Annotated[float, Meta(ge=-3600.0, le=3600.0)]
XY = tuple[Metre, Metre]
Band = tuple[Height, Height]

TURNED = setting("how far it is turned about its center, counter-clockwise")
CENTER = setting("center, [x, y]")


def check_order(key: str, band: Band | None) -> None:
    """Raise ValueError if the first of two heights is not the lower one."""
    if band and band[0] >= band[1]:
        what = f"has {band[0]:g} m at its bottom and {band[1]:g} m at its top"
        raise ValueError(f"{key}: {what}; give the lower height first")


def check_apart(points_m: tuple[XY, ...]) -> None:
    """Raise ValueError if a point of a wall equals the one before."""
    for a, b in pairwise(points_m):
        if a == b:
            what = f"has [{a[0]:g}, {a[1]:g}] twice in succession, a wall without length"
            raise ValueError(f"points_m: {what}; leave one out or move it")


def rectangle(center_m: XY, size_m: tuple[float, float], yaw_deg: float) -> Array:
    """Return the corners of a rectangle that is turned about its center, (4, 2), counter-clockwise."""
    c, s = np.cos(yaw_deg * DEG), np.sin(yaw_deg * DEG)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * size_m
    turned: Array = corners @ np.array([(c, s), (-s, c)]) + center_m
    return turned


class Shape(Strict, frozen=True):
    """What the simple shapes have in common."""

    height_m: Annotated[Band | None, setting("lowest and highest point above the floor; null: all heights")] = None

    def __post_init__(self) -> None:
        """Raise ValueError if the heights are not in order."""
        check_order("height_m", self.height_m)

    def parts(self) -> tuple[Shape, ...]:
        """Return the shape itself."""
        return (self,)

    def segments(self) -> Array:
        """Return the straight walls, (n, 4) in metres."""
        return np.empty((0, 4))

    def arcs(self) -> Array:
        """Return the round walls, (m, 5): centre (m), radius (m), start and sweep (rad)."""
        return np.empty((0, 5))

    def plate(self) -> tuple[float, ...] | None:
        """Return what its top and bottom are, less their height: the first six numbers of `World.plates`, or None."""
        return None

    def contains(self, xy_m: XY) -> bool:
        """Return whether the shape is closed by straight walls and a point lies inside.

        From inside a ray to the right crosses the outline an odd number of times.
        """
        x1, y1, x2, y2 = self.segments().T
        spans = (y1 > xy_m[1]) != (y2 > xy_m[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing_x = x1 + (xy_m[1] - y1) / (y2 - y1) * (x2 - x1)
        return bool(np.count_nonzero(spans & (crossing_x > xy_m[0])) % 2)


class Polyline(Shape, frozen=True, kw_only=True):
    """Points joined by walls."""

    points_m: Annotated[tuple[XY, ...], setting("corners, [[x, y], ...], two at least", min_length=2)]
    closed: Annotated[bool, setting("join the last point to the first")] = False

    def __post_init__(self) -> None:
        """Raise ValueError if a wall has no length, or the heights are not in order."""
        Shape.__post_init__(self)
        check_apart(self.points_m)

    def segments(self) -> Array:
        """Return the walls from point to point, (n, 4)."""
        points = np.array([*self.points_m, *self.points_m[:1]] if self.closed else self.points_m, dtype=np.float64)
        return np.column_stack((points[:-1], points[1:]))

    def contains(self, xy_m: XY) -> bool:
        """Return whether it is closed and a point lies inside."""
        return self.closed and Shape.contains(self, xy_m)


class Box(Shape, frozen=True, kw_only=True):
    """A solid rectangle."""

    center_m: Annotated[XY, CENTER]
    size_m: Annotated[tuple[Length, Length], setting("edges, [along x, along y] before it is turned")]
    yaw_deg: Annotated[Degrees, TURNED] = 0.0

    def segments(self) -> Array:
        """Return the four sides, (4, 4)."""
        corners = rectangle(self.center_m, self.size_m, self.yaw_deg)
        return np.column_stack((corners, np.roll(corners, -1, axis=0)))

    def plate(self) -> tuple[float, ...] | None:
        """Return the rectangle."""
        return (*self.center_m, *self.size_m, self.yaw_deg * DEG, 0.0)


class Arc(Shape, frozen=True, kw_only=True):
    """A round wall that one can stand on both sides of; a sweep of 360 makes a round room."""

    center_m: Annotated[XY, CENTER]
    radius_m: Annotated[Length, setting("radius")]
    start_deg: Annotated[Degrees, setting("bearing of its first end from the center, counter-clockwise from x")] = 0.0
    sweep_deg: Annotated[float, setting("how far it goes on, counter-clockwise", ge=-360.0, le=360.0)] = 360.0

    def __post_init__(self) -> None:
        """Raise ValueError if the wall has no length, or the heights are not in order."""
        Shape.__post_init__(self)
        if self.sweep_deg == 0.0:
            raise ValueError("sweep_deg: makes a wall without length; give a sweep other than 0")

    def arcs(self) -> Array:
        """Return the arc, (1, 5)."""
        return np.array([(*self.center_m, self.radius_m, self.start_deg * DEG, self.sweep_deg * DEG)])


class Circle(Shape, frozen=True, kw_only=True):
    """A solid, round column."""

    center_m: Annotated[XY, CENTER]
    radius_m: Annotated[Length, setting("radius")]

    def arcs(self) -> Array:
        """Return the whole turn, (1, 5)."""
        return np.array([(*self.center_m, self.radius_m, 0.0, 2.0 * np.pi)])

    def plate(self) -> tuple[float, ...] | None:
        """Return the disc."""
        return (*self.center_m, 0.0, 0.0, 0.0, self.radius_m)

    def contains(self, xy_m: XY) -> bool:
        """Return whether a point lies inside."""
        return bool(np.hypot(xy_m[0] - self.center_m[0], xy_m[1] - self.center_m[1]) < self.radius_m)


class TableShape(Strict, frozen=True):
    """A top on four legs; the legs stand at its corners."""

    center_m: Annotated[XY, CENTER]
    size_m: Annotated[tuple[Length, Length], setting("edges of the top, [along x, along y] before it is turned")]
    yaw_deg: Annotated[Degrees, TURNED] = 0.0
    top_m: Annotated[Band, setting("lower and upper side of the top above the floor")] = (0.7, 0.75)
    leg_m: Annotated[Length, setting("edge of a leg")] = 0.05

    def __post_init__(self) -> None:
        """Raise ValueError if the heights are not in order."""
        check_order("top_m", self.top_m)

    def parts(self) -> tuple[Shape, ...]:
        """Return the top and the legs; a top that lies on the floor has none."""
        top = self._box(self.center_m, self.size_m, self.top_m)
        leg_size_m, leg_band = (self.leg_m, self.leg_m), (0.0, self.top_m[0])
        between_m = (self.size_m[0] - self.leg_m, self.size_m[1] - self.leg_m)
        corners = rectangle(self.center_m, between_m, self.yaw_deg).tolist() if self.top_m[0] else []
        return (top, *(self._box((x, y), leg_size_m, leg_band) for x, y in corners))

    def _box(self, center_m: XY, size_m: tuple[float, float], height_m: Band) -> Box:
        return Box(center_m=center_m, size_m=size_m, yaw_deg=self.yaw_deg, height_m=height_m)


class Opening(Strict, frozen=True):
    """A wall with an opening along its whole length: a door frame (open from 0), or a window."""

    points_m: Annotated[tuple[XY, XY], setting("ends of the opening, [[x, y], [x, y]]")]
    open_m: Annotated[Band, setting("lower and upper edge of the opening above the floor; wall below and above it")]

    def __post_init__(self) -> None:
        """Raise ValueError if the wall has no length, or the heights are not in order."""
        check_order("open_m", self.open_m)
        check_apart(self.points_m)

    def parts(self) -> tuple[Shape, ...]:
        """Return the wall below, unless the opening begins at the floor, and the wall above."""
        bands = [(0.0, self.open_m[0])] * (self.open_m[0] > 0.0) + [(self.open_m[1], inf)]
        return tuple(Polyline(points_m=self.points_m, height_m=band) for band in bands)


EVERYWHERE = (0.0, 0.0, inf, inf, 0.0, 0.0)
"""The plate of floor and ceiling, less its height."""


class WallEntry(Strict, frozen=True):
    """One entry of ``walls``: the name of a shape, and the shape."""

    polyline: Annotated[Polyline | None, setting("points joined by walls")] = None
    box: Annotated[Box | None, setting("solid rectangle")] = None
    circle: Annotated[Circle | None, setting("solid column")] = None
    arc: Annotated[Arc | None, setting("round wall")] = None
    table: Annotated[TableShape | None, setting("a top on four legs")] = None
    opening: Annotated[Opening | None, setting("a door frame or a window")] = None

    def __post_init__(self) -> None:
        """Raise ValueError if there is not one shape."""
        if len(self._shapes()) != 1:
            raise ValueError("must be one shape: polyline, box, circle, arc, table or opening")

    def _shapes(self) -> dict[str, Shape | TableShape | Opening]:
        return {name: shape for name, shape in asdict(self).items() if shape is not None}

    @property
    def kind(self) -> str:
        """Name of the shape."""
        return next(iter(self._shapes()))

    @property
    def parts(self) -> tuple[Shape, ...]:
        """The simple shapes it is made of."""
        return next(iter(self._shapes().values())).parts()

    @property
    def has_heights(self) -> bool:
        """Whether it does not reach from the floor to above everything."""
        return any(part.height_m for part in self.parts)


def world_of(walls: Sequence[WallEntry], *, spatial: bool = False, ceiling_m: float | None = None) -> World:
    """Build the world of some walls; a ``spatial`` one has heights, tops and bottoms, a floor, perhaps a ceiling."""
    parts = [part for wall in walls for part in wall.parts]
    straight, curved = [part.segments() for part in parts], [part.arcs() for part in parts]
    segments, arcs = np.vstack([np.empty((0, 4)), *straight]), np.vstack([np.empty((0, 5)), *curved])
    if not spatial:
        return World(segments, arcs)
    bands = [part.height_m or (0.0, inf) for part in parts]
    heights_m = np.vstack([np.repeat(bands, list(map(len, shapes)), axis=0) for shapes in (straight, curved)])
    return World(segments, arcs, heights_m, _plates(parts, ceiling_m))


def _plates(parts: Sequence[Shape], ceiling_m: float | None) -> Array:
    """Return floor, ceiling, and tops and bottoms of solid shapes in between, (p, 7)."""
    plates: list[tuple[float, ...]] = [(*EVERYWHERE, z_m) for z_m in (0.0, ceiling_m) if z_m is not None]
    for part in parts:
        plate, band = part.plate(), part.height_m
        if plate and band:
            plates += [(*plate, height_m) for height_m in band if 0.0 < height_m < inf]
    return np.array(plates)
