"""result.mcap: the run as a ROS 2 log that viewers open by itself, in the order in which it happened.

``/tf_static`` comes first, ``/tf`` before the ``/scan`` of the same stamp, then ``/pose``; ``/map`` shows the walls as
they were first seen, about once a second of the log, and at the end the whole map with its free space, with ``/path``
and ``/markers``. With odometry, ``/tf`` leads from the map over ``odom`` (REP-105). Scans without an accepted pose are
left out: they have no place in the map. Configuration, run.json and the map's files are attached.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from mavnav.logs.messages import cdr, definitions
from mavnav.logs.writing.mcap_writer import OutputChannel, write_serialized
from mavnav.mapping.occupancy_grid import UNKNOWN, Grid, show_ends
from mavnav.mapping.tiled_arrays import max_pool
from mavnav.outputs.files.extras import extras, markers_of
from mavnav.outputs.run import RunResult, base_frame
from mavnav.pose import Pose, Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.scan import Scan

MAP_FRAME, ODOM_FRAME = "map", "odom"
MAX_MAPS: Final = 60
MAX_MAP_BYTES: Final = 64_000_000
LARGEST_MAP_BYTES: Final = 25_000_000
MAP_PERIOD_NS: Final = 1_000_000_000
CHUNK_BYTES: Final = 1 << 20
"""A run is complete or absent: larger chunks than a recording's, in which one map resembles the one before."""

CHANNELS: Final = {
    "/tf_static": OutputChannel(definitions.TF, latched=True),
    "/tf": OutputChannel(definitions.TF),
    "/scan": OutputChannel(definitions.SCAN),
    "/pose": OutputChannel(definitions.POSE),
    "/path": OutputChannel(definitions.PATH, latched=True),
    "/markers": OutputChannel(definitions.MARKERS, latched=True),
    "/map": OutputChannel(definitions.MAP, latched=True),
}


def write(run: RunResult, path: Path) -> None:
    """Write the run as a ROS 2 log. The scans are read from the log once more."""
    with write_serialized(path, CHANNELS, CHUNK_BYTES, extras(run)) as put:
        laser, last_ns = laser_frame(run), run.log.last_ns
        mounting = run.log.base_T_laser
        if mounting is not None:
            put("/tf_static", run.log.first_ns, cdr.transforms(base_frame(run.log), laser)(run.log.first_ns, mounting))
        walls, write_scan, write_pose = _GrowingMap(run), cdr.scans(laser), cdr.poses(MAP_FRAME)
        place = _Placement(run, laser if mounting is None else base_frame(run.log))
        from_laser = Pose() if mounting is None else mounting.inverse()
        for scan, map_T_laser in placed_scans(run):
            placed = map_T_laser if mounting is None else map_T_laser @ from_laser
            for message in place(scan.stamp_ns, placed):
                put("/tf", scan.stamp_ns, message)
            put("/scan", scan.stamp_ns, write_scan(scan))
            put("/pose", scan.stamp_ns, write_pose(scan.stamp_ns, map_T_laser))
            if walls.add(scan, map_T_laser):
                put("/map", scan.stamp_ns, _map(walls.grid, walls.cells, scan.stamp_ns))
        trajectory = run.slam.trajectory
        put("/markers", last_ns, cdr.marker_array(last_ns, MAP_FRAME, markers_of(run)))
        put("/path", last_ns, cdr.path(last_ns, MAP_FRAME, trajectory.stamps_ns, trajectory.xyyaw))
        put("/map", last_ns, _map(walls.grid, walls.finished, last_ns))


class _Placement:
    """The transforms that place the base, or without a mounting the laser, on the map: over ``odom`` where it is."""

    def __init__(self, run: RunResult, body: str) -> None:
        odometry = run.log.odometry
        self.odom_T_body = None if odometry is None or body in (ODOM_FRAME, MAP_FRAME) else odometry.odom_T_base
        self._direct = cdr.transforms(MAP_FRAME, body)
        self._to_odom, self._to_body = cdr.transforms(MAP_FRAME, ODOM_FRAME), cdr.transforms(ODOM_FRAME, body)

    def __call__(self, stamp_ns: int, map_T_body: Pose) -> Iterator[bytes]:
        """Yield a TFMessage for each transform from the map to the body."""
        if self.odom_T_body is None:
            yield self._direct(stamp_ns, map_T_body)
            return
        odom_T_body = nearest_pose(self.odom_T_body, stamp_ns)
        yield self._to_odom(stamp_ns, map_T_body @ odom_T_body.inverse())
        yield self._to_body(stamp_ns, odom_T_body)


def nearest_pose(poses: Trajectory, stamp_ns: int) -> Pose:
    """Return the pose at a time, interpolated; of the nearest stamp outside of all."""
    inside = min(max(stamp_ns, int(poses.stamps_ns[0])), int(poses.stamps_ns[-1]))
    return poses.at(inside, max_gap_ns=int(np.iinfo(np.int64).max)) or poses[0]


def laser_frame(run: RunResult) -> str:
    """Name the laser's frame as tf2 takes it; a name that cannot stand beside ``map`` is replaced."""
    name = run.log.frame_id.lstrip("/")
    return name if name not in ("", MAP_FRAME) else "laser"


def placed_scans(run: RunResult) -> Iterator[tuple[Scan, Pose]]:
    """Read the tracked scans once more: the scan and map_T_laser."""
    trajectory = run.slam.trajectory
    row_of = {stamp_ns: row for row, stamp_ns in enumerate(trajectory.stamps_ns.tolist())}
    for scan in run.log.scans():
        if (row := row_of.get(scan.stamp_ns)) is not None:
            yield scan, trajectory[row]


def _map(grid: Grid, cells: NDArray[np.int8], stamp_ns: int) -> bytes:
    return cdr.occupancy_grid(stamp_ns, MAP_FRAME, cells, grid.cell_m, grid.origin_xy_m)


class _GrowingMap:
    """The walls of the ``finished`` map as they come into sight; free space follows from that alone.

    Shown at most `MAX_MAPS` times, and less often where the map is so large that the file would swell. A map that is
    too large to be shown once is shown in larger cells, each the most of what it holds: occupied, free, unknown.
    """

    def __init__(self, run: RunResult) -> None:
        known = run.known
        factor = max(1, ceil(sqrt(known.hits.size / LARGEST_MAP_BYTES)))
        self.finished = max_pool(run.cells, factor, fill=UNKNOWN) if factor > 1 else run.cells
        self.grid = replace(known, cell_m=known.cell_m * factor)
        self.cells: NDArray[np.int8] = np.full(self.finished.shape, UNKNOWN, np.int8)
        maps = min(MAX_MAPS, MAX_MAP_BYTES // self.cells.size)
        span_ns = run.log.last_ns - run.log.first_ns
        self._period_ns = max(MAP_PERIOD_NS, span_ns // maps) if maps else None
        self._next_ns = run.log.first_ns

    def add(self, scan: Scan, map_T_laser: Pose) -> bool:
        """Show what a scan saw; return whether it is time to publish."""
        show_ends(scan.ranges_m, scan.spec.directions, map_T_laser, self.grid, self.finished, self.cells)
        if self._period_ns is None or scan.stamp_ns < self._next_ns:
            return False
        self._next_ns = scan.stamp_ns + self._period_ns
        return True
