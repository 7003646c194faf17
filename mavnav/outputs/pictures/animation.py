"""``--animate``: the map as it grows, estimated and true poses, as an animated GIF.

Drawn with pillow on a raster of few colours: a frame costs milliseconds, and a GIF holds only what changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mavnav.mapping.occupancy_grid import known_area
from mavnav.metrics.journey import spread
from mavnav.outputs.directory import check_file, write_file
from mavnav.outputs.files.replay_log import placed_scans
from mavnav.outputs.pictures.canvas import GOAL_RED, POSE_MAGENTA, START_BLUE
from mavnav.outputs.pictures.map_axes import Viewport, wall_lines, window_of
from mavnav.outputs.pictures.map_picture import points_to_show
from mavnav.outputs.run import RunResult, Truth
from mavnav.pose import Pose, transform_points
from mavnav.units import DEG, NS

MAX_FRAMES: Final = 150
FRAME_MS: Final = 80
LAST_FRAME_MS: Final = 2000
LONGEST_PIXELS: Final = 560
LEAST_WIDTH_PIXELS: Final = 360
CAPTION_PIXELS: Final = 22

_WHITE, _WALL, _TRUE_POSE, _POSE, _START, _GOAL, _TEXT, _HITS = 0, 1, 2, 3, 4, 5, 6, 7
_PALETTE: Final = ("#ffffff", "#9aa1a8", "#000000", POSE_MAGENTA, START_BLUE, GOAL_RED,
                   "#444444", "#b5de2b", "#6ece58", "#35b779", "#1f9e89", "#26828e", "#31688e", "#3e4989", "#482878",
                   "#440154")  # fmt: skip
"""The hits' colours are steps of viridis, as in map.png; each is for twice the hits of the one before."""


def animate(run: RunResult, path: Path, *, force: bool = False) -> None:
    """Write the animation of a run; scans are read once more. Raises OutputError where it cannot be written."""
    check_file(path, ".gif", force=force)
    first, *others = _frames(run)
    times_ms = [*[FRAME_MS] * len(others), LAST_FRAME_MS]
    options = {"save_all": True, "append_images": others, "duration": times_ms, "loop": 0, "optimize": False}
    write_file(path, lambda partial: first.save(partial, "GIF", **options), force=force)


