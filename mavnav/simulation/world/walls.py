"""The entries of ``walls``: simple shapes, and what is made of several of them. World frame, metres."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

import numpy as np
from pydantic import ConfigDict, Field, field_validator, model_validator

from mavnav.config.strict import Strict
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.shapes import XY, Arc, Band, Box, Circle, Length, Polyline, all_apart, in_order
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mavnav.simulation.world.shapes import Shape

EVERYWHERE = (0.0, 0.0, inf, inf, 0.0, 0.0)
"""The plate of floor and ceiling, less its height."""


class Table(Strict):
    """A top on four legs; the legs stand at its corners."""

    center_m: XY = Field(description="center, [x, y]")
    size_m: tuple[Length, Length] = Field(description="edges of the top, [along x, along y] before it is turned")
    yaw_deg: float = Field(0.0, description="how far it is turned about its center, counter-clockwise")
    top_m: Band = Field((0.7, 0.75), description="lower and upper side of the top above the floor")
    leg_m: Length = Field(0.05, description="edge of a leg")

    _in_order = field_validator("top_m")(in_order)

    def parts(self) -> tuple[Shape, ...]:
        """Return the top and the legs."""
        c, s = np.cos(self.yaw_deg * DEG), np.sin(self.yaw_deg * DEG)
        offsets = 0.5 * (np.array(self.size_m) - self.leg_m) * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        centres = offsets @ np.array([(c, s), (-s, c)]) + self.center_m
        legs = [self._box((x, y), (self.leg_m, self.leg_m), (0.0, self.top_m[0])) for x, y in centres.tolist()]
        return (self._box(self.center_m, self.size_m, self.top_m), *legs)

    def _box(self, center_m: XY, size_m: tuple[float, float], height_m: Band) -> Box:
        return Box.model_construct(center_m=center_m, size_m=size_m, yaw_deg=self.yaw_deg, height_m=height_m)


class Opening(Strict):
    """A wall with an opening along its whole length: a door frame (open from 0), or a window."""

    points_m: tuple[XY, XY] = Field(description="ends of the opening, [[x, y], [x, y]]")
    open_m: Band = Field(description="lower and upper edge of the opening above the floor; wall below and above it")

    _in_order = field_validator("open_m")(in_order)
    _apart = field_validator("points_m")(all_apart)

    def parts(self) -> tuple[Shape, ...]:
        """Return the wall below, unless the opening begins at the floor, and the wall above."""
        bands = [(0.0, self.open_m[0])] * (self.open_m[0] > 0.0) + [(self.open_m[1], inf)]
        return tuple(Polyline.model_construct(points_m=self.points_m, closed=False, height_m=band) for band in bands)


class Wall(Strict):
    """One entry of ``walls``: the name of a shape, and the shape."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    polyline: Polyline | None = Field(None, description="points joined by walls")
    box: Box | None = Field(None, description="solid rectangle")
    circle: Circle | None = Field(None, description="solid column")
    arc: Arc | None = Field(None, description="round wall")
    table: Table | None = Field(None, description="a top on four legs")
    opening: Opening | None = Field(None, description="a door frame or a window")

    @model_validator(mode="after")
    def _one_shape(self) -> Wall:
        if len(self._given()) != 1:
            msg = "must be one shape: polyline, box, circle, arc, table or opening"
            raise ValueError(msg)
        return self

    def _given(self) -> dict[str, Polyline | Box | Circle | Arc | Table | Opening]:
        named = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: shape for name, shape in named.items() if shape is not None}

    @property
    def kind(self) -> str:
        """Name of the shape."""
        return next(iter(self._given()))

    @property
    def parts(self) -> tuple[Shape, ...]:
        """The simple shapes it is made of."""
        return next(iter(self._given().values())).parts()

    @property
    def has_heights(self) -> bool:
        """Whether it does not reach from the floor to above everything."""
        return any(part.height_m for part in self.parts)


def world_of(walls: Sequence[Wall], *, spatial: bool = False, ceiling_m: float | None = None) -> World:
    """Build the world of some walls; a ``spatial`` one has heights, tops and bottoms, a floor, perhaps a ceiling."""
    parts = [part for wall in walls for part in wall.parts]
    straight, curved = [part.segments() for part in parts], [part.arcs() for part in parts]
    segments, arcs = np.vstack([np.empty((0, 4)), *straight]), np.vstack([np.empty((0, 5)), *curved])
    if not spatial:
        return World(segments, arcs)
    bands = [part.height_m or (0.0, inf) for part in parts]
    heights_m = np.vstack([np.repeat(bands, list(map(len, shapes)), axis=0) for shapes in (straight, curved)])
    return World(segments, arcs, heights_m, _plates(parts, ceiling_m))


def _plates(parts: Sequence[Shape], ceiling_m: float | None) -> NDArray[np.float64]:
    """Return floor, ceiling, and tops and bottoms of solid shapes in between, (p, 7)."""
    found: list[tuple[float, ...]] = [(*EVERYWHERE, z_m) for z_m in (0.0, ceiling_m) if z_m is not None]
    for part in parts:
        plate, band = part.plate(), part.height_m
        if plate and band:
            found += [(*plate, height_m) for height_m in band if 0.0 < height_m < inf]
    return np.array(found)
