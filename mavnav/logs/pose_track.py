"""Poses in a log: of a body as they came, and of a frame by the transforms as tf2 looks them up, interpolated."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.errors import TopicError
from mavnav.logs.log import Log
from mavnav.logs.messages.columns import merge
from mavnav.logs.messages.records import Poses
from mavnav.logs.stamps import MessageTrack, clock_of, in_order, shift_s
from mavnav.logs.transforms import Edge, FrameTree, frame_name, planar, planar_poses, shortest_way
from mavnav.pose import Pose, Trajectory, between
from mavnav.units import NS

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

    def trajectory(self, log: Log, warn: Callable[[str], None]) -> tuple[Trajectory, float]:
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

    def paths(self, log: Log, warn: Callable[[str], None]) -> list[Transfer]:
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

    def trajectory(self, log: Log, warn: Callable[[str], None]) -> tuple[Trajectory, float]:
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
