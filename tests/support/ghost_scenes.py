"""Runs with known ghost walls, and runs without ghosts but with similar structures: scans and poses, from seeds.

``python -m support.ghost_scenes FIRST LAST`` (in tests/) prints what docs/notes/metrics-evidence.md sums up.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

import numpy as np
from msgspec import Struct

from mavnav.metrics.doubled_walls import doubled_walls
from mavnav.metrics.ghost_walls import GhostWall, GhostWalls
from mavnav.metrics.journey import PlacedScans
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec
from support.field_logs import cast_moving, poses_at
from support.synthetic import (
    DEG,
    LDS_01,
    TOUR,
    URG_04LX,
    Segments,
    along,
    box,
    cast,
    furnished_rooms,
    polyline,
    room,
    scan_at,
)

UST_10LX = LaserSpec(-135 * DEG, 0.5 * DEG, 541, 0.06, 10.0, 0.0, 0.1)
LMS_200 = LaserSpec(-90 * DEG, DEG, 181, 0.05, 30.0, 0.0, 0.2)
SENSORS = (URG_04LX, LDS_01, UST_10LX, LMS_200)


def sweeping(view_deg: float, beams: int, turn_s: float = 0.1, listed: int = 1, *, stated: bool = True) -> LaserSpec:
    """Return a laser that turns once in ``turn_s``; ``listed`` is the sign of the step between its beams."""
    step_rad = listed * view_deg * DEG / (beams - 1)
    time_s = turn_s * abs(step_rad) / (2 * np.pi) * stated
    return LaserSpec(-0.5 * step_rad * (beams - 1), step_rad, beams, 0.1, 12.0, time_s, turn_s)


SWEEPING = {
    "206 deg": sweeping(206, 240),
    "clockwise": sweeping(206, 240, listed=-1),
    "half a turn": sweeping(180, 181),
    "120 deg": sweeping(120, 160),
    "a full turn": sweeping(359, 360),
    "60 beams": sweeping(200, 60),
    "slow": sweeping(206, 240, 0.2),
    "unstated": sweeping(206, 240, stated=False),
    "reversed": sweeping(206, 240),
}
"""Lasers that move during their sweeps; those that are upside down list their beams clockwise."""
NOISE = (0.005, 0.01, 0.015, 0.003)
OFFSETS_M = (0.1, 0.2, 0.3, 0.5, 0.63, 0.8, 1.0)
LENGTH_M, WIDTH_M = 14.0, 2.2
Rng = np.random.Generator
Moving = Callable[[float], list[Segments]]


class Scene(Struct):
    """Walls, a path, moving walls as a function of the elapsed share of the run, and a glass pane."""

    walls: list[Segments]
    path: list[tuple[float, float]]
    moving: Moving = lambda _: []
    glass: Segments | None = None


def corridor(rng: Rng, width_m: float = WIDTH_M, recess_m: float = 0.12) -> Scene:
    """Return a corridor with recessed doors, with a path there and back."""

    def side(y: float, out: int) -> Segments:
        points, x = [(0.0, y)], rng.uniform(0.8, 1.6)
        while x + 0.9 < LENGTH_M - 0.5:
            points += [(x, y), (x, y + out * recess_m), (x + 0.9, y + out * recess_m), (x + 0.9, y)]
            x += rng.uniform(1.8, 3.4)
        return polyline(*points, (LENGTH_M, y))

    ends = [polyline((x, 0), (x, width_m)) for x in (0.0, LENGTH_M)]
    path = [(x, width_m * rng.uniform(0.4, 0.6)) for x in (1.0, 4.0, 8.0, 12.8, 12.7, 8.0, 4.0, 1.1)]
    return Scene([side(0.0, -1), side(width_m, 1), *ends], path)


def hall(rng: Rng, least_y_m: float = 0.8) -> Scene:
    """Return a hall of 8 x 6 m, with a path of two rounds."""
    corners = [tuple(c + rng.uniform(-0.2, 0.2, 2)) for c in [(1, 1), (7, 1), (7, 5), (1, 5)]]
    first = rng.integers(4)
    corners = (corners[first:] + corners[:first])[:: rng.choice([-1, 1])]
    return Scene([room(8.0, 6.0)], [(float(x), max(float(y), least_y_m)) for x, y in (*corners, *corners, corners[0])])


def hall_with_box(rng: Rng) -> Scene:
    scene = hall(rng)
    return Scene([*scene.walls, box(rng.uniform(3, 5), 3.0, 1.0, 0.6, rng.uniform(0, 3))], scene.path)


def rooms(_: Rng) -> Scene:
    """Return two furnished rooms, with a path of two rounds."""
    return Scene([furnished_rooms()], TOUR + TOUR[1:])


def narrow_corridor(rng: Rng) -> Scene:
    return corridor(rng, 1.8)


def door_frames(rng: Rng) -> Scene:
    return corridor(rng, recess_m=rng.uniform(0.05, 0.25))


def shelves(rng: Rng) -> Scene:
    """Return a corridor with shelves 0.1 to 0.5 m deep along one wall, and panels in front of the other."""
    scene = corridor(rng)
    for x in (2.0, 6.0, 10.0):
        deep = rng.uniform(0.1, 0.5)
        scene.walls.append(box(x + rng.uniform(0, 1), deep / 2 + rng.uniform(0, 0.05), rng.uniform(0.5, 1.5), deep))
        scene.walls.append(polyline((x + 1.2, WIDTH_M - 0.3), (x + 2.2, WIDTH_M - 0.3)))
    return Scene(scene.walls, [(x, float(np.clip(y, 1.1, 1.4))) for x, y in scene.path])


def open_rack(rng: Rng) -> Scene:
    """Return a hall with boards and posts 0.1 to 0.5 m in front of a wall, which is visible between them."""
    scene, y, x = hall(rng, 1.3), rng.uniform(0.1, 0.5), 1.5
    while x < 6.5:
        wide = rng.uniform(0.03, 0.3)
        scene.walls.append(box(x, y, wide, 0.02))
        x += wide + rng.uniform(0.1, 0.4)
    return scene


def legs(rng: Rng) -> Scene:
    """Return a hall with the legs of tables and chairs, in the middle and along its walls."""
    scene, seats = hall(rng, 1.2), [(x, 0.35) for x in (2, 4, 6)] + [(x, 5.6) for x in (2, 4, 6)]
    seats += [(rng.uniform(2, 6), rng.uniform(2, 4)) for _ in range(8)]
    scene.walls += [box(x + a, y + b, 0.04, 0.04) for x, y in seats for a in (-0.25, 0.25) for b in (-0.2, 0.2)]
    return Scene(scene.walls, [(x, min(y, 4.8)) for x, y in scene.path])


def partition(rng: Rng) -> Scene:
    """Return a hall with a partition 0.1 to 0.2 m thick, seen from both sides."""
    scene = hall(rng)
    scene.walls.append(box(4.0, 3.0, 4.5, rng.uniform(0.1, 0.2)))
    return scene


def moved_furniture(rng: Rng) -> Scene:
    """Return a hall with a cupboard in front of a wall that is removed after the first round."""
    scene, deep = hall(rng, 1.6), rng.uniform(0.3, 0.7)
    cupboard = box(4, deep / 2 + 0.02, rng.uniform(1.0, 3.0), deep)
    return Scene([*scene.walls, box(4, 3, 1, 0.6, 0.4)], scene.path, lambda over: [cupboard] if over < 0.5 else [])


def opened_doors(rng: Rng) -> Scene:
    """Return a corridor with closets 0.4 to 1 m deep, closed on the way there and open on the way back."""
    deep = rng.uniform(0.4, 1.0)
    gaps = [polyline((a, 0), (b, 0)) for a, b in [(0, 3), (4, 8), (9, LENGTH_M)]]
    closets = [polyline((x, 0), (x, -deep), (x + 1, -deep), (x + 1, 0)) for x in (3, 8)]
    rest = polyline((LENGTH_M, 0), (LENGTH_M, WIDTH_M), (0, WIDTH_M), (0, 0))
    doors = [polyline((x, 0), (x + 1, 0)) for x in (3, 8)]
    return Scene([*gaps, *closets, rest], corridor(rng).path, lambda over: doors if over < 0.5 else [])


def glass(rng: Rng) -> Scene:
    """Return a hall with a glass pane 0.15 to 0.8 m in front of a wall; it reflects steep beams at random."""
    scene, y = hall(rng, 1.5), rng.uniform(0.15, 0.8)
    return Scene(scene.walls, scene.path, glass=polyline((1.5, y), (6.5, y)))


def people(rng: Rng) -> Scene:
    """Return a hall with four walking people."""
    scene, speed, phases = hall(rng), rng.uniform(1, 4), rng.random(4)

    def moving(over: float) -> list[Segments]:
        turns = 2 * np.pi * (speed * over + phases)
        return [circle(4 + 3.4 * np.cos(a), 3 + 2.4 * np.sin(a), 0.18) for a in turns]

    return Scene([*scene.walls, box(4, 3, 1, 0.6, 0.4)], scene.path, moving)


def people_in_a_corridor(rng: Rng) -> Scene:
    scene, speed, phases = corridor(rng), rng.uniform(1, 3), rng.random(3)

    def moving(over: float) -> list[Segments]:
        ways = np.abs((speed * over + phases) % 1.0 * 2 - 1)
        return [circle(1 + 11.5 * way, 0.4 + 0.7 * k, 0.15 + 0.03 * k) for k, way in enumerate(ways)]

    return Scene(scene.walls, scene.path, moving)


def circle(x: float, y: float, radius: float) -> Segments:
    angles = np.linspace(0, 2 * np.pi, 11)[:-1]
    return polyline(*zip(x + radius * np.cos(angles), y + radius * np.sin(angles), strict=True), closed=True)


GHOSTS = {f.__name__: f for f in (narrow_corridor, rooms, hall_with_box)}
REAL = {
    f.__name__: f
    for f in (
        rooms, door_frames, shelves, open_rack, legs, partition, moved_furniture, opened_doors, glass, people,
        people_in_a_corridor,
    )
}  # fmt: skip


def placed(scene: Scene, seed: int, rng: Rng) -> PlacedScans:
    """Return scans along the path, with pose errors of 8 mm and 0.2 degrees (standard deviation)."""
    spec, poses = SENSORS[seed % 4], along(scene.path, period_s=0.2)
    ranges = [read(scene, poses, k, spec, NOISE[seed // 4 % 4], rng) for k in range(len(poses))]
    return PlacedScans(spec, poses.stamps_ns, poses.xyyaw + rng.normal(0, (0.008, 0.008, 0.2 * DEG), (len(poses), 3)),
                       np.array(ranges))  # fmt: skip


def read(scene: Scene, poses: Trajectory, k: int, spec: LaserSpec, noise: float, rng: Rng) -> np.ndarray:
    walls = np.vstack((*scene.walls, *scene.moving(k / (len(poses) - 1))))
    ranges_m = scan_at(walls, poses[k], spec, noise=noise, rng=rng).ranges_m
    if scene.glass is None:
        return ranges_m
    bearings = spec.angles_rad + poses[k].yaw_rad
    pane_m = cast(scene.glass, tuple(poses[k][:2]), bearings)
    chance = np.clip((np.abs(np.sin(bearings)) - 0.3) / 0.6, 0.0, 0.95)
    returned = (pane_m < ranges_m) & (rng.random(len(pane_m)) < chance)
    return np.where(returned, pane_m * (1 + noise * rng.standard_normal(len(pane_m))), ranges_m)


def swept(kind: str, seed: int) -> PlacedScans:
    """Return scans of a laser of `SWEEPING` in fast turns, with the poses at mid-sweep, off as in `placed`."""
    rng, spec, turn_rad_s = np.random.default_rng((seed, 3)), SWEEPING[kind], (2.3, 1.2, 1.7)[seed % 3]
    scene = (hall_with_box, shelves, rooms, legs, door_frames)[seed % 5](rng)
    path = along(scene.path, 0.02, 0.6, turn_rad_s)
    stamps_ns = np.arange(path.stamps_ns[0], path.stamps_ns[-1], round(spec.scan_time_s * 1e9))[:-1]
    late_ns = np.linspace(0.0, spec.scan_time_s * 1e9 * spec.field_of_view_rad / (2 * np.pi), spec.beams).astype(int)
    order, walls = late_ns[:: -1 if kind == "reversed" else 1], np.vstack(scene.walls)
    ranges = [cast_moving(walls, poses_at(path, stamp_ns + order), spec.angles_rad) for stamp_ns in stamps_ns]
    ranges_m = np.array(ranges) * (1 + NOISE[seed // 4 % 4] * rng.standard_normal((len(stamps_ns), spec.beams)))
    poses = poses_at(path, stamps_ns + late_ns[-1] // 2)
    poses += rng.normal(0, (0.008, 0.008, 0.2 * DEG), poses.shape)
    return PlacedScans(spec, stamps_ns, poses, np.where(ranges_m <= spec.range_max_m, ranges_m, np.nan))


class Shift(Struct):
    """Displacement of the poses of the second half: rotation about a point, then translation; m, rad."""

    about_m: np.ndarray
    step_m: np.ndarray
    yaw_rad: float

    def moved(self, xy_m: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return points (n, 2) moved by a share (n,) of the shift."""
        (x, y), yaw = (xy_m - self.about_m).T, share * self.yaw_rad
        turned = np.column_stack((np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y))
        return turned + self.about_m + share[:, None] * self.step_m

    def across_m(self, place: GhostWall) -> float:
        """Return the displacement of a wall along its normal, m."""
        at, angle = np.array([[place.x_m, place.y_m]]), np.radians(place.direction_deg)
        ((dx, dy),) = self.moved(at, np.ones(1)) - at
        return abs(np.cos(angle) * dy - np.sin(angle) * dx)

    def found_m(self, ghosts: GhostWalls) -> float:
        """Return the length of the ghost walls whose offset is correct to 50 mm or 10 %, m."""
        true_m = [self.across_m(place) for place in ghosts.places]
        right = [abs(p.offset_mm * 1e-3 - t) < max(0.05, 0.1 * t) for p, t in zip(ghosts.places, true_m, strict=True)]
        return sum(place.length_m for place, fits in zip(ghosts.places, right, strict=True) if fits)


