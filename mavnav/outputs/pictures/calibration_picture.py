"""The picture of a calibration: turn rates of laser and odometry over time once they are aligned, and what is left."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from mavnav.metrics.calibration.motion import Array, Motions
from mavnav.metrics.calibration.solve import Estimate
from mavnav.outputs.pictures.canvas import INK, MEASURED_BLUE, TRUE_ORANGE, Canvas, stroke
from mavnav.outputs.pictures.plot import Axes, Style, label_ticks, legend, legend_width, ticks
from mavnav.units import DEG, MM

WIDTH, HEIGHT, LEFT, RIGHT = 1500, 1080, 110, 30
TOPS: Final = (90, 450, 740)
HEIGHTS: Final = (310, 220, 220)

_pen = partial(stroke, width_pt=1.0)
LASER, ODOMETRY = Style(MEASURED_BLUE, "laser", _pen), Style(TRUE_ORANGE, "odometry, calibrated", _pen)
FORWARD, LATERAL, YAW = Style("#009e73", "x", _pen), Style("#cc79a7", "y", _pen), Style("#666666", "yaw", _pen)


def write(motions: Motions, fit: Estimate, title: str, path: Path) -> None:
    """Draw the turn rates and the errors of the steps; the file is a PNG."""
    motions = motions.mirror() if fit.mirrored else motions
    seconds, elapsed_s = fit.seconds, np.diff(motions.laser_s)[motions.linked]
    laser = motions.laser_steps().turned[motions.linked] / elapsed_s / DEG
    odometry = motions.predicted_steps(fit.values).turned[motions.linked] / elapsed_s / DEG
    errors = fit.errors / (MM, MM, DEG)
    canvas = Canvas.of(WIDTH, HEIGHT)
    canvas.text((WIDTH / 2, 24), title, 10.0, INK, bold=True)
    _chart(canvas, 0, seconds, {LASER: laser, ODOMETRY: odometry}, "turn rate [deg/s]")
    _chart(canvas, 1, seconds, {FORWARD: errors[:, 0], LATERAL: errors[:, 1]}, "error [mm]")
    _chart(canvas, 2, seconds, {YAW: errors[:, 2]}, "error [deg]")
    marks = [LASER, ODOMETRY, FORWARD, LATERAL, YAW]
    legend(canvas, marks, HEIGHT - 24, (WIDTH - legend_width(marks)) / 2.0)
    canvas.save(path)


def _chart(canvas: Canvas, row: int, seconds: Array, lines: dict[Style, Array], name: str) -> None:
    """Draw lines over time in a row of the picture."""
    values = np.concatenate(list(lines.values()))
    low, high = float(values.min()), float(values.max())
    margin = 0.05 * (high - low) + 1e-6
    limits = (float(seconds[0]), float(seconds[-1]), low - margin, high + margin)
    axes = Axes.chart(canvas, (LEFT, TOPS[row], WIDTH - RIGHT, TOPS[row] + HEIGHTS[row]), limits)
    for line, data in lines.items():
        axes.lines(line, [np.column_stack((seconds, data))])
    axes.borders()
    axes.ticks(label_ticks(ticks(*limits[:2])), label_ticks(ticks(*limits[2:], most=6)))
    axes.names("time [s]" if row == len(TOPS) - 1 else "", name)
