"""Poses of a body in a log, as they came."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Literal

import numpy as np
from msgspec import Struct, field

from mavnav.logs.log import Log
from mavnav.logs.messages.columns import merge
from mavnav.logs.messages.records import Poses
from mavnav.logs.stamps import Stamps, clock_of, in_order, shift_s
from mavnav.logs.transforms import frame_name, planar_poses
from mavnav.pose import Trajectory
from mavnav.units import NS


class PoseTrack(Struct):
    """Poses of a body, frame ``base_frame``, in a fixed frame, as they came: 40 bytes each, with both stamps.

    Those of a path came in one message, so that the time of recording says nothing about their clock. Those of odometry
    are of odometry messages or of transforms, by their ``source``.
    """

    topic: str
    base_frame: str
    stamps: Stamps = field(default_factory=Stamps)
    xyyaw: array[float] = field(default_factory=lambda: array("d"))
    unusable: int = 0
    is_path: bool = False
    source: Literal["odom", "tf"] = "odom"

    def add(self, poses: Poses) -> None:
        """Take in poses; those that are not finite, or have no orientation, are only counted."""
        xyyaw, usable = planar_poses(poses)
        self.unusable += int((~usable).sum())
        self.stamps.extend(poses.stamps_ns[usable], poses.log_ns[usable])
        self.xyyaw.frombytes(xyyaw[usable].tobytes())

    def trajectory(self, log: Log, warn: Callable[[str], None]) -> tuple[Trajectory, float]:
        """Return ``fixed_T_base`` by the clock of the scans, and the time that was added to its stamps for it, s.

        Poses whose stamps do not ascend are left out. Stamps that are no times give way to those of recording.
        """
        stamps, recorded = self.stamps.by(log.stamp_source)
        poses = np.array(self.xyyaw, dtype=np.float64).reshape(-1, 3)
        if self.unusable:
            text = f"{self.unusable} of {self.unusable + len(stamps)} poses are left out"
            warn(f"{self.topic}: {text}, not finite or with a quaternion of zeros; see what publishes them")
        if log.clock and len(stamps) > 1 and not np.ptp(stamps):
            warn(f"{self.topic}: its stamps never change; the times of recording are used: see what publishes it")
            stamps = recorded + round(log.clock.ahead_s / NS)
        keep = in_order(stamps, recorded, self.topic, warn)
        added_s = 0.0 if self.is_path else shift_s(clock_of(stamps[keep], recorded[keep]), log.clock)
        if added_s:
            ahead = "ahead of" if added_s < 0.0 else "behind"
            text = f"{abs(added_s):.2f} s {ahead} those of the scans, by the times of recording, and corrected by that"
            warn(f"{self.topic}: its stamps are {text}: synchronize the clocks")
        return Trajectory(stamps[keep] + round(added_s / NS), poses[keep]), added_s


def add_poses(tracks: dict[str, PoseTrack], topic: str, parts: list[Poses]) -> None:
    """Take in messages of one pose each, of a topic."""
    poses = merge(parts)
    tracks.setdefault(topic, PoseTrack(topic, frame_name(poses.child))).add(poses)
