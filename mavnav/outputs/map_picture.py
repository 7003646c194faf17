"""map.png: hits in colour, the estimated poses, start and end (after the paper's Figure 3).

Where the true walls are known they lie on top (Figure 7); of a mission the true poses too, and its goal takes the place
of the end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.mapping.occupancy_grid import FREE
from mavnav.mapping.tiled_arrays import where
from mavnav.outputs import canvas
from mavnav.outputs.viewport import DPI, FREE_GREY, INK, MUTED, wall_lines, window_of
from mavnav.units import MM

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.metrics.wall_thickness import WallThickness
    from mavnav.outputs.canvas import Canvas, Frame
    from mavnav.outputs.run import Run, Truth, Walls
    from mavnav.pose import Trajectory
    from mavnav.slam.result import SlamResult

CIRCLE_SPACING: Final = 0.018
"""Between two circles along the path, of the picture's longer side: so that they touch at most."""

LEFT, TOP, RIGHT, BOTTOM = 100, 110, 130, 120
"""Margins of the map in the picture, in pixels."""

SCALE: Final = canvas.ramp(canvas.VIRIDIS[::-1])
HIT_TICKS: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000)


def write(run: Run, path: Path) -> None:
    """Draw the map of a run."""
    grid, trajectory = run.known, run.slam.trajectory
    window = window_of(grid, framed(run))
    width, height = (round(v * DPI) for v in window.figure_size(longest_in=7.5, least_in=0.0))
    picture = canvas.Canvas.of(max(width + LEFT + RIGHT, 960), max(height + TOP + BOTTOM, 420))
    left = (picture.image.width - width - RIGHT + LEFT) // 2
    frame = canvas.Frame(picture, window, left, TOP, width, height)
    draw_free(frame, run)
    _draw_hits(frame, grid)
    some = thinned(trajectory.xyyaw[:, :2], CIRCLE_SPACING * max(window.size_m))
    marks = [*path_marks(trajectory, some), *_ends(run, trajectory.stamps_ns[some].tolist())]
    _draw_path(frame, run.slam)
    _draw_loops(frame, run)
    if run.true_walls:
        _draw_walls(frame, run.true_walls)
    for mark, xy_m in marks:
        frame.mark(mark, xy_m)
    frame.dress()
    named = [*([canvas.LOOP] if run.slam.loops.closed else []), *([canvas.TRUE_WALL] if run.true_walls else [])]
    canvas.legend(picture, named + [mark for mark, _ in marks], picture.image.height - 28)
    _title(picture, run)
    picture.save(path)


def _title(picture: Canvas, run: Run) -> None:
    middle = picture.image.width / 2
    picture.text((middle, 26), run.name, 12.0, INK, bold=True)
    picture.text((middle, 74), _subtitle(run), 8.5, MUTED)


def draw_free(frame: Frame, run: Run) -> None:
    """Shade the cells that are known to be free."""
    grey = np.array(canvas.rgb_of(FREE_GREY), np.uint8)
    frame.cells(run.known, run.cells, lambda _: grey, told=lambda cells: cells == FREE)


def _draw_hits(frame: Frame, grid: Grid) -> None:
    """Colour the hit cells on a logarithmic scale that a few crowded cells cannot spoil."""
    row, col = where(grid.hits, lambda hits: hits > 0).T
    counts = grid.hits[row, col]
    top = max(float(np.quantile(counts, 0.995)) if counts.size else 1.0, 10.0)

    def colour_of(hits: NDArray[Any]) -> NDArray[np.uint8]:
        share = np.minimum(np.log(hits, dtype=np.float64) / np.log(top), 1.0)
        return np.asarray(SCALE[np.round(share * (len(SCALE) - 1)).astype(np.intp)])

    frame.cells(grid, grid.hits, colour_of)
    bar = canvas.Bar(frame, frame.left + frame.width + 24)
    bar.gradient(SCALE)
    for tick in HIT_TICKS:
        if tick <= top:
            bar.tick(np.log(tick) / np.log(top), str(tick))
    bar.name("laser hits per cell")


def framed(run: Run) -> NDArray[np.float64]:
    """Return the points (n, 2) that the picture has to show besides the map."""
    xy_m, truth = run.slam.trajectory.xyyaw[:, :2], run.truth
    walls = wall_lines(run.true_walls) if run.true_walls else []
    mission = () if truth is None else (truth.map_T_laser.xyyaw[:, :2], [truth.goal_xy_map_m])
    return np.vstack((xy_m, *mission, *walls))


