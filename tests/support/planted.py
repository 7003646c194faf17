"""Maps with known walls, seen by beams from realistic robot positions, and therefore with correct free space."""

from __future__ import annotations

import numpy as np

from mavnav.mapping.occupancy_grid import Grid, GridBuilder, occupancy
from mavnav.metrics.ghost_walls import GhostWalls, ghost_walls
from mavnav.metrics.walls import wall_sections
from mavnav.pose import Pose

CELL_M = 0.02
HALF_M = 1.0
RETURNS = 6000


class Scene:
    """A map into which walls are drawn, rotated by ``angle_rad`` and shifted by a fraction of a cell."""

    def __init__(self, angle_rad: float, sigma_m: float, seed: int) -> None:
        self.grid, self.rng, self.sigma_m = GridBuilder(CELL_M), np.random.default_rng(seed), sigma_m
        c, s = np.cos(angle_rad), np.sin(angle_rad)
        self.turn = np.array([(c, s), (-s, c)])

    def viewers(self, side: int = 1, shift_m: float = 0.0):
        """Return six positions, 0.8 to 2 m from the walls."""
        return np.column_stack((self.rng.uniform(-0.8, 0.8, 6) + shift_m, side * self.rng.uniform(0.8, 2.0, 6)))

    def wall(self, start, end, lasers, share: float = 0.5) -> None:
        """Add a share of the returns, noisy along the beam, to the wall from start to end, seen from the lasers."""
        ends = np.array([start, end]) @ self.turn + (0.013, 0.007)
        for laser in lasers @ self.turn + (0.013, 0.007):
            on_wall = ends[0] + self.rng.uniform(0, 1, (int(share * RETURNS) // len(lasers), 1)) * (ends[1] - ends[0])
            beam = on_wall - laser
            noise = self.rng.normal(0, self.sigma_m, (len(beam), 1))
            self.grid.insert(Pose(*laser, 0.0), on_wall + beam / np.linalg.norm(beam, axis=1, keepdims=True) * noise)


def ghost(scene: Scene, apart_m: float, share: float = 0.5) -> None:
    """Add one wall that is mapped twice, from the same side."""
    scene.wall((-HALF_M, 0), (HALF_M, 0), scene.viewers(), 1 - share)
    scene.wall((-HALF_M, -apart_m), (HALF_M, -apart_m), scene.viewers(), share)


def faint_ghost(scene: Scene, apart_m: float) -> None:
    """Add a ghost wall with a tenth of the returns."""
    ghost(scene, apart_m, 0.1)


def single(scene: Scene, apart_m: float) -> None:
    scene.wall((-HALF_M, 0), (HALF_M, 0), scene.viewers(), 1.0)


def double_sided(scene: Scene, apart_m: float) -> None:
    """Add a real wall seen from both sides."""
    scene.wall((-HALF_M, 0), (HALF_M, 0), scene.viewers())
    scene.wall((-HALF_M, -apart_m), (HALF_M, -apart_m), scene.viewers(-1) - (0, apart_m))


def corridor(scene: Scene, apart_m: float) -> None:
    """Add a gap between two walls, seen from inside."""
    inside = np.column_stack((scene.rng.uniform(-0.9, 0.9, 6), -apart_m * scene.rng.uniform(0.3, 0.7, 6)))
    scene.wall((-HALF_M, 0), (HALF_M, 0), inside)
    scene.wall((-HALF_M, -apart_m), (HALF_M, -apart_m), inside)


def step(scene: Scene, apart_m: float) -> None:
    """Add a wall with a step: two parallel walls next to each other, not one behind the other."""
    scene.wall((-HALF_M, 0), (0, 0), scene.viewers())
    scene.wall((0, -apart_m), (HALF_M, -apart_m), scene.viewers())
    scene.wall((0, -apart_m), (0, 0), scene.viewers(shift_m=0.8), 0.1)


def box(scene: Scene, apart_m: float) -> None:
    """Add a shallow cupboard on a wall."""
    scene.wall((-HALF_M, -apart_m), (-0.4, -apart_m), scene.viewers(), 0.3)
    scene.wall((0.4, -apart_m), (HALF_M, -apart_m), scene.viewers(), 0.3)
    scene.wall((-0.4, 0), (0.4, 0), scene.viewers(), 0.3)
    scene.wall((-0.4, 0), (-0.4, -apart_m), scene.viewers(shift_m=-1.0), 0.1)
    scene.wall((0.4, 0), (0.4, -apart_m), scene.viewers(shift_m=1.0), 0.1)


def thick(scene: Scene, apart_m: float) -> None:
    """Add a wall whose returns are spread evenly over its depth."""
    scene.wall((-HALF_M, -apart_m / 2), (HALF_M, -apart_m / 2), scene.viewers(), 0.2)
    for depth in np.linspace(0, 1, 9):
        scene.wall((-HALF_M, -depth * apart_m), (HALF_M, -depth * apart_m), scene.viewers(), 0.15)


REAL = {f.__name__: f for f in (single, double_sided, corridor, step, box, thick)}
PLANTED = {f.__name__: f for f in (ghost, faint_ghost)}


def map_of(kind, cells: float, angle_deg: float, sigma_m: float, seed: int) -> Grid:
    scene = Scene(np.radians(angle_deg), sigma_m, seed)
    kind(scene, cells * CELL_M)
    return scene.grid.by_rows()


def as_published(grid: Grid) -> Grid:
    """Return the grid without its counts, as in a map file."""
    cells = occupancy(grid)
    return Grid(grid.cell_m, grid.origin_xy_m, (cells == 100).astype(np.int32), (cells == 0).astype(np.int32))


def ghosts_of(grid: Grid, *, counted: bool = True) -> GhostWalls:
    return ghost_walls(grid, [wall_sections(grid.hits, grid.cell_m, k) for k in ((1, 2, 5) if counted else (1,))])


def found(grid: Grid, cells: float, angle_deg: float, *, counted: bool = True) -> bool:
    """Return whether the ghost wall is found: direction correct, offset within a cell, at least half of its length."""
    places = [
        place
        for place in ghosts_of(grid, counted=counted).places
        if abs(place.offset_mm / 20 - cells) <= 1 and abs((place.direction_deg - angle_deg + 90) % 180 - 90) < 6
    ]
    return sum(place.length_m for place in places) >= HALF_M
