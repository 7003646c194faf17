"""The entries of ``walls``: simple shapes, and what is made of several of them. World frame, metres."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Annotated

import numpy as np
from msgspec.structs import asdict

from mavnav.config.models import Strict, setting
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.shapes import Arc, Box, Circle, Opening, Polyline, Shape, TableShape

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.simulation.world.geometry import Array

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