def with_ghost(scans: PlacedScans, shift: Shift, sudden: bool) -> PlacedScans:
    """Shift the poses of the second half, suddenly or gradually over a tenth of the run."""
    n = len(scans.poses)
    share = np.clip((np.arange(n) / n - 0.45) / 0.1, 0.0, 1.0) if not sudden else (np.arange(n) >= n // 2) * 1.0
    poses = np.column_stack((shift.moved(scans.poses[:, :2], share), scans.poses[:, 2] + share * shift.yaw_rad))
    return PlacedScans(scans.spec, scans.stamps_ns, poses, scans.ranges_m)


def ghosts_of(scans: PlacedScans) -> GhostWalls:
    return doubled_walls(Trajectory(scans.stamps_ns, scans.poses), scans, 0.02)


def planted(kind: str, seed: int, offset_m: float) -> tuple[GhostWalls, float]:
    """Return the ghost walls found with this offset, across the corridor or along a wall of the room.

    Returns also the length of the ghost walls whose offset is correct, m.
    """
    rng = np.random.default_rng((seed, 1))
    scans, turn = placed(GHOSTS[kind](rng), seed, rng), int(rng.integers(4))
    along_rad = np.pi * (turn + 0.5) if kind == "narrow_corridor" else np.pi / 2 * turn
    step_m = offset_m * np.array([np.cos(along_rad), np.sin(along_rad)])
    shift = Shift(scans.poses[len(scans.poses) // 2, :2], step_m, rng.normal(0, 0.5 * DEG))
    ghosts = ghosts_of(with_ghost(scans, shift, sudden=seed % 2 == 0))
    return ghosts, shift.found_m(ghosts)


def honest(kind: str, seed: int) -> GhostWalls:
    if kind in SWEEPING:
        return ghosts_of(swept(kind, seed))
    rng = np.random.default_rng((seed, 2))
    return ghosts_of(placed(REAL[kind](rng), seed, rng))


def table(seeds: range) -> Iterator[str]:
    for kind in GHOSTS:
        for offset_m in OFFSETS_M:
            lengths_m = [planted(kind, seed, offset_m)[1] for seed in seeds]
            found = sum(length_m >= 1.0 for length_m in lengths_m)
            yield f"{kind}, {offset_m} m: found in {found} of {len(seeds)}, {np.median(lengths_m):.1f} m"
    for kind in (*REAL, *SWEEPING):
        reported = [ghosts.length_m for seed in seeds if (ghosts := honest(kind, seed)).count]
        yield f"{kind}: reported in {len(reported)} of {len(seeds)}, {sum(reported):.1f} m"


if __name__ == "__main__":
    for line in table(range(int(sys.argv[1]), int(sys.argv[2]))):
        print(line, flush=True)
