"""The tree of frames in a log, where the laser sits on the vehicle (REP-105, tf2), and poses of bodies and frames.

Poses are those of a body as they came, or those of a frame by the transforms as tf2 looks them up, interpolated.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterable, Iterator
from math import atan2, cos, isfinite, radians
from typing import Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.errors import TopicError
from mavnav.logs.log import Log
from mavnav.logs.messages.definitions import Poses, TransformMessage
from mavnav.logs.messages.fast_cdr import merge, merge_by
from mavnav.logs.records import Warn, is_of_another_robot, namespace
from mavnav.logs.stamps import MessageTrack, clock_of, in_order, shift_s
from mavnav.pose import Pose, Trajectory, between, yaw_of_quaternion
from mavnav.units import LARGEST_COORDINATE_M, NS

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


def mounting(tree: FrameTree, laser_frame: str, base_frames: Iterable[str], warn: Warn) -> Mounting | None:
    """Return how the laser is mounted on the first base frame that leads to it."""
    laser = frame_name(laser_frame)
    for base in base_frames:
        matrix = tree.find(frame_name(base), laser)
        if matrix is not None:
            if abs(matrix[2, 2]) < _UPRIGHT:
                warn(f"the transforms say that the laser ({laser}) is tilted; its scans are used as if it were level")
            return Mounting(frame_name(base), planar(matrix), bool(matrix[2, 2] < 0.0))
    return None


TF_PREFIX: Final = "tf:"
"""Begins the name of poses that are those of a frame: ``tf:MAP,FRAME``, or ``tf:MAP`` for the frame of the scans."""

_ANY_GAP_NS: Final = 1 << 62
"""Transforms are interpolated over gaps of any length, as by tf2: those of a SLAM system may be sent at each update."""


class PoseTrack(MessageTrack):
    """Poses of a body, that of the ``frame``, in a fixed frame, as they came: 40 bytes each, with both stamps.

    Those of a path came in one message, so that the time of recording says nothing about their clock. Those of odometry
    are of odometry messages or of transforms, by their ``source``.
    """

    numbers: array[float] = field(default_factory=lambda: array("d"))
    unusable: int = 0
    is_path: bool = False
    source: Literal["odom", "tf"] = "odom"

    def add(self, poses: Poses) -> None:
        """Take in poses; those that are not finite, or have no orientation, are only counted."""
        xyyaw, usable = planar_poses(poses)
        self.unusable += int((~usable).sum())
        self.extend(poses.stamps_ns[usable], poses.log_ns[usable], xyyaw[usable])

    def trajectory(self, log: Log, warn: Warn) -> tuple[Trajectory, float]:
        """Return ``fixed_T_base`` by the clock of the scans, and the time that was added to its stamps for it, s.

        Poses whose stamps do not ascend are left out. Stamps that are no times give way to those of recording.
        """
        stamps, recorded = self.stamps.by(log.stamp_source)
        poses = self.rows(3)
        if self.unusable:
            text = f"{self.unusable} of {self.unusable + len(stamps)} poses are left out, not finite, beyond 10^8 m"
            warn(f"{self.topic}: {text} or with a quaternion of zeros; see what publishes them")
        if log.clock and len(stamps) > 1 and not np.ptp(stamps):
            warn(f"{self.topic}: its stamps never change; the times of recording are used: see what publishes it")
            stamps = recorded + round(log.clock.ahead_s / NS)
        keep = in_order(stamps, recorded, self.topic, warn)
        added_s = (
            0.0 if self.is_path else shift_s(clock_of(stamps[keep], recorded[keep]), log.clock, 2.0 * log.mid_sweep_s)
        )
        if added_s:
            ahead = "ahead of" if added_s < 0.0 else "behind"
            text = f"{abs(added_s):.2f} s {ahead} those of the scans, by the times of recording, and corrected by that"
            warn(f"{self.topic}: its stamps are {text}: synchronize the clocks")
        return Trajectory(stamps[keep] + round(added_s / NS), poses[keep]), added_s


def add_poses(tracks: dict[str, PoseTrack], topic: str, parts: list[Poses]) -> None:
    """Take in messages of one pose each, of a topic."""
    poses = merge(parts)
    tracks.setdefault(topic, PoseTrack(topic, frame_name(poses.child))).add(poses)


class FramePoses(Struct):
    """The poses of ``frame`` in another frame; ``moving`` are all transforms that were met, by parent and child.

    ``topic`` is the name as it was given. It stands in for a `PoseTrack`.
    """

    topic: str
    frame: str
    frames: FrameTree
    moving: dict[Edge, PoseTrack] = field(default_factory=dict)

    @property
    def names(self) -> set[str]:
        """The frames of the log."""
        return {frame for edge in (*self.moving, *self.frames.still) for frame in edge}

    @property
    def fixed_frame(self) -> str:
        """The frame of the poses: without a name that from which all others above the body hang."""
        if name := frame_name(self.topic.removeprefix(TF_PREFIX).partition(",")[0]):
            return name
        parents, root = {child: parent for parent, child in (*self.frames.still, *self.moving)}, self.frame
        while root in parents:
            root = parents.pop(root)
        return root

    def paths(self, log: Log, warn: Warn) -> list[Transfer]:
        """Return the transforms on the way from the fixed frame to the body; raises TopicError without one."""
        still, fixed = self.frames.still, self.fixed_frame
        steps = shortest_way([*self.moving, *still], fixed, self.frame)
        if steps is None:
            known = ", ".join(sorted(self.names)) or "none"
            raise TopicError(f"no transforms lead from {fixed!r} to {self.frame!r}; frames of the log: {known}")
        return [
            Transfer(planar(still[edge]) if edge in still else self.moving[edge].trajectory(log, warn)[0], upwards)
            for edge, upwards in steps
        ]

    def trajectory(self, log: Log, warn: Warn) -> tuple[Trajectory, float]:
        """Return ``fixed_T_base`` at the stamps of the fastest of the transforms between; raises TopicError."""
        steps = self.paths(log, warn)
        moving = (step.path.stamps_ns for step in steps if isinstance(step.path, Trajectory))
        stamps_ns = max(moving, key=len, default=np.zeros(0, np.int64))
        poses = follow(steps, stamps_ns)
        known = np.isfinite(poses[:, 0])
        return Trajectory(stamps_ns[known], poses[known]), 0.0


class Transfer(NamedTuple):
    """A transform from a frame to the next, over time or constant; ``upwards`` from a child to its parent."""

    path: Trajectory | Pose
    upwards: bool


def follow(steps: list[Transfer], stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the poses (n, 3) at the end of transforms at times (n,); NaN where one of them is not known."""
    poses = np.zeros((len(stamps_ns), 3))
    for path, upwards in steps:
        if isinstance(path, Trajectory):
            step = path.poses_at(stamps_ns, _ANY_GAP_NS)
        else:
            step = np.tile(path.as_array(), (len(stamps_ns), 1))
        poses = between(_inverse(poses), _inverse(step) if upwards else step)
    return poses


def _inverse(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return between(poses, np.zeros_like(poses))