def _draw_path(frame: Frame, slam: SlamResult) -> None:
    """Draw the line of all estimated poses, fainter than the circles; nothing where the track was lost."""
    lines = [frame.to_marks(part) for part in parts_of_path(slam) if len(part) > 1]

    def draw(on: Any) -> None:  # noqa: ANN401
        for line in lines:
            on.line(line, fill=150, width=3)

    frame.canvas.marks(frame.box, canvas.POSE.colour, draw)


def parts_of_path(slam: SlamResult) -> list[NDArray[np.float64]]:
    """Return the positions of the path (n, 2), in parts between the stretches where the track was lost."""
    breaks = np.searchsorted(slam.trajectory.stamps_ns, [lost.start_ns for lost in slam.lost], side="right")
    return np.split(slam.trajectory.xyyaw[:, :2], breaks)


def _draw_loops(frame: Frame, run: Run) -> None:
    """Join the two poses of every closed loop by a line."""
    xy_m, closed = run.slam.trajectory.xyyaw[:, :2], run.slam.loops.closed

    def draw(on: Any) -> None:  # noqa: ANN401
        for loop in closed:
            on.line(frame.to_marks(xy_m[[loop.start, loop.end]]), fill=255, width=3)

    frame.canvas.marks(frame.box, canvas.LOOP.colour, draw)


def _draw_walls(frame: Frame, walls: Walls) -> None:
    def draw(on: Any) -> None:  # noqa: ANN401
        for line in wall_lines(walls):
            canvas.dashed(on, frame.to_marks(line))

    frame.canvas.marks(frame.box, canvas.TRUE_WALL.colour, draw)


def path_marks(trajectory: Trajectory, some: NDArray[np.intp]) -> list[tuple[canvas.Mark, NDArray[np.float64]]]:
    """Mark some of the estimated poses."""
    return [(canvas.POSE, trajectory.xyyaw[some, :2])] if len(trajectory) else []


def _ends(run: Run, stamps_ns: list[int]) -> list[tuple[canvas.Mark, NDArray[np.float64]]]:
    """Mark start and end; where the truth is known the true poses at the stamps of the circles, start and goal."""
    xy_m = run.slam.trajectory.xyyaw[:, :2]
    if run.truth is not None:
        return truth_marks(run.truth, stamps_ns)
    return [(canvas.START, xy_m[:1]), (canvas.END, xy_m[-1:])] if len(xy_m) else []


def truth_marks(truth: Truth, stamps_ns: list[int]) -> list[tuple[canvas.Mark, NDArray[np.float64]]]:
    """Mark the true poses at the stamps, the true start and the goal."""
    xy_m = truth.map_T_laser.xyyaw[:, :2]
    at = np.isin(truth.map_T_laser.stamps_ns, stamps_ns)
    return [(canvas.TRUE_POSE, xy_m[at]), (canvas.START, xy_m[:1]), (canvas.GOAL, np.array([truth.goal_xy_map_m]))]


def thinned(xy_m: NDArray[np.float64], spacing_m: float) -> NDArray[np.intp]:
    """Choose points of a path (n, 2), evenly spread along its length; the first and the last are among them."""
    if not len(xy_m):
        return np.empty(0, np.intp)
    along = np.concatenate(([0.0], np.hypot(*np.diff(xy_m, axis=0).T).cumsum()))
    circles = max(2, int(along[-1] / spacing_m) + 1)
    return np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], circles)))


def _subtitle(run: Run) -> str:
    config, slam = run.config, run.slam
    scans = f"{len(slam.trajectory)} of {len(slam.steps)} scans mapped ({slam.tracked_share:.0%})"
    lost = "   LOST before the end" if run.slam.lost_for_good else ""
    cell_mm = run.slam.grid.cell_m / MM
    how = f"method {config.method}, search grid {config.azimuth} / {config.grid}, cell {cell_mm:g} mm"
    return f"{how}\n{scans}{lost}, {thickness_text(run.thickness)}"


def thickness_text(thickness: dict[int, WallThickness]) -> str:
    """Say how thick the walls are, at the middle one of the thresholds."""
    if not thickness:
        return ""
    hits = sorted(thickness)[len(thickness) // 2]
    t = thickness[hits]
    if not t.sections:
        return "no straight wall to measure"
    return f"wall thickness p95 {t.p95_cells:.1f}, max {t.max_cells:.1f} cells at ≥ {hits} hits"
