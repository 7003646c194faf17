"""Walls and level surfaces as exact geometry: what a ray meets, and how far the nearest wall is."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.pose import Pose, transform_points

Array = NDArray[np.float64]


SEAM: Final = 1e-9
"""Walls reach this much (share of a segment, rad of an arc) beyond their ends, so that no ray slips through a joint."""


class World(Struct, frozen=True, eq=False):
    """Walls of no thickness in the world frame, seen from both sides.

    ``segments`` (n, 4): x1, y1, x2, y2 in metres. ``arcs`` (m, 5): x and y of the centre, radius (m), start (rad) and
    sweep (rad, its sign is the sense). ``heights_m`` (n + m, 2): lowest and highest point of each, segments first;
    empty where all walls reach from the floor to above everything. ``plates`` (p, 7): level surfaces, floor and
    ceiling among them: x and y of the centre, length, width (m), yaw (rad), a margin around that rectangle, height (m).
    A disc is all margin; floor and ceiling have no end. All read-only.
    """

    segments: Array
    arcs: Array
    heights_m: Array = field(default_factory=partial(np.empty, (0, 2)))
    plates: Array = field(default_factory=partial(np.empty, (0, 7)))

    def __post_init__(self) -> None:
        """Check the shapes and freeze the arrays."""
        if self.segments.ndim != 2 or self.segments.shape[1] != 4 or self.arcs.ndim != 2 or self.arcs.shape[1] != 5:
            msg = f"shapes {self.segments.shape} and {self.arcs.shape} are no world"
            raise ValueError(msg)
        for array in (self.segments, self.arcs, self.heights_m, self.plates):
            array.flags.writeable = False

    def cast(self, xy_m: Array | tuple[float, float], bearings_rad: Array) -> tuple[Array, Array]:
        """Follow level rays to the nearest wall; all walls are taken to stand at their height.

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
        rays = _rays(xy_m, bearings_rad)
        return self._first(self._meet(*rays), *rays)

    def cast_tilted(
        self, xy_m: Array | tuple[float, float], height_m: Array | float, directions: Array
    ) -> tuple[Array, Array]:
        """Follow rays in space to the nearest wall that stands at their height there, or to the nearest plate.

        ``directions`` (n, 3) are of length 1, none of them upright; ``height_m``, () or (n,), is where the rays begin.
        Returns ranges along the rays and incidences as `cast` does.
        """
        level = np.hypot(directions[:, 0], directions[:, 1])
        rays = _rays(xy_m, np.arctan2(directions[:, 1], directions[:, 0]))
        from_m, rise = np.broadcast_to(height_m, len(level))[:, None], (directions[:, 2] / level)[:, None]
        ranges = self._meet(*rays)
        if len(self.heights_m):
            n = len(self.segments)
            low, high = np.vstack((self.heights_m, self.heights_m[n:])).T
            with np.errstate(invalid="ignore"):  # inf * 0: a level ray that meets nothing
                at_m = from_m + ranges * rise
            ranges[(at_m < low) | (at_m > high)] = np.inf
        walls_m, incidence_rad = self._first(ranges, *rays)
        plates_m = _meet_plates(self.plates, *rays, from_m, rise)
        on_plate = plates_m < walls_m
        cosine = np.where(on_plate, np.abs(directions[:, 2]), np.cos(incidence_rad) * level)
        return np.minimum(walls_m, plates_m) / level, np.arccos(np.minimum(cosine, 1.0))

    def _meet(self, x: Array, y: Array, dx: Array, dy: Array) -> Array:
        """Return the ranges of n rays to all walls, (n, segments + 2 arcs): near sides of the arcs, then far sides."""
        return np.hstack((_meet_segments(self.segments, x, y, dx, dy), *_meet_arcs(self.arcs, x, y, dx, dy)))

    def _first(self, ranges: Array, x: Array, y: Array, dx: Array, dy: Array) -> tuple[Array, Array]:
        """Return the least range of each ray, (n,), and its angle to the normal of that wall."""
        if not ranges.shape[1]:
            return np.full(len(ranges), np.inf), np.full(len(ranges), np.nan)
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
        """Return the distance of points (n, 2) to the nearest wall, (n,) in metres; inf where there is no wall."""
        x, y = xy_m[:, :1], xy_m[:, 1:]
        walls_m = np.hstack((_to_segments(self.segments, x, y), _to_arcs(self.arcs, x, y)))
        return np.asarray(walls_m.min(axis=1, initial=np.inf))

    def least_clearance_m(self, from_xy_m: Array, to_xy_m: Array) -> float:
        """Return the least distance of the straight path between two points (2,) to a wall, exact; 0 if they cross."""
        along = to_xy_m - from_xy_m
        length_m = np.hypot(*along)
        met_m, _ = self.cast(from_xy_m, np.arctan2(along[1:], along[:1]))
        if met_m[0] <= length_m:
            return 0.0
        # Else it is at an end of the path, at an end of a wall, or at the path's nearest point to the centre of an arc.
        share = np.clip((self.arcs[:, :2] - from_xy_m) @ along / max(length_m**2, np.finfo(np.float64).tiny), 0.0, 1.0)
        on_path = np.vstack((from_xy_m, to_xy_m, from_xy_m + share[:, None] * along))
        cx, cy, radius, start, sweep = self.arcs.T
        bearings = np.concatenate((start, start + sweep))
        turned = np.tile((cx, cy), 2) + np.tile(radius, 2) * (np.cos(bearings), np.sin(bearings))
        ends = np.vstack((self.segments.reshape(-1, 2), turned.T))
        beside = _to_segments(np.array([[*from_xy_m, *to_xy_m]]), ends[:, :1], ends[:, 1:])
        return float(min(self.clearance_m(on_path).min(), beside.min(initial=np.inf)))

    def seen_from(self, world_T_frame: Pose) -> World:
        """Return the walls in another frame."""
        frame_T_world = world_T_frame.inverse()
        ends = transform_points(frame_T_world, self.segments.reshape(-1, 2)).reshape(-1, 4)
        centres = transform_points(frame_T_world, self.arcs[:, :2])
        arcs = np.column_stack((centres, self.arcs[:, 2], self.arcs[:, 3] + frame_T_world.yaw_rad, self.arcs[:, 4]))
        plates = self.plates.copy()
        plates[:, :2] = transform_points(frame_T_world, plates[:, :2])
        plates[:, 4] += frame_T_world.yaw_rad
        return World(ends, arcs, self.heights_m, plates)

    def slice(self, low_m: float, high_m: float) -> World:
        """Return the walls that reach into a slice of height, as walls from the floor to above everything.

        All walls of the world have heights.
        """
        met = (self.heights_m[:, 0] < high_m) & (self.heights_m[:, 1] > low_m)
        n = len(self.segments)
        return World(self.segments[met[:n]], self.arcs[met[n:]])

    def distance_m(self, xy_m: Array) -> Array:
        """Return the distance of points (n, 2) to the nearest wall or bounded plate as seen from above, (n,) in m."""
        plates = self.plates[np.isfinite(self.plates[:, 2])]
        beside = _beside_plates(plates, xy_m[:, :1], xy_m[:, 1:]).min(axis=1, initial=np.inf)
        return np.asarray(np.minimum(self.clearance_m(xy_m), np.maximum(beside, 0.0)))

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


