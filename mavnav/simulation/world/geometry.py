"""Walls as exact geometry: what a ray meets, and how far the nearest wall is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.pose import transform_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.pose import Pose

    Array = NDArray[np.float64]

SEAM: Final = 1e-9
"""Walls reach this much (share of a segment, rad of an arc) beyond their ends, so that no ray slips through a joint."""


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Walls of no thickness in the world frame, seen from both sides.

    ``segments`` (n, 4): x1, y1, x2, y2 in metres. ``arcs`` (m, 5): x and y of the centre, radius (m), start (rad) and
    sweep (rad, its sign is the sense). Both read-only.
    """

    segments: Array
    arcs: Array

    def __post_init__(self) -> None:
        """Check the shapes and freeze the arrays."""
        if self.segments.ndim != 2 or self.segments.shape[1] != 4 or self.arcs.ndim != 2 or self.arcs.shape[1] != 5:
            msg = f"shapes {self.segments.shape} and {self.arcs.shape} are no world"
            raise ValueError(msg)
        self.segments.flags.writeable = False
        self.arcs.flags.writeable = False

    def cast(self, xy_m: Array | tuple[float, float], bearings_rad: Array) -> tuple[Array, Array]:
        """Follow rays to the nearest wall.

        Parameters
        ----------
        xy_m
            Where the rays begin: (2,) for all of them, or (n, 2).
        bearings_rad
            Their directions in the world frame, (n,).

        Returns
        -------
        ranges_m, incidence_rad
            (n,) each: the distance, and the angle between ray and wall's normal, 0 to pi/2; inf and NaN where there is
            no wall.
        """
        x, y = np.broadcast_to(np.asarray(xy_m, dtype=np.float64), (len(bearings_rad), 2)).T[:, :, None]
        dx, dy = np.cos(bearings_rad)[:, None], np.sin(bearings_rad)[:, None]
        ranges = np.hstack((_meet_segments(self.segments, x, y, dx, dy), *_meet_arcs(self.arcs, x, y, dx, dy)))
        nearest = ranges.argmin(axis=1)
        ranges = np.take_along_axis(ranges, nearest[:, None], 1)
        with np.errstate(invalid="ignore"):  # inf * 0: a ray along an axis that meets nothing
            normals = self._normals_at(nearest, x + ranges * dx, y + ranges * dy)
        cosine = np.abs(normals[:, 0] * dx[:, 0] + normals[:, 1] * dy[:, 0])
        return ranges[:, 0], np.arccos(np.minimum(cosine, 1.0))

    def _normals_at(self, wall: NDArray[np.int64], x: Array, y: Array) -> Array:
        """Return unit normals (n, 2) of walls at points (n, 1) of them; NaN where a point is not finite.

        ``wall`` counts the segments, then the near sides of the arcs, then their far sides.
        """
        n, m = len(self.segments), len(self.arcs)
        normals = np.full((len(wall), 2), np.nan)
        straight, met = wall < n, np.isfinite(x[:, 0])
        x1, y1, x2, y2 = self.segments[wall[straight & met]].T
        normals[straight & met] = np.column_stack((y1 - y2, x2 - x1)) / np.hypot(x2 - x1, y2 - y1)[:, None]
        round_ = ~straight & met
        cx, cy, radius = self.arcs[(wall[round_] - n) % max(m, 1), :3].T
        normals[round_] = np.column_stack((x[round_, 0] - cx, y[round_, 0] - cy)) / radius[:, None]
        return normals

    def clearance_m(self, xy_m: Array) -> Array:
        """Return the distance of points (n, 2) to the nearest wall, (n,) in metres."""
        x, y = xy_m[:, :1], xy_m[:, 1:]
        nearest: Array = np.hstack((_to_segments(self.segments, x, y), _to_arcs(self.arcs, x, y))).min(axis=1)
        return nearest

    def seen_from(self, world_T_frame: Pose) -> World:
        """Return the walls in another frame."""
        frame_T_world = world_T_frame.inverse()
        ends = transform_points(frame_T_world, self.segments.reshape(-1, 2)).reshape(-1, 4)
        centres = transform_points(frame_T_world, self.arcs[:, :2])
        starts_rad = self.arcs[:, 3] + frame_T_world.yaw_rad
        return World(ends, np.column_stack((centres, self.arcs[:, 2], starts_rad, self.arcs[:, 4])))

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """Box around the walls: least x and y, greatest x and y."""
        xy = np.vstack((self.segments[:, :2], self.segments[:, 2:], *map(_extremes, self.arcs)))
        left, low, right, top = (float(v) for v in (*xy.min(axis=0), *xy.max(axis=0)))
        return left, low, right, top


