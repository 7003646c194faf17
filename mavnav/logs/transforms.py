"""The tree of frames in a log: where the laser sits on the vehicle (REP-105, tf2)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from math import atan2, cos, isfinite, radians
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.logs.messages.columns import merge_by
from mavnav.logs.messages.records import Poses, TransformMessage
from mavnav.logs.namespaces import is_of_another_robot, namespace
from mavnav.pose import Pose, yaw_of_quaternion
from mavnav.units import LARGEST_COORDINATE_M

Edge = tuple[str, str]
"""Parent and child."""

BASE_FRAMES = ("base_link", "base_footprint")

_SAME = 1e-6
_WOBBLE_M, _WOBBLE = 0.005, 0.01
"""Differences of a mounting that is measured again and again, as by the encoder of a locked joint: m, and of axes."""

_LIMITS = np.pad(np.full((3, 3), _WOBBLE), ((0, 1), (0, 1)), constant_values=_WOBBLE_M)
_UPRIGHT = cos(radians(10.0))


def frame_name(name: str) -> str:
    """Drop the leading slash of tf1."""
    return name.lstrip("/")


def matrix_of(xyz: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return ``parent_T_child`` as (4, 4); None where it is not finite, too far, or its quaternion is zero."""
    norm = float(np.linalg.norm(q))
    if not (np.abs(xyz).max() <= LARGEST_COORDINATE_M and np.isfinite(norm) and norm > _SAME):
        return None
    x, y, z, w = q / norm
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = xyz
    return matrix


def planar_pose(message: TransformMessage) -> Pose | None:
    """Return x, y and yaw of a transform; None where they are not finite, or too far."""
    x, y, _ = message.xyz
    yaw = yaw_of_quaternion(*message.xyzw)
    near = abs(x) <= LARGEST_COORDINATE_M and abs(y) <= LARGEST_COORDINATE_M  # False for NaN, too
    return Pose(x, y, yaw) if near and isfinite(yaw) and any(message.xyzw) else None