def _rays(xy_m: Array | tuple[float, float], bearings_rad: Array) -> tuple[Array, Array, Array, Array]:
    """Return beginnings x, y and directions dx, dy of level rays, (n, 1) each."""
    x, y = np.broadcast_to(np.asarray(xy_m, dtype=np.float64), (len(bearings_rad), 2)).T[:, :, None]
    return x, y, np.cos(bearings_rad)[:, None], np.sin(bearings_rad)[:, None]


def _meet_plates(plates: Array, x: Array, y: Array, dx: Array, dy: Array, from_m: Array, rise: Array) -> Array:
    """Return the level ranges of n rays to the nearest of p plates, (n,); inf where they miss all."""
    with np.errstate(divide="ignore", invalid="ignore"):  # a level ray meets none
        r = (plates[:, 6] - from_m) / rise
        beside = _beside_plates(plates, x + r * dx, y + r * dy)
    nearest: Array = np.where((r > 0.0) & np.isfinite(r) & (beside <= 0.0), r, np.inf).min(axis=1, initial=np.inf)
    return nearest


def _beside_plates(plates: Array, x: Array, y: Array) -> Array:
    """Distances of points, (n, 1) or (n, p), from the edges of p plates as seen from above, (n, p); inside negative."""
    cx, cy, length, width, yaw, margin, _ = plates.T
    c, s = np.cos(yaw), np.sin(yaw)
    u, v = np.abs(c * (x - cx) + s * (y - cy)), np.abs(c * (y - cy) - s * (x - cx))
    u, v = u - 0.5 * length, v - 0.5 * width
    beside: Array = np.hypot(np.maximum(u, 0.0), np.maximum(v, 0.0)) + np.minimum(np.maximum(u, v), 0.0) - margin
    return beside


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
    return np.asarray(np.hypot(ax - u * ex, ay - u * ey))


def _to_arcs(arcs: Array, x: Array, y: Array) -> Array:
    """Distances of n points (columns) to m arcs, (n, m): across the arc within its sweep, else to its nearer end."""
    cx, cy, radius, start, sweep = arcs.T
    ends = [np.hypot(x - cx - radius * np.cos(end), y - cy - radius * np.sin(end)) for end in (start, start + sweep)]
    within = _on_arc(np.arctan2(y - cy, x - cx), start, sweep)
    distance: Array = np.where(within, np.abs(np.hypot(x - cx, y - cy) - radius), np.minimum(*ends))
    return distance
