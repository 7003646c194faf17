"""Random matching problems, and the comparison of pruned and exhaustive search on each of their grids."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from mavnav.kernels.line_search import search as line_search
from mavnav.mapping.line_map import LineMap
from mavnav.pose import Pose, transform_points
from mavnav.scan import LaserSpec
from mavnav.slam.methods.paper import polar_points
from support import kernel_parts
from support.synthetic import furnished_rooms, scan_at

GRIDS = (5, 10, 20, 40)
LASERS = (
    LaserSpec(-2.0, 4.0 / 80, 81, 0.02, 5.6),
    LaserSpec(0.0, 2 * math.pi / 90, 90, 0.02, 5.6),
    LaserSpec(2.0, -4.0 / 80, 81, 0.02, 5.6),
)
"""Lasers with a gap behind, with a full turn, and clockwise."""


def voxel_means(xy_m: np.ndarray, voxel_m: float) -> np.ndarray:
    """Return the means (m, 2) of points (n, 2) in voxels, as used for matching."""
    out = np.empty_like(xy_m)
    return out[: kernel_parts.voxel_means(np.ascontiguousarray(xy_m), voxel_m, out)]


class Problem(Struct, frozen=True):
    """The points (n, 2) of a scan in the laser's frame, the map, and the start of the search: x, y, yaw."""

    line_map: LineMap
    points: np.ndarray
    start: np.ndarray

    @property
    def lines(self) -> tuple[np.ndarray, ...]:
        return self.line_map.nearest, self.line_map.lines, self.line_map.geometry

    @property
    def centred(self) -> np.ndarray:
        return np.ascontiguousarray((self.points - self.points.mean(axis=0)).T)

    def grid(self, half_m: float, half_rad: float, prior: float, *, pruned: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return ``at`` and ``window`` of a grid around the start."""
        middle = transform_points(Pose(*self.start), self.points.mean(axis=0)[None])[0]
        at = np.array([*middle, self.start[2], *(middle + np.array((0.01, -0.02)))])
        return at, np.array([half_m, half_rad, prior, 0.15**2, float(pruned)])

    def turned(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c, s = math.cos(at[2]), math.sin(at[2])
        x, y = self.centred
        return c * x - s * y, s * x + c * y

    def cost(self, x: np.ndarray, y: np.ndarray, offset: np.ndarray) -> float:
        return kernel_parts.cost_sum(x, y, *offset, 0.15**2, *self.lines)

    def search_once(
        self, grid: int, half_m: float, half_rad: float, prior: float, *, fixed: bool, pruned: bool, rounds: int = 2
    ) -> tuple:
        """Search grids of one size, jointly with fixed correspondences, or yaw and plane in turn.

        From the second round on, the center of the grid differs from the expected centroid.
        """
        whole = [np.inf, np.inf, 0.15, np.inf, rounds]  # one level, with all points
        limits = np.array([half_m, half_rad, *whole, prior, np.inf if fixed else 0.0, 0.0, 0.0, 0.0, 0.0])
        nodes = np.array([2.0 * grid, grid, grid, 0, pruned])
        return line_search.search(self.points, self.start, nodes, limits, *self.lines)


def random_problem(seed: int) -> Problem:
    """Return a map of scans and scattered points, with a scan that fits it approximately."""
    rng = np.random.default_rng(seed)
    here = Pose(3.0, 2.2, float(rng.uniform(-3, 3)))
    noise = float(rng.choice((0.001, 0.01, 0.04)))
    line_map = LineMap(float(rng.choice((0.014, 0.02, 0.025))), 0.06, 0.01)
    for _ in range(int(rng.integers(1, 4))):
        seen = scan_at(furnished_rooms(), here, noise=noise, rng=rng).points()
        line_map.insert(transform_points(here, seen))
    line_map.insert(rng.uniform(-1, 6, (int(rng.integers(1, 200)), 2)))
    seen = scan_at(furnished_rooms(), here, noise=noise, rng=rng).points()
    means = voxel_means(seen[:: int(rng.choice((1, 3, 9)))], 0.03)
    return Problem(line_map, means, here.as_array() + rng.normal(0, (0.05, 0.05, 0.03)))


def differences(problem: Problem, grid: int, half_m: float, half_rad: float, prior: float) -> list[str]:
    """Return the names of the grids whose minima differ in index or cost between both searches."""
    found = {
        pruned: {
            name: problem.search_once(grid, half_m, half_rad, prior, fixed=fixed, pruned=pruned)
            for name, fixed in {"joint with fixed correspondences": True, "yaw and plane in turn": False}.items()
        }
        for pruned in (True, False)
    }
    return [name for name, best in found[True].items() if best != found[False][name]]


def polar_problem(
    seed: int, spec: LaserSpec, *, counted: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.random.Generator]:
    """Return virtual ranges, points (n, 5) and limits of a search of the paper's method, and the random generator."""
    rng = np.random.default_rng(seed)
    virtual = scan_at(furnished_rooms(), Pose(3.0, 2.4, rng.uniform(-3, 3)), spec, noise=0.02, rng=rng).ranges_m.copy()
    virtual[rng.random(spec.beams) < 0.1] = np.nan
    scan = scan_at(furnished_rooms(), Pose(3.1, 2.3, rng.uniform(-3, 3)), spec, noise=0.02, rng=rng)
    limits = np.array([spec.angle_min_rad, spec.angle_step_rad, 0.1, 5.0, 0.3, 0.1, 8.0, counted])
    return virtual, polar_points(scan.ranges_m, spec, 0.1), limits, rng