class _Raster:
    """A raster over a window of the map: pixel (column, row) with row 0 on top, and the hits that fell on each."""

    def __init__(self, window: Viewport, pixel_m: float) -> None:
        self.window, self.pixel_m = window, pixel_m
        width, height = (max(2, round(side / pixel_m)) for side in window.size_m)
        self.hits = np.zeros((height, width), np.int32)

    def pixels(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bring points (n, 2) in the map frame to columns and rows (n, 2)."""
        window = self.window
        return np.column_stack((xy_m[:, 0] - window.x0_m, window.y1_m - xy_m[:, 1])) / self.pixel_m

    def line(self, draw: ImageDraw.ImageDraw, xy_m: NDArray[np.float64], colour: int, width: int = 1) -> None:
        """Draw a line through points (n, 2)."""
        draw.line(self.pixels(xy_m).ravel().tolist(), fill=colour, width=width)

    def circle(self, draw: ImageDraw.ImageDraw, xy_m: NDArray[np.float64], colour: int, radius: int) -> None:
        """Draw a circle about a point (2,)."""
        ((x, y),) = self.pixels(xy_m[None]).tolist()
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=colour, width=2)

    def cross(self, draw: ImageDraw.ImageDraw, xy_m: NDArray[np.float64], colour: int, radius: int) -> None:
        """Draw an x at a point (2,)."""
        ((x, y),) = self.pixels(xy_m[None]).tolist()
        draw.line((x - radius, y - radius, x + radius, y + radius), fill=colour, width=2)
        draw.line((x - radius, y + radius, x + radius, y - radius), fill=colour, width=2)

    def add(self, xy_m: NDArray[np.float64]) -> None:
        """Count hits (n, 2); those outside are left out."""
        at = np.floor(self.pixels(xy_m)).astype(np.int64)
        col, row = at[((at >= 0) & (at < self.hits.shape[::-1])).all(axis=1)].T
        np.add.at(self.hits, (row, col), 1)

    def image(self) -> Image.Image:
        """Return the hits as a picture of indices into the palette, with room for a caption below."""
        steps = np.minimum(np.log2(np.maximum(self.hits, 1)).astype(np.uint8), len(_PALETTE) - 1 - _HITS)
        indices = np.where(self.hits > 0, _HITS + steps, _WHITE).astype(np.uint8)
        right = max(0, LEAST_WIDTH_PIXELS - indices.shape[1])
        return Image.fromarray(np.pad(indices, ((0, CAPTION_PIXELS), (0, right)), constant_values=_WHITE))


def _frames(run: RunResult) -> Iterator[Image.Image]:
    """Draw a frame at up to `MAX_FRAMES` of the tracked scans, evenly spread; the last one is the end."""
    window = window_of(known_area(run.slam.grid), points_to_show(run))
    canvas = _Raster(window, max(window.size_m) / LONGEST_PIXELS)
    shown = set(spread(len(run.slam.trajectory), MAX_FRAMES).tolist())
    poses: list[tuple[int, Pose]] = []
    for k, (scan, map_T_laser) in enumerate(placed_scans(run)):
        poses.append((scan.stamp_ns, map_T_laser))
        canvas.add(transform_points(map_T_laser, scan.points()))
        if k in shown:
            yield _frame(run, canvas, poses)
    if not poses:
        yield _frame(run, canvas, poses)


def _frame(run: RunResult, canvas: _Raster, poses: list[tuple[int, Pose]]) -> Image.Image:
    image = canvas.image()
    image.putpalette(bytes(int(colour[k : k + 2], 16) for colour in _PALETTE for k in (1, 3, 5)))
    draw = ImageDraw.Draw(image)
    draw.fontmode = "1"  # no grey edges, which the palette has no colours for
    if run.truth:
        _draw_truth(draw, canvas, run.truth, poses[-1][0] if poses else 0)
    _draw_path(draw, canvas, [pose for _, pose in poses])
    since_s = (poses[-1][0] - run.log.first_ns) * NS if poses else 0.0
    text = f"{run.name}   {since_s:.1f} s   {len(poses)} of {len(run.slam.steps)} scans{_attitude(run, poses)}"
    draw.text((6, image.height - CAPTION_PIXELS + 4), text, fill=_TEXT, font=ImageFont.load_default(12))
    return image


def _attitude(run: RunResult, poses: list[tuple[int, Pose]]) -> str:
    """Return the attitude of the last scan for the caption; nothing where the log has none."""
    if run.log.attitude is None or not poses:
        return ""
    late_ns = np.array([float(poses[-1][0] - int(run.log.attitude.stamps_ns[0]))])
    roll_rad, pitch_rad, height_m = (float(values[0]) for values in run.log.attitude.at(late_ns))
    height = f"   {height_m:.2f} m high" if np.isfinite(height_m) else ""
    return f"   roll {roll_rad / DEG:+.0f}, pitch {pitch_rad / DEG:+.0f} deg{height}"


def _draw_truth(draw: ImageDraw.ImageDraw, canvas: _Raster, truth: Truth, now_ns: int) -> None:
    """Draw the true walls thinly, the goal, and the true path so far with an x at its end."""
    for line in wall_lines(truth):
        canvas.line(draw, line, _WALL)
    goal_xy_m = np.array(truth.goal_xy_map_m)
    canvas.circle(draw, goal_xy_m, _GOAL, radius=7)
    canvas.cross(draw, goal_xy_m, _GOAL, radius=4)
    xy_m = truth.map_T_laser.xyyaw[truth.map_T_laser.stamps_ns <= now_ns, :2]
    if len(xy_m):
        canvas.line(draw, xy_m, _TRUE_POSE)
        canvas.cross(draw, xy_m[-1], _TRUE_POSE, radius=5)


def _draw_path(draw: ImageDraw.ImageDraw, canvas: _Raster, poses: list[Pose]) -> None:
    """Draw the estimated path, the start, and the present pose as a circle with its heading."""
    if not poses:
        return
    xy_m = np.array([(p.x_m, p.y_m) for p in poses])
    canvas.line(draw, xy_m, _POSE)
    canvas.cross(draw, xy_m[0], _START, radius=5)
    canvas.circle(draw, xy_m[-1], _POSE, radius=6)
    now = poses[-1]
    ahead_m = 14 * canvas.pixel_m * np.array([np.cos(now.yaw_rad), np.sin(now.yaw_rad)])
    canvas.line(draw, np.array([xy_m[-1], xy_m[-1] + ahead_m]), _POSE, width=2)
