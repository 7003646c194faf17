"""result.mcap: the run as a ROS 2 log that viewers open by itself, in the order in which it happened.

``/tf_static`` comes first, ``/tf`` before the ``/scan`` of the same stamp, then ``/pose``; ``/map`` shows the walls as
they were first seen, about once a second of the log, and at the end the whole map with its free space, with ``/path``
and ``/markers``. With odometry, ``/tf`` leads from the map over ``odom`` (REP-105). Scans without an accepted pose are
left out: they have no place in the map. Configuration, run.json and the map's files are attached.

The markers show ghost walls, stretches where the track was lost, and doubtful ones. foxglove_layout.json shows it all.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import ceil, cos, sin, sqrt
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.kernels.maps.hits import show_ends
from mavnav.logs.messages import cdr, definitions
from mavnav.logs.messages.cdr import LINE_LIST, LINE_STRIP, TEXT, Marker
from mavnav.logs.records import AttachedFile, MetadataRecord
from mavnav.logs.writing.mcap_writer import OutputChannel, write_serialized
from mavnav.mapping.occupancy_grid import UNKNOWN, Grid
from mavnav.mapping.tiled_arrays import max_pool
from mavnav.metrics.ghost_walls import GhostWall
from mavnav.outputs.files.document import document_without_cost, plain, plain_json, to_json
from mavnav.outputs.files.gridmap import pgm_rows, yaml_text
from mavnav.outputs.run import RunResult, base_frame
from mavnav.pose import Pose, Trajectory
from mavnav.scan import Scan
from mavnav.slam.result import doubtful_parts
from mavnav.units import DEG, NS
from mavnav.version import __version__

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
        laser, lattice = map_T_laser.as_array(), self.grid.lattice
        show_ends(scan.ranges_m, scan.spec.directions, laser, lattice, self.finished, self.cells)
        if self._period_ns is None or scan.stamp_ns < self._next_ns:
            return False
        self._next_ns = scan.stamp_ns + self._period_ns
        return True


MOST_CELLS: Final = 2_000_000
"""The picture of a larger map is not attached: ``/map`` has it, compressed."""

_CHANGING: Final = ("timing", "provenance", "outputs", "python", "libraries")
"""Sections of run.json that differ from run to run or between machines, or describe the files beside it."""

RED, ORANGE, MAGENTA = (0.84, 0.15, 0.16, 1.0), (0.9, 0.6, 0.0, 1.0), (0.8, 0.47, 0.65, 1.0)
WIDTH_M, LETTERS_M = 0.04, 0.2


def extras(run: RunResult) -> list[AttachedFile | MetadataRecord]:
    """Return the metadata record ``mavnav``, and run.json, configuration and map files as attachments.

    Of run.json the sections are left out that differ from run to run, and the path of the log, or the whole file of a
    scenario: equal runs have equal bytes.
    """
    document: dict[str, Any] = plain(document_without_cost(run))
    document = {name: section for name, section in document.items() if name not in _CHANGING}
    del document["input"]["path"]
    for key in ("sha256", "size_bytes") if run.mission else ():
        del document["input"][key]
    files = [
        ("run.json", "application/json", plain_json(document).encode()),
        ("config.json", "application/json", to_json(run.config).encode()),
        ("map.yaml", "application/yaml", yaml_text(run).encode()),
    ]
    if run.known.hits.size <= MOST_CELLS:
        files.append(("map.pgm", "image/x-portable-graymap", b"".join(pgm_rows(run))))
    first_ns = run.log.first_ns
    return [MetadataRecord("mavnav", _metadata(run)), *(AttachedFile(first_ns, first_ns, *file) for file in files)]


def _metadata(run: RunResult) -> dict[str, str]:
    """Return what identifies a run; of a mission its recording has no name."""
    name = run.log.path.name.encode(errors="backslashreplace").decode()  # names of files need not be UTF-8
    log = {} if run.mission else {"log": name, "log_sha256": run.log.sha256}
    return {
        "version": __version__,
        **log,
        "topic": run.log.topic,
        "method": run.config.method,
        "grid": str(run.config.grid),
        "azimuth": str(run.config.azimuth),
        "tracked_share": f"{run.slam.tracked_share:.6f}",
        "exit_code": str(int(run.exit_code)),
    }


def markers_of(run: RunResult) -> list[Marker]:
    """Return the markers of a run, in the map frame."""
    ghosts = run.measures.quality.ghost_walls.places
    doubtful = [Marker("doubtful", k, LINE_STRIP, xy, WIDTH_M, ORANGE) for k, xy in enumerate(doubtful_parts(run.slam))]
    return [*(m for k, ghost in enumerate(ghosts) for m in _ghost(k, ghost)), *_lost_markers(run), *doubtful]


def _ghost(number: int, ghost: GhostWall) -> tuple[Marker, Marker]:
    """Mark the front copy of a wall that is there twice, and how far the other one is."""
    c, s = cos(ghost.direction_deg * DEG), sin(ghost.direction_deg * DEG)
    middle = np.array((ghost.x_m, ghost.y_m))
    front = middle + 0.5 * ghost.length_m * np.array(((-c, -s), (c, s)))
    text = f"ghost wall, {ghost.offset_mm:.0f} mm apart"
    line = Marker("ghost wall", 2 * number, LINE_LIST, front, WIDTH_M, MAGENTA)
    return line, Marker("ghost wall", 2 * number + 1, TEXT, middle[None], LETTERS_M, MAGENTA, text)


def _lost_markers(run: RunResult) -> list[Marker]:
    """Mark where the track was lost, from the last pose before to the first one after, and for how long."""
    markers, trajectory = [], run.slam.trajectory
    for number, lost in enumerate(run.slam.lost if len(trajectory) else ()):
        first = np.searchsorted(trajectory.stamps_ns, lost.start_ns) - (lost.scans > 0)
        last = np.searchsorted(trajectory.stamps_ns, lost.end_ns, side="right")
        ends: NDArray[np.float64] = trajectory.xyyaw[np.clip((first, last), 0, len(trajectory) - 1), :2]
        text = f"lost for {(lost.end_ns - lost.start_ns) * NS:.1f} s"
        markers.append(Marker("lost", 2 * number, LINE_LIST, ends, WIDTH_M, RED))
        markers.append(Marker("lost", 2 * number + 1, TEXT, ends[:1], LETTERS_M, RED, text))
    return markers


def write_layout(run: RunResult, path: Path) -> None:
    """Write how Foxglove shows result.mcap, as it imports it: on the left the map, on the right plots of the pose.

    The camera looks at the whole map from above.
    """
    layout = json.loads(Path(__file__).with_name("foxglove_layout.json").read_text(encoding="ascii"))
    grid, camera = run.known, layout["configById"]["3D!map"]["cameraState"]
    rows, cols = grid.hits.shape
    camera["distance"] = 1.2 * max(rows, cols) * grid.cell_m
    middle = [o + 0.5 * n * grid.cell_m for o, n in zip(grid.origin_xy_m, (cols, rows), strict=True)]
    camera["targetOffset"] = [*middle, 0]
    path.write_text(json.dumps(layout, indent=2) + "\n", encoding="ascii")
