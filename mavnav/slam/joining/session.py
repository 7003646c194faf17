"""A session: the scans of one run and where they were taken, in a frame of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.loop_closure.key_frames import KeyFrame, key_rows
from mavnav.slam.motion_model import USUAL_PERIOD_S, Motion
from mavnav.slam.robust import Robust
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mavnav.config.models import Config
    from mavnav.pose import Trajectory
    from mavnav.scan import Scan


@dataclass(frozen=True, slots=True)
class Session:
    """Tracked scans, from the first one again at every call, their poses, a row each, and the key frames among them."""

    name: str
    scans: Callable[[], Iterable[Scan]]
    map_T_laser: Trajectory
    keys: tuple[KeyFrame, ...] = field(repr=False)

    @property
    def at_rest(self) -> Motion:
        """The motion before the first scan: the time between two scans alone is known."""
        steps_ns = np.diff(self.map_T_laser.stamps_ns)
        return Motion(float(np.median(steps_ns)) * NS if len(steps_ns) else USUAL_PERIOD_S)


def make_session(name: str, scans: Callable[[], Iterable[Scan]], map_T_laser: Trajectory, config: Config) -> Session:
    """Choose the key frames of a session; raises ValueError where the scans are not those of the trajectory."""
    rows, paths_m = key_rows(map_T_laser.xyyaw)
    path_of, method, keys = dict(zip(rows, paths_m, strict=True)), Robust(config), list[KeyFrame]()
    stamps_ns = map_T_laser.stamps_ns.tolist()
    for row, (scan, stamp_ns) in enumerate(zip(scans(), stamps_ns, strict=True)):
        if scan.stamp_ns != stamp_ns:
            msg = f"pose {row} is of another time than scan {row}"
            raise ValueError(msg)
        if row in path_of:
            keys.append(KeyFrame(row, path_of[row], method.match_points(scan).copy(), map_T_laser[row]))
    return Session(name, scans, map_T_laser, tuple(keys))
