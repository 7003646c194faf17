"""Poses of a frame by the transforms of a log, as tf2 looks them up: static ones, and moving ones interpolated."""

from __future__ import annotations

from collections import deque
from math import atan2
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct, field

from mavnav.errors import TopicError
from mavnav.logs.transforms import frame_name
from mavnav.pose import Trajectory, between

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from mavnav.logs.log import Log
    from mavnav.logs.pose_track import PoseTrack
    from mavnav.logs.transforms import FrameTree

    Edge = tuple[str, str]

TF_PREFIX: Final = "tf:"
"""Begins the name of poses that are those of a frame: ``tf:MAP,FRAME``, or ``tf:MAP`` for the frame of the scans."""


_ANY_GAP_NS: Final = 1 << 62
"""Transforms are interpolated over gaps of any length, as by tf2: those of a SLAM system may be sent at each update."""


class FramePoses(Struct):
    """The poses of ``base_frame`` in another frame; ``moving`` are all transforms that were met, by parent and child.

    ``topic`` is the name as it was given. It stands in for a `PoseTrack`.
    """

    topic: str
    base_frame: str
    frames: FrameTree
    moving: dict[Edge, PoseTrack] = field(default_factory=dict)

    def trajectory(self, log: Log, warn: Callable[[str], None]) -> tuple[Trajectory, float]:
        """Return ``fixed_T_base`` at the stamps of the fastest of the transforms between; raises TopicError."""
        fixed = frame_name(self.topic.removeprefix(TF_PREFIX).partition(",")[0])
        still = {edge: m for edge, m in self.frames.moving.items() if edge not in self.frames.changed}
        still |= self.frames.static
        steps = _steps([*self.moving, *still], fixed, self.base_frame)
        if steps is None:
            known = ", ".join(sorted({frame for edge in (*self.moving, *still) for frame in edge})) or "none"
            raise TopicError(f"no transforms lead from {fixed!r} to {self.base_frame!r}; frames of the log: {known}")
        paths = {edge: self.moving[edge].trajectory(log, warn)[0] for edge, _ in steps if edge not in still}
        stamps_ns = max((path.stamps_ns for path in paths.values()), key=len, default=np.zeros(0, np.int64))
        poses = np.zeros((len(stamps_ns), 3))
        for edge, upwards in steps:
            if edge in still:
                m = still[edge]
                step = np.broadcast_to((m[0, 3], m[1, 3], atan2(m[1, 0], m[0, 0])), poses.shape)
            else:
                step = paths[edge].poses_at(stamps_ns, _ANY_GAP_NS)
            poses = between(_inverse(poses), _inverse(step) if upwards else step)
        known_rows = np.isfinite(poses[:, 0])
        return Trajectory(stamps_ns[known_rows], poses[known_rows]), 0.0


def _inverse(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return between(poses, np.zeros_like(poses))


def _steps(edges: list[Edge], start: str, end: str) -> list[tuple[Edge, bool]] | None:
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
