"""Doubled walls: a wall drawn twice because the poses of two visits disagree, found by the scans of a run.

Two scans are compared in three steps. The beams of one pass through a wall that the other saw: a visibility conflict.
Near its given pose there is a pose at which their walls coincide. At that pose the conflicts are gone. Moving things,
glass and clutter cause conflicts as well, but there is no other pose that explains the whole scan. A sweep in a fast
turn is skewed, and another pose explains a part of its view: it is not compared. Definition: docs/metrics.md.
"""

from __future__ import annotations

from math import tau
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.kernels.walls.scan_pairs import best_alignments, wall_gaps, wall_normals
from mavnav.metrics.ghost_walls import GhostWall, GhostWalls, as_ghost_walls
from mavnav.metrics.journey import PlacedScans, spread, used_beams
from mavnav.metrics.walls import Array, fit_line, link, members
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec
from mavnav.units import DEG, MM, NS

LEAST_OFFSET_M, MAX_OFFSET_M = 0.08, 1.15
"""Least and greatest distance of two copies of a wall, with a margin to the documented 0.1 to 1 m."""

KEY_STEP_M, KEY_TURN_RAD, MOST_KEYS = 0.1, 10.0 * DEG, 1500
"""Distance and turn, added as shares, between key scans, and the maximum number of these, evenly spread."""

MOST_SKEWED_RAD: Final = 2.0 * DEG
"""Largest turn during the sweep of a key scan: half of it moves what is 4 m away by 70 mm."""

PARTNERS, PARTNER_SHARE = 8, 0.75
"""Maximum number of earlier scans, evenly spread, per key scan, and their largest distance as a share of the range."""

POINTS: Final = 100
LEAST_POINTS, LEAST_DOUBLED, LEAST_DOUBLED_SHARE = 30, 6, 0.06
"""Minimum number of wall points that two conflicting scans share, and minimum number and share of doubled ones."""

ALIGNED_SHARE, LEAST_ALIGNED = 0.25, 100
"""Number of conflicting pairs that are aligned, evenly spread: as a share of the key scans, and its minimum."""

REACH_STEPS: Final = 12
"""Reach of the search for an alignment in steps of 0.1 m: 1.2 m; in rotation it is 6 degrees."""

LEAST_AGREEING, LEAST_GAIN, MOST_THROUGH, MOST_THROUGH_LEFT = 0.6, 0.1, 0.06, 0.35
"""Bounds for an alignment that explains a conflict.

The first is the minimum share of agreeing points among those that both scans see, the second its minimum increase. The
others are the maximum of the remaining conflicts, as a share of those points and of the conflicts before.
"""

LEAST_PAIRS, LEAST_SCANS, LEAST_LENGTH_M = 8, 4, 0.3
LEAST_EXPLAINED, MOST_SHARED = 0.5, 0.2
"""Minimum numbers of explained pairs and of scans of either copy, and minimum length, of a doubled wall.

Then the minimum share of explained pairs among its conflicting ones, and the maximum share of the scans of one copy
that saw the other copy as well.
"""

REACH_M, ACROSS_M, TURN_RAD, ALONG_M = 0.15, 0.08, 12.0 * DEG, 0.06


