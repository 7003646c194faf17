"""The markers of result.mcap: ghost walls, stretches where the track was lost, and doubtful ones."""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING

import numpy as np

from mavnav.logs.messages.cdr import LINE_LIST, LINE_STRIP, TEXT, Marker
from mavnav.slam.result import doubtful_parts
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.metrics.ghost_walls import GhostWall
    from mavnav.outputs.run import RunResult

RED, ORANGE, MAGENTA = (0.84, 0.15, 0.16, 1.0), (0.9, 0.6, 0.0, 1.0), (0.8, 0.47, 0.65, 1.0)
WIDTH_M, LETTERS_M = 0.04, 0.2


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
