"""What result.mcap holds besides the run itself: markers, metadata, files that describe the run; a layout to view it.

The markers show ghost walls, stretches where the track was lost, and doubtful ones.
"""

from __future__ import annotations

import json
from math import cos, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.logs.messages.cdr import LINE_LIST, LINE_STRIP, TEXT, Marker
from mavnav.logs.writing.mcap_writer import Attachment, Extras
from mavnav.outputs.files.document import document_without_cost, plain, plain_json, to_json
from mavnav.outputs.files.gridmap import pgm_rows, yaml_text
from mavnav.slam.result import doubtful_parts
from mavnav.units import DEG, NS
from mavnav.version import __version__

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.metrics.ghost_walls import GhostWall
    from mavnav.outputs.run import RunResult

MOST_CELLS: Final = 2_000_000
"""The picture of a larger map is not attached: ``/map`` has it, compressed."""

_CHANGING: Final = ("timing", "provenance", "outputs", "python", "libraries")
"""Sections of run.json that differ from run to run or between machines, or describe the files beside it."""

RED, ORANGE, MAGENTA = (0.84, 0.15, 0.16, 1.0), (0.9, 0.6, 0.0, 1.0), (0.8, 0.47, 0.65, 1.0)
WIDTH_M, LETTERS_M = 0.04, 0.2


def extras(run: RunResult) -> Extras:
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
        Attachment("run.json", "application/json", plain_json(document).encode()),
        Attachment("config.json", "application/json", to_json(run.config).encode()),
        Attachment("map.yaml", "application/yaml", yaml_text(run).encode()),
    ]
    if run.known.hits.size <= MOST_CELLS:
        files.append(Attachment("map.pgm", "image/x-portable-graymap", b"".join(pgm_rows(run))))
    return Extras(run.log.first_ns, {"mavnav": _metadata(run)}, tuple(files))


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
    ghosts = run.measured.quality.ghost_walls.places
    return [
        *(m for k, ghost in enumerate(ghosts) for m in _ghost(k, ghost)),
        *_lost_markers(run),
        *(Marker("doubtful", k, LINE_STRIP, xy, WIDTH_M, ORANGE) for k, xy in enumerate(doubtful_parts(run.slam))),
    ]


def _ghost(number: int, ghost: GhostWall) -> tuple[Marker, Marker]:
    """Mark the front copy of a wall that is there twice, and how far the other one is."""
    c, s = cos(ghost.direction_deg * DEG), sin(ghost.direction_deg * DEG)
    middle = np.array((ghost.x_m, ghost.y_m))
    front = middle + 0.5 * ghost.length_m * np.array(((-c, -s), (c, s)))
    text = f"ghost wall, {ghost.offset_mm:.0f} mm apart"
    return (
        Marker("ghost wall", 2 * number, LINE_LIST, front, WIDTH_M, MAGENTA),
        Marker("ghost wall", 2 * number + 1, TEXT, middle[None], LETTERS_M, MAGENTA, text),
    )


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


def write(run: RunResult, path: Path) -> None:
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
