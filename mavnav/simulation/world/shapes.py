"""Simple shapes that walls are written with, and their segments, arcs and plates. World frame, metres and degrees."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Protocol, Self

import numpy as np
from pydantic import Field, field_validator

from mavnav.config.strict import Strict
from mavnav.units import DEG

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

Metre = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Length = Annotated[float, Field(gt=0.0, le=1000.0)]
Height = Annotated[float, Field(ge=0.0, le=1000.0)]
XY = tuple[Metre, Metre]
Band = tuple[Height, Height]


def in_order(band: Band | None) -> Band | None:
    """Return heights as they are; raise ValueError if the first is not the lower one."""
    if band and band[0] >= band[1]:
        msg = f"has {band[0]:g} m at its bottom and {band[1]:g} m at its top; give the lower height first"
        raise ValueError(msg)
    return band


def all_apart(points_m: tuple[XY, ...]) -> tuple[XY, ...]:
    """Return points as they are; raise ValueError if one equals the one before: a wall without length."""
    for a, b in pairwise(points_m):
        if a == b:
            msg = f"has [{a[0]:g}, {a[1]:g}] twice in succession, a wall without length; leave one out or move it"
            raise ValueError(msg)
    return points_m


class Shape(Protocol):
    """What every simple shape has."""

    @property
    def height_m(self) -> Band | None:
        """Its lowest and highest point; None from the floor to above everything."""

    def segments(self) -> Array:
        """Return the straight walls, (n, 4) in metres."""

    def arcs(self) -> Array:
        """Return the round walls, (m, 5): centre (m), radius (m), start and sweep (rad)."""

    def plate(self) -> tuple[float, ...] | None:
        """Return what its top and bottom are, less their height: the first six numbers of `World.plates`, or None."""

    def contains(self, xy_m: XY) -> bool:
        """Return whether the shape is closed and a point lies inside."""


class Simple(Strict):
    """What the simple shapes have in common."""

    height_m: Band | None = Field(
        None, description="lowest and highest point above the floor, [low, high]; null: from the floor to above all"
    )

    _in_order = field_validator("height_m")(in_order)

    def parts(self) -> tuple[Self, ...]:
        """Return the shape itself."""
        return (self,)

    def plate(self) -> tuple[float, ...] | None:
        """Return None: there is neither a top nor a bottom."""
        return None


class Polyline(Simple):
    """Points joined by walls."""

    points_m: tuple[XY, ...] = Field(description="corners, [[x, y], ...], two at least")
    closed: bool = Field(False, description="join the last point to the first")

    @field_validator("points_m")
    @classmethod
    def _two_points(cls, points_m: tuple[XY, ...]) -> tuple[XY, ...]:
        if len(points_m) < 2:
            msg = "needs two points at least"
            raise ValueError(msg)
        return points_m

    _apart = field_validator("points_m")(all_apart)

    def segments(self) -> Array:
        """Return the walls from point to point, (n, 4)."""
        points = np.array([*self.points_m, *self.points_m[:1]] if self.closed else self.points_m, dtype=np.float64)
        return np.column_stack((points[:-1], points[1:]))

    def arcs(self) -> Array:
        """Return none, (0, 5)."""
        return np.empty((0, 5))

    def contains(self, xy_m: XY) -> bool:
        """Count how often a ray to the right crosses the outline: an odd number of times from inside."""
        if not self.closed:
            return False
        x1, y1, x2, y2 = self.segments().T
        spans = (y1 > xy_m[1]) != (y2 > xy_m[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing_x = x1 + (xy_m[1] - y1) / (y2 - y1) * (x2 - x1)
        return bool(np.count_nonzero(spans & (crossing_x > xy_m[0])) % 2)


class Box(Simple):
    """A solid rectangle."""

    center_m: XY = Field(description="center, [x, y]")
    size_m: tuple[Length, Length] = Field(description="edges, [along x, along y] before it is turned")
    yaw_deg: float = Field(0.0, description="how far it is turned about its center, counter-clockwise")

    def _outline(self) -> Polyline:
        c, s = np.cos(self.yaw_deg * DEG), np.sin(self.yaw_deg * DEG)
        corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * self.size_m
        xy = corners @ np.array([(c, s), (-s, c)]) + self.center_m
        return Polyline.model_construct(points_m=tuple(map(tuple, xy.tolist())), closed=True)

    def segments(self) -> Array:
        """Return the four sides, (4, 4)."""
        return self._outline().segments()

    def arcs(self) -> Array:
        """Return none, (0, 5)."""
        return np.empty((0, 5))

    def plate(self) -> tuple[float, ...] | None:
        """Return the rectangle."""
        return (*self.center_m, *self.size_m, self.yaw_deg * DEG, 0.0)

    def contains(self, xy_m: XY) -> bool:
        """Return whether a point lies inside."""
        return self._outline().contains(xy_m)


class Arc(Simple):
    """A round wall that one can stand on both sides of; a sweep of 360 makes a round room."""

    center_m: XY = Field(description="center, [x, y]")
    radius_m: Length = Field(description="radius")
    start_deg: float = Field(0.0, description="bearing of its first end from the center, counter-clockwise from x")
    sweep_deg: float = Field(360.0, ge=-360.0, le=360.0, description="how far it goes on, counter-clockwise")

    @field_validator("sweep_deg")
    @classmethod
    def _some_sweep(cls, sweep_deg: float) -> float:
        if sweep_deg == 0.0:
            msg = "makes a wall without length; give a sweep other than 0"
            raise ValueError(msg)
        return sweep_deg

    def segments(self) -> Array:
        """Return none, (0, 4)."""
        return np.empty((0, 4))

    def arcs(self) -> Array:
        """Return the arc, (1, 5)."""
        return np.array([(*self.center_m, self.radius_m, self.start_deg * DEG, self.sweep_deg * DEG)])

    def contains(self, xy_m: XY) -> bool:  # noqa: ARG002  one interface
        """Return False: an arc is not solid."""
        return False


class Circle(Simple):
    """A solid, round column."""

    center_m: XY = Field(description="center, [x, y]")
    radius_m: Length = Field(description="radius")

    def segments(self) -> Array:
        """Return none, (0, 4)."""
        return np.empty((0, 4))

    def arcs(self) -> Array:
        """Return the whole turn, (1, 5)."""
        return np.array([(*self.center_m, self.radius_m, 0.0, 2.0 * np.pi)])

    def plate(self) -> tuple[float, ...] | None:
        """Return the disc."""
        return (*self.center_m, 0.0, 0.0, 0.0, self.radius_m)

    def contains(self, xy_m: XY) -> bool:
        """Return whether a point lies inside."""
        return bool(np.hypot(xy_m[0] - self.center_m[0], xy_m[1] - self.center_m[1]) < self.radius_m)