def _extremes(arc: Array) -> Array:
    """Return the ends of an arc (5,), and those of its points that lie farthest along an axis, (n, 2) in metres."""
    cx, cy, radius, start, sweep = arc
    quarters = np.arange(4) * np.pi / 2
    bearings = np.concatenate(((start, start + sweep), quarters[_on_arc(quarters, start, sweep)]))
    return np.column_stack((cx + radius * np.cos(bearings), cy + radius * np.sin(bearings)))


def _meet_segments(segments: Array, x: Array, y: Array, dx: Array, dy: Array) -> Array:
    """Return the ranges of n rays (columns) to m segments, (n, m); inf where they miss."""
    ax, ay = segments[:, 0] - x, segments[:, 1] - y
    ex, ey = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    # Solve r d = a + u e for the range r along the ray and the share u along the wall.
    across = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        r = (ax * ey - ay * ex) / across
        u = (ax * dy - ay * dx) / across
    met = (across != 0.0) & (r > 0.0) & (u >= -SEAM) & (u <= 1.0 + SEAM)
    return np.where(met, r, np.inf)


def _meet_arcs(arcs: Array, x: Array, y: Array, dx: Array, dy: Array) -> list[Array]:
    """Return the ranges of n rays to m arcs, (n, m) to the near side of their circles and again to the far side."""
    cx, cy, radius, start, sweep = arcs.T
    along = dx * (cx - x) + dy * (cy - y)
    beside = dx * (cy - y) - dy * (cx - x)
    near, far = np.full((2, *along.shape), np.inf)
    ray, arc = np.nonzero(np.abs(beside) <= radius)
    half_chord = np.sqrt((radius[arc] - beside[ray, arc]) * (radius[arc] + beside[ray, arc]))
    for side, sign in ((near, -1.0), (far, 1.0)):
        r = along[ray, arc] + sign * half_chord
        from_y = y[ray, 0] + r * dy[ray, 0] - cy[arc]
        from_x = x[ray, 0] + r * dx[ray, 0] - cx[arc]
        met = (r > 0.0) & _on_arc(np.arctan2(from_y, from_x), start[arc], sweep[arc])
        side[ray, arc] = np.where(met, r, np.inf)
    return [near, far]


def _on_arc(bearing_rad: Array, start_rad: Array, sweep_rad: Array) -> NDArray[np.bool_]:
    """Return which bearings from the centre lie on the arcs."""
    onward = (bearing_rad - start_rad) * np.sign(sweep_rad)
    on_it: NDArray[np.bool_] = np.mod(onward + SEAM, 2.0 * np.pi) <= np.abs(sweep_rad) + 2.0 * SEAM
    return on_it


def _to_segments(segments: Array, x: Array, y: Array) -> Array:
    """Distances of n points (columns) to m segments, (n, m)."""
    ax, ay = x - segments[:, 0], y - segments[:, 1]
    ex, ey = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    squared = np.maximum(ex * ex + ey * ey, np.finfo(np.float64).tiny)
    u = np.clip((ax * ex + ay * ey) / squared, 0.0, 1.0)
    distance: Array = np.hypot(ax - u * ex, ay - u * ey)
    return distance


def _to_arcs(arcs: Array, x: Array, y: Array) -> Array:
    """Distances of n points (columns) to m arcs, (n, m): across the arc within its sweep, else to its nearer end."""
    cx, cy, radius, start, sweep = arcs.T
    ends = [np.hypot(x - cx - radius * np.cos(end), y - cy - radius * np.sin(end)) for end in (start, start + sweep)]
    within = _on_arc(np.arctan2(y - cy, x - cx), start, sweep)
    distance: Array = np.where(within, np.abs(np.hypot(x - cx, y - cy) - radius), np.minimum(*ends))
    return distance