class _Keys(Struct, frozen=True):
    """Key scans: stamps (n,), poses (n, 3), ranges (n, beams), the walls' normals (n, beams, 2), and the geometry."""

    stamps_ns: NDArray[np.int64]
    poses: Array
    ranges_m: Array
    normals: Array
    directions: Array
    beams: Array

    @property
    def every(self) -> int:
        """Step between the beams that give points."""
        return max(1, len(self.directions) // POINTS)


class _Doubled(Struct, frozen=True):
    """Points of the front copy, (n,) each: ``xy_m`` (n, 2), direction of the wall, offset of the rear copy.

    ``pair`` is the number of the pair of scans, ``explained`` whether an alignment explains its conflict; ``front`` and
    ``rear`` are the key scans that saw the front and the rear copy.
    """

    xy_m: Array
    direction_rad: Array
    offset_m: Array
    pair: NDArray[np.int64]
    explained: NDArray[np.bool_]
    front: NDArray[np.int64]
    rear: NDArray[np.int64]


def key_rows(trajectory: Trajectory) -> NDArray[np.intp]:
    """Return the rows of a trajectory whose scans `doubled_walls` compares."""
    steps = np.diff(trajectory.xyyaw, axis=0, prepend=trajectory.xyyaw[:1])
    turn_rad = np.abs(np.angle(np.exp(1j * steps[:, 2])))
    moved = np.cumsum(np.hypot(steps[:, 0], steps[:, 1]) / KEY_STEP_M + turn_rad / KEY_TURN_RAD)
    rows = np.unique(np.floor(moved), return_index=True)[1]
    return rows[spread(len(rows), MOST_KEYS)]


def doubled_walls(trajectory: Trajectory, scans: PlacedScans, cell_m: float) -> GhostWalls:
    """Return the doubled walls of a run; ``scans`` include those of `key_rows`, ``cell_m`` is the map's cell size."""
    keys = _keys(trajectory, scans)
    pairs = _pairs(keys)
    b_T_a = _between(keys.poses, pairs)
    points, _, _, doubled = _count(keys, pairs, b_T_a).T
    conflict = (points >= LEAST_POINTS) & (doubled >= np.maximum(LEAST_DOUBLED, LEAST_DOUBLED_SHARE * points))
    tested = np.flatnonzero(conflict)
    tested = tested[spread(len(tested), max(LEAST_ALIGNED, int(ALIGNED_SHARE * len(keys.poses))))]
    if not len(tested):
        return as_ghost_walls((), cell_m)
    doubled_points = _doubled_points(keys, np.ascontiguousarray(pairs[tested]), b_T_a[tested])
    return as_ghost_walls(_places(doubled_points, keys), cell_m)


def _keys(trajectory: Trajectory, scans: PlacedScans) -> _Keys:
    spec = scans.spec
    beams = used_beams(spec)
    keys = key_rows(trajectory)
    keys_ns = trajectory.stamps_ns[keys[_skews_rad(trajectory, spec)[keys] <= MOST_SKEWED_RAD]]
    rows = np.flatnonzero(np.isin(scans.stamps_ns, keys_ns))  # some may be left out
    ranges_m = np.ascontiguousarray(scans.ranges_m[rows])
    return _Keys(
        stamps_ns=scans.stamps_ns[rows],
        poses=scans.poses[rows],
        ranges_m=ranges_m,
        normals=wall_normals(ranges_m, spec.directions, np.array([beams.near_m, beams.far_m])),
        directions=spec.directions,
        beams=np.array(beams),
    )


def _skews_rad(trajectory: Trajectory, spec: LaserSpec) -> Array:
    """Return by how much the laser turns during each sweep, (n,); a turn of it takes the stated time, or a period."""
    elapsed_s = np.diff(trajectory.stamps_ns) * NS
    if not len(elapsed_s) or not spec.angle_step_rad:
        return np.zeros(len(trajectory))
    period_s = float(np.median(elapsed_s))
    turn_s = spec.stated_turn_s if spec.has_plausible_sweep(period_s) else spec.usual_turn_s(period_s)
    rates = np.diff(np.unwrap(trajectory.xyyaw[:, 2])) / elapsed_s
    rate = np.abs([np.append(rates, rates[-1]), np.append(rates[0], rates)]).max(axis=0)
    return np.asarray(rate * turn_s * spec.field_of_view_rad / tau)


def _pairs(keys: _Keys) -> NDArray[np.int64]:
    """Return pairs (n, 2) of every key scan with earlier ones near it, evenly spread over the run."""
    pairs, xy_m, far_m = [np.zeros((0, 2), np.int64)], keys.poses[:, :2], PARTNER_SHARE * keys.beams[3]
    for k in range(len(xy_m)):
        near = np.flatnonzero(np.hypot(*(xy_m[:k] - xy_m[k]).T) < far_m)
        near = near[spread(len(near), PARTNERS)]
        pairs.append(np.column_stack((np.full(len(near), k), near)))
    return np.concatenate(pairs)


def _between(poses: Array, pairs: NDArray[np.int64]) -> Array:
    """Return the poses b_T_a (n, 3) of the first scans of pairs in the frames of the second ones."""
    (ax, ay, a_yaw), (bx, by, b_yaw) = poses[pairs[:, 0]].T, poses[pairs[:, 1]].T
    c, s = np.cos(b_yaw), np.sin(b_yaw)
    return np.column_stack((c * (ax - bx) + s * (ay - by), c * (ay - by) - s * (ax - bx), a_yaw - b_yaw))


def _inverse(b_T_a: Array) -> Array:
    (x, y, yaw), (c, s) = b_T_a.T, (np.cos(b_T_a[:, 2]), np.sin(b_T_a[:, 2]))
    return np.column_stack((-c * x - s * y, s * x - c * y, -yaw))


def _gaps(keys: _Keys, pairs: NDArray[np.int64], b_T_a: Array) -> Array:
    """Return the gaps (n, points) of `wall_gaps`."""
    pairs, b_T_a = np.ascontiguousarray(pairs), np.ascontiguousarray(b_T_a)
    return wall_gaps(keys.ranges_m, keys.normals, pairs, b_T_a, keys.directions, keys.beams, keys.every)


def _is_doubled(gaps_m: Array) -> NDArray[np.bool_]:
    """Return where beams pass through a wall that has a parallel one behind it."""
    return (gaps_m >= LEAST_OFFSET_M) & (gaps_m <= MAX_OFFSET_M)


def _count(keys: _Keys, pairs: NDArray[np.int64], b_T_a: Array) -> NDArray[np.int64]:
    """Return the wall points of pairs (n, 4): number seen by both, agreeing, passed through, and doubled."""
    counts = np.zeros((len(pairs), 4), np.int64)
    for ab, motion in ((pairs, b_T_a), (pairs[:, ::-1], _inverse(b_T_a))):
        gaps_m = _gaps(keys, ab, motion)
        marks = (~np.isnan(gaps_m), gaps_m == 0.0, gaps_m > 0.0, _is_doubled(gaps_m))
        counts += np.column_stack([np.count_nonzero(mark, axis=1) for mark in marks])
    return counts


def _doubled_points(keys: _Keys, pairs: NDArray[np.int64], b_T_a: Array) -> _Doubled:
    """Return the doubled points of conflicting pairs.

    Of a pair that an alignment explains these are all points that it moves, of another pair the points passed through.
    """
    better = best_alignments(keys.ranges_m, pairs, b_T_a, keys.directions, keys.beams[2:].copy(), REACH_STEPS)
    explained = _is_explained(_count(keys, pairs, b_T_a), _count(keys, pairs, better))
    shift_m = np.where(_gaps(keys, pairs, better) == 0.0, _shifts(keys, pairs, b_T_a, better), 0.0)
    unexplained = np.where(explained[:, None], np.nan, 1.0)
    parts = (
        _points(keys, pairs, np.where(explained[:, None], shift_m, 0.0), explained),
        _points(keys, pairs, -unexplained * _gaps(keys, pairs, b_T_a), explained),
        _points(keys, pairs[:, ::-1], -unexplained * _gaps(keys, pairs[:, ::-1], _inverse(b_T_a)), explained),
    )
    names = _Doubled.__struct_fields__
    return _Doubled(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _shifts(keys: _Keys, pairs: NDArray[np.int64], b_T_a: Array, better: Array) -> Array:
    """Return by how much scan b saw the wall points of scan a nearer to the laser than a did, (n, points), m."""
    a, beams = pairs[:, :1], np.arange(0, keys.ranges_m.shape[1], keys.every)
    xy_m, normal = _ends(keys, a, beams), _rotate(b_T_a[:, None], keys.normals[a, beams])
    moved_m = _transform(better[:, None], xy_m) - _transform(b_T_a[:, None], xy_m)
    return np.asarray((normal * moved_m).sum(axis=-1))


def _points(keys: _Keys, pairs: NDArray[np.int64], shift_m: Array, explained: NDArray[np.bool_]) -> _Doubled:
    """Return the wall points of the first scans that the second ones saw elsewhere: ``shift_m`` towards the laser."""
    pair, number = np.nonzero(_is_doubled(np.abs(shift_m)))
    (a, b), beam, shift = pairs[pair].T, number * keys.every, shift_m[pair, number]
    normal = _rotate(keys.poses[a], keys.normals[a, beam])
    return _Doubled(
        xy_m=_transform(keys.poses[a], _ends(keys, a, beam)) + normal * np.maximum(shift, 0.0)[:, None],
        direction_rad=np.arctan2(normal[:, 0], -normal[:, 1]),
        offset_m=np.abs(shift),
        pair=pair,
        explained=explained[pair],
        front=np.where(shift < 0.0, a, b),
        rear=np.where(shift < 0.0, b, a),
    )


def _ends(keys: _Keys, scan: NDArray[np.int64], beam: NDArray[np.int64]) -> Array:
    """Return the end points of beams in the frames of the lasers, (..., 2) in m."""
    return keys.ranges_m[scan, beam][..., None] * keys.directions[beam]


def _transform(poses: Array, xy_m: Array) -> Array:
    """Transform points (..., 2) from the frames of poses (..., 3) to the frames in which these are given."""
    return _rotate(poses, xy_m) + poses[..., :2]


def _rotate(poses: Array, xy: Array) -> Array:
    """Turn vectors (..., 2) from the frames of poses (..., 3) to the axes of the frames in which these are given."""
    c, s, (x, y) = np.cos(poses[..., 2]), np.sin(poses[..., 2]), np.moveaxis(xy, -1, 0)
    return np.stack((c * x - s * y, s * x + c * y), axis=-1)


def _is_explained(before: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which alignments (n,) explain the conflicts of their pairs, by the counts of `_count` before and after."""
    (_, agreed, through, _), (_, agrees, left, _) = (seen.T / np.maximum(seen[:, 0], 1) for seen in (before, after))
    fits = (after[:, 0] >= LEAST_POINTS) & (agrees >= np.maximum(LEAST_AGREEING, agreed + LEAST_GAIN))
    return np.asarray(fits & (left <= np.minimum(MOST_THROUGH, MOST_THROUGH_LEFT * through)))


def _places(points: _Doubled, keys: _Keys) -> list[GhostWall]:
    """Link doubled points along their direction, and return the groups with enough evidence."""
    groups = link(points.xy_m, points.direction_rad, reach_m=REACH_M, across_m=ACROSS_M, turn_rad=TURN_RAD)
    places = []
    for group in members(groups):
        here = group[points.explained[group]]
        pairs, explained = (len(np.unique(points.pair[some])) for some in (group, here))
        front, rear = np.unique(points.front[here]), np.unique(points.rear[here])
        scans, shared = min(len(front), len(rear)), len(np.intersect1d(front, rear))
        if explained < max(LEAST_PAIRS, LEAST_EXPLAINED * pairs) or scans < LEAST_SCANS or shared > MOST_SHARED * scans:
            continue
        line = fit_line(points.xy_m[here], np.ones(len(here)), ALONG_M)
        if line.length_m >= LEAST_LENGTH_M:
            offset_mm = float(np.median(points.offset_m[here])) / MM
            stamps_ns = keys.stamps_ns - keys.stamps_ns.min()
            times_s = [float(np.median(stamps_ns[which])) * NS for which in (front, rear)]
            at = (line.x_m, line.y_m, line.direction_rad / DEG, line.length_m)
            places.append(GhostWall(*at, offset_mm, explained, *times_s))
    return places