def planar_poses(poses: Poses) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return what `planar_pose` does of many, (n, 3), and which have one, (n,)."""
    (px, py, _), (x, y, z, w) = poses.xyz, poses.xyzw
    with np.errstate(invalid="ignore", over="ignore"):
        sines, cosines = 2.0 * (w * z + x * y), w * w + x * x - y * y - z * z
    yaw_rad = np.fromiter(map(atan2, sines.tolist(), cosines.tolist()), np.float64, len(px))  # np.arctan2 rounds else
    near = (np.abs(px) <= LARGEST_COORDINATE_M) & (np.abs(py) <= LARGEST_COORDINATE_M)
    return np.column_stack((px, py, yaw_rad)), near & np.isfinite(yaw_rad) & poses.xyzw.any(axis=0)


def _matrices(poses: Poses) -> Iterator[NDArray[np.float64]]:
    """Yield the matrices of poses that differ from the one before."""
    rows = np.vstack((poses.xyz, poses.xyzw)).T.copy()
    new = np.concatenate(([True], (rows[1:] != rows[:-1]).any(axis=1)))
    matrices = (matrix_of(row[:3], row[3:]) for row in rows[new])
    return (matrix for matrix in matrices if matrix is not None)


class FrameTree(Struct):
    """Transforms met in a log: ``static`` ones (the last counts), and those of /tf, noted if they ``changed``.

    ``first_static`` are the static ones as they were first.
    """

    static: dict[Edge, NDArray[np.float64]] = field(default_factory=dict)
    first_static: dict[Edge, NDArray[np.float64]] = field(default_factory=dict)
    moving: dict[Edge, NDArray[np.float64]] = field(default_factory=dict)
    changed: set[Edge] = field(default_factory=set)

    def add(self, parts: Iterable[Poses], *, static: bool) -> None:
        """Take in transforms."""
        for edge, poses in merge_by(parts, lambda part: (frame_name(part.parent), frame_name(part.child))).items():
            if static:
                for matrix in _matrices(poses):
                    self.static[edge] = matrix
                    self.first_static.setdefault(edge, matrix)
            elif edge not in self.changed and any(
                (np.abs(self.moving.setdefault(edge, matrix) - matrix) > _LIMITS).any() for matrix in _matrices(poses)
            ):
                self.changed.add(edge)

    @property
    def still(self) -> dict[Edge, NDArray[np.float64]]:
        """The transforms that do not move: the static ones, and the constant ones of /tf."""
        return {edge: matrix for edge, matrix in self.moving.items() if edge not in self.changed} | self.static

    def find(self, base: str, laser: str) -> NDArray[np.floating] | None:
        """Return ``base_T_laser`` (4, 4) by the static transforms, and the constant ones of /tf if need be."""
        direct = _chain(self.static, base, laser)
        return direct if direct is not None else _chain(self.still, base, laser)

    def moves(self, base: str, laser: str) -> bool:
        """Return whether transforms lead from the base to the laser, but change."""
        return self.find(base, laser) is None and _chain({**self.moving, **self.static}, base, laser) is not None

    def contradicts(self, base: str, laser: str) -> bool:
        """Return whether the static transforms as they were first give another ``base_T_laser`` than the last."""
        first, last = (_chain(edges, base, laser) for edges in (self.first_static, self.static))
        return first is not None and last is not None and not np.allclose(first, last, atol=_SAME, rtol=0.0)

    def bases(self, laser: str) -> list[str]:
        """Return the frames that a base may have: ``BASE_FRAMES``, and those in namespaces, the laser's first."""
        space = namespace(frame_name(laser))
        frames = {frame for edge in (*self.static, *self.moving) for frame in edge}
        named = [frame for frame in frames if "/" in frame and frame.rsplit("/", 1)[-1] in BASE_FRAMES]
        return [*BASE_FRAMES, *sorted(named, key=lambda f: (namespace(f) != space, not f.endswith(BASE_FRAMES[0]), f))]

    def including(self, other: FrameTree) -> FrameTree:
        """Return the transforms of both; those of the other count where they differ."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in self.__struct_fields__)
        return FrameTree(*(a | b for a, b in pairs))


def transforms_for(trees: dict[str, FrameTree], topic: str, scan_topics: Iterable[str]) -> FrameTree:
    """Return the transforms for the laser of a topic, of the trees by the namespace of their topics.

    They are those of its robot: of its own namespace or one around it. Without a namespace of its own, all count that
    are not of another of the ``scan_topics``.
    """
    names = {f"{space}/tf": tree for space, tree in trees.items()}
    own = {name: tree for name, tree in names.items() if topic.startswith(f"{namespace(name)}/")}
    others = [*scan_topics]
    near = {name: tree for name, tree in names.items() if not is_of_another_robot(name, topic, others)}
    tree = FrameTree()
    for each in (own if any(map(namespace, own)) else near).values():
        tree = tree.including(each)
    return tree


def shortest_way(edges: Iterable[Edge], start: str, end: str) -> list[tuple[Edge, bool]] | None:
    """Return the shortest way between two frames, each step with whether it leads to the parent; None without one."""
    neighbours: dict[str, list[tuple[str, Edge, bool]]] = {}
    for parent, child in edges:
        neighbours.setdefault(parent, []).append((child, (parent, child), False))
        neighbours.setdefault(child, []).append((parent, (parent, child), True))
    way: dict[str, list[tuple[Edge, bool]]] = {start: []}
    queue = deque([start])
    while queue and end not in way:
        frame = queue.popleft()
        for other, edge, upwards in neighbours.get(frame, []):
            if other not in way:
                way[other] = [*way[frame], (edge, upwards)]
                queue.append(other)
    return way.get(end)


def _chain(edges: dict[Edge, NDArray[np.float64]], base: str, laser: str) -> NDArray[np.floating] | None:
    """Return ``base_T_laser`` by the shortest way between the two."""
    way = shortest_way(edges, base, laser)
    base_T_laser: NDArray[np.floating] = np.eye(4)
    for edge, upwards in way or ():
        base_T_laser = base_T_laser @ (np.linalg.inv(edges[edge]) if upwards else edges[edge])
    return None if way is None else base_T_laser


def planar(matrix: NDArray[np.floating]) -> Pose:
    """Return x, y and the direction of the x axis of a transform (4, 4)."""
    return Pose(float(matrix[0, 3]), float(matrix[1, 3]), atan2(matrix[1, 0], matrix[0, 0]))


class Mounting(NamedTuple):
    """Where the laser sits: ``base_T_laser`` projected to the plane, with z up and the laser's own x axis."""

    base_frame: str
    base_T_laser: Pose
    upside_down: bool


def mounting(
    tree: FrameTree, laser_frame: str, base_frames: Iterable[str], warn: Callable[[str], None]
) -> Mounting | None:
    """Return how the laser is mounted on the first base frame that leads to it."""
    laser = frame_name(laser_frame)
    for base in base_frames:
        matrix = tree.find(frame_name(base), laser)
        if matrix is not None:
            if abs(matrix[2, 2]) < _UPRIGHT:
                warn(f"the transforms say that the laser ({laser}) is tilted; its scans are used as if it were level")
            return Mounting(frame_name(base), planar(matrix), bool(matrix[2, 2] < 0.0))
    return None
