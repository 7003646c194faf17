"""The drawing of a floor plan: SVG, true to scale on paper, and DXF in meters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from xml.sax.saxutils import escape

import numpy as np

from mavnav.errors import UsageError
from mavnav.outputs.pictures.vector_map import scale_bar
from mavnav.outputs.pictures.viewport import INK, MUTED

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.metrics.floor_plan import FloorPlan

MARGIN_MM: Final = 12.0
LAYERS: Final = {"WALLS": 7, "OPENINGS": 8}
"""Layers of a DXF and their colours: black or white, and grey."""

_SVG: Final = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.2f} {height:.2f}" width="{width:.2f}mm" \
height="{height:.2f}mm">
<title>{title}</title>
<desc>Floor plan at 1:{ratio:g}; one unit is a millimeter on paper. Map turned by {yaw_deg:.3f} deg.</desc>
<rect width="{width:.2f}" height="{height:.2f}" fill="#fff"/>
<path id="walls" fill="none" stroke="{ink}" stroke-width="0.6" stroke-linecap="square" d="{walls}"/>
<path id="openings" fill="none" stroke="{muted}" stroke-width="0.25" stroke-dasharray="1 1" d="{openings}"/>
<path id="scale" fill="none" stroke="{ink}" stroke-width="0.3" d="M{bar_x:.2f} {bar_y:.2f}v1.5h{bar:.2f}v-1.5"/>
<text x="{text_x:.2f}" y="{text_y:.2f}" font-family="sans-serif" font-size="3" fill="{ink}">{label}</text>
</svg>
"""


def write_svg(plan: FloorPlan, title: str, ratio: float, path: Path) -> None:
    """Write a floor plan at 1:``ratio``, with the length of the scale bar and the size of the place below."""
    mm = 1000.0 / ratio
    low, high = _extent(plan)
    size = (high - low) * mm
    bar_m, label = scale_bar(max(float(size[0]) / 2.0, 10.0) / mm, 1.0)
    base = MARGIN_MM + float(size[1]) + 4.0
    text = _SVG.format(
        width=max(float(size[0]), bar_m * mm + 60.0) + 2 * MARGIN_MM, height=base + 12.0, title=escape(title),
        ratio=ratio, yaw_deg=np.degrees(plan.plan_T_map.yaw_rad), ink=INK, muted=MUTED,
        walls=_lines(plan.walls, low, high, mm), openings=_lines(plan.openings, low, high, mm), bar=bar_m * mm,
        bar_x=MARGIN_MM, bar_y=base, text_x=MARGIN_MM + bar_m * mm + 2.0, text_y=base + 2.0,
        label=f"{label}, 1:{ratio:g}; {high[0] - low[0]:.2f} m x {high[1] - low[1]:.2f} m",
    )  # fmt: skip
    path.write_text(text, encoding="utf-8", errors="backslashreplace")


def _extent(plan: FloorPlan) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower left and the upper right corner, (2,) in m."""
    ends = plan.walls.reshape(-1, 2)
    return ends.min(axis=0), ends.max(axis=0)


def _lines(lines: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], mm: float) -> str:
    """Return lines (n, 4) as a path, with y downwards."""
    x, y = (lines[:, ::2] - low[0]) * mm + MARGIN_MM, (high[1] - lines[:, 1::2]) * mm + MARGIN_MM
    rows = np.column_stack((x[:, 0], y[:, 0], x[:, 1], y[:, 1])).tolist()
    return "".join(f"M{x0:.2f} {y0:.2f}L{x1:.2f} {y1:.2f}" for x0, y0, x1, y1 in rows)


def write_dxf(plan: FloorPlan, path: Path) -> None:
    """Write a floor plan as lines in m on two layers; the same plan gives the same bytes.

    Raises UsageError where ezdxf is missing.
    """
    try:
        from ezdxf import options, units  # noqa: PLC0415  an optional extra
        from ezdxf.filemanagement import new  # noqa: PLC0415
    except ImportError as error:
        raise UsageError("a DXF needs ezdxf; install it with pip install 'mavnav[dxf]', or write an .svg") from error
    options.write_fixed_meta_data_for_testing = True  # no time and no random names
    drawing = new("R2000", units=units.M)
    for (layer, colour), lines in zip(LAYERS.items(), (plan.walls, plan.openings), strict=True):
        drawing.layers.add(layer, color=colour)
        for x0, y0, x1, y1 in lines.round(4).tolist():
            drawing.modelspace().add_line((x0, y0), (x1, y1), {"layer": layer})
    drawing.saveas(path)
