"""A session: the scans of one run and where they were taken, in a frame of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np
from msgspec import Struct

from mavnav.slam.loop_closure.key_frames import KeyFrame, key_rows
from mavnav.slam.matching.motion_model import USUAL_PERIOD_S, Motion
from mavnav.slam.methods.robust import Robust
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.pose import Trajectory
    from mavnav.scan import Scan

END_M, END_KEY_M, END_KEY_RAD = 1.5, 0.1, 5 * DEG
"""Sessions may meet at an end: that near to the ends of the path, key frames follow each other more closely."""


class Session(Struct, frozen=True):
    """Tracked scans, from the first one again at every call, their poses, a row each, and the key frames among them.

    ``doubtful``: the track may be wrong, by its own run. ``scan_hashes`` are those of the ranges.
    """

    name: str
    scans: Callable[[], Iterable[Scan]]
    map_T_laser: Trajectory
    keys: tuple[KeyFrame, ...]
    doubtful: bool = False
    scan_hashes: frozenset[int] = frozenset()

    @property
    def at_rest(self) -> Motion:
        """The motion before the first scan: the time between two scans alone is known."""
        steps_ns = np.diff(self.map_T_laser.stamps_ns)
        return Motion(float(np.median(steps_ns)) * NS if len(steps_ns) else USUAL_PERIOD_S)


def make_session(
    name: str, scans: Callable[[], Iterable[Scan]], map_T_laser: Trajectory, config: Config, *, doubtful: bool = False
) -> Session:
    """Choose the key frames of a session; raises ValueError where the scans are not those of the trajectory."""
    path_of, method, keys = key_paths_m(map_T_laser.xyyaw), Robust(config), list[KeyFrame]()
    stamps_ns, hashes = map_T_laser.stamps_ns.tolist(), set[int]()
    for row, (scan, stamp_ns) in enumerate(zip(scans(), stamps_ns, strict=True)):
        if scan.stamp_ns != stamp_ns:
            msg = f"pose {row} is of another time than scan {row}"
            raise ValueError(msg)
        hashes.add(crc32(scan.ranges_m.tobytes()))
        if row in path_of:
            keys.append(KeyFrame(row, path_of[row], method.match_points(scan).copy(), map_T_laser[row]))
    return Session(name, scans, map_T_laser, tuple(keys), doubtful, frozenset(hashes))


def key_paths_m(xyyaw: NDArray[np.float64]) -> dict[int, float]:
    """Choose the rows of key frames out of poses (n, 3); return the path length up to each, m."""
    rows, paths_m = key_rows(xyyaw)
    close = zip(*key_rows(xyyaw, END_KEY_M, END_KEY_RAD), strict=True)
    end_m = paths_m[-1] - END_M if rows else 0.0
    chosen = [*zip(rows, paths_m, strict=True), *(pair for pair in close if not END_M < pair[1] < end_m)]
    return dict(sorted(chosen))
