"""The motion panel: position, heading and speed over time; position error and attitude if they are known."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from mavnav.outputs.pictures.canvas import Canvas, stroke
from mavnav.outputs.pictures.plot import Axes, Style, label_ticks, ticks
from mavnav.outputs.report.panels import CHART, CHART_MARGINS, FONT_PT
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image

    from mavnav.outputs.report.entry import Entry

    Floats = NDArray[np.float64]

HEIGHT, GAP = 120, 28
"""Height of the axes of each curve, and gap between two of them, in pixels."""

CURVE: Final = Style("#2f6690", "", partial(stroke, width_pt=1.0))
MAX_PERIODS: Final = 2.5
"""Maximum time between poses for which a speed is computed, in scan periods."""


class Curve(NamedTuple):
    """A curve over time: its name with the unit, and a value (n,) for each scan, NaN if there is none."""

    name: str
    values: Floats


def curves(entry: Entry) -> list[Curve]:
    """Return the curves of a run."""
    scans = entry.scans
    known = np.isfinite(scans.yaw_rad)
    yaw = scans.yaw_rad.copy()
    yaw[known] = np.unwrap(yaw[known])
    always = [
        Curve("x [m]", scans.xy_m[:, 0]),
        Curve("y [m]", scans.xy_m[:, 1]),
        Curve("yaw [deg]", yaw / DEG),
        Curve("speed [m/s]", speeds(scans.time_s, scans.xy_m)),
    ]
    roll, pitch, height_m = scans.roll_pitch_height.T
    more = [
        Curve("error [mm]", scans.error_m / MM),
        Curve("roll [deg]", roll / DEG),
        Curve("pitch [deg]", pitch / DEG),
        Curve("height [m]", height_m),
    ]
    return always + [curve for curve in more if np.isfinite(curve.values).any()]


def speeds(time_s: Floats, xy_m: Floats) -> Floats:
    """Return the speed at each scan, (n,), from the poses before and after it; NaN next to gaps."""
    out = np.full(len(time_s), np.nan)
    rows = np.flatnonzero(np.isfinite(xy_m[:, 0]))
    if len(rows) < 3:
        return out
    took_s = time_s[rows[2:]] - time_s[rows[:-2]]
    moved_m = np.hypot(*(xy_m[rows[2:]] - xy_m[rows[:-2]]).T)
    near = took_s <= 2.0 * MAX_PERIODS * np.median(np.diff(time_s[rows]))
    out[rows[1:-1]] = np.where(near, moved_m / took_s, np.nan)
    return out


def motion_panel(entry: Entry) -> Image:
    """Draw the curves of a run below one another, with a common time axis."""
    shown, (left, top, right, bottom) = curves(entry), CHART_MARGINS
    height = len(shown) * (HEIGHT + GAP) - GAP
    canvas = Canvas.of(left + CHART[0] + right, top + height + bottom)
    canvas.text((left, top - 11), entry.name, FONT_PT + 1.5, anchor="ls")
    end_s = max(float(entry.scans.time_s.max(initial=0.1)), 0.1)
    for k, curve in enumerate(shown):
        y = top + k * (HEIGHT + GAP)
        axes = Axes.chart(canvas, (left, y, left + CHART[0], y + HEIGHT), (0.0, end_s, *_limits(curve.values)))
        _draw(axes, entry, curve, last=k == len(shown) - 1)
    return canvas.image


def _draw(axes: Axes, entry: Entry, curve: Curve, *, last: bool) -> None:
    axes.borders()
    x0, x1, y0, y1 = axes.limits
    in_x = ticks(x0, x1)
    axes.ticks(label_ticks(in_x) if last else [(value, "") for value in in_x], label_ticks(ticks(y0, y1, 5)))
    axes.lines(CURVE, [np.column_stack((entry.scans.time_s, curve.values))])
    axes.names("time [s]" if last else "", curve.name, FONT_PT, 72)


def _limits(values: Floats) -> tuple[float, float]:
    """Return the smallest and the largest value with a margin."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    margin = max(0.05 * (high - low), 1e-3)
    return low - margin, high + margin
