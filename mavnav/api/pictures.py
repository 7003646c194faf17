"""A run as a picture: for notebooks and scripts."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.mapping.occupancy_grid import occupancy

if TYPE_CHECKING:
    from mavnav.api.results import Run


UNKNOWN_SHADE: Final = 0.85
"""Grey of unknown cells, between black 0 and white 1."""


def plot(run: Run, axes: Any = None) -> Any:  # noqa: ANN401  matplotlib is no dependency
    """Draw map and path with matplotlib; without it, return map.png as an image of Pillow."""
    try:
        from matplotlib import pyplot  # noqa: PLC0415  optional
    except ImportError:
        from PIL import Image  # noqa: PLC0415  heavy

        with Image.open(run.file("map.png"), formats=("PNG",)) as picture:
            return picture.convert("RGB")
    axes = axes or pyplot.subplots()[1]
    grid = run.map
    (rows, cols), (x_m, y_m) = grid.hits.shape, grid.origin_xy_m
    extent = (x_m, x_m + cols * grid.cell_m, y_m, y_m + rows * grid.cell_m)
    cells = occupancy(grid)
    shade = np.where(cells > 0, 0.0, np.where(cells == 0, 1.0, UNKNOWN_SHADE))
    axes.imshow(shade, origin="lower", extent=extent, cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
    _draw_path(run, axes)
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=f"{run.verdict['word']}: {run.verdict['reason']}")
    axes.title.set_wrap(True)
    return axes


def _draw_path(run: Run, axes: Any) -> None:  # noqa: ANN401
    """Draw the path, and what may be wrong of it in red."""
    rows = run.columns()
    xy_m, doubtful = np.array([rows["x_m"], rows["y_m"]], np.float64), np.array(rows["doubtful"], np.float64) > 0
    axes.plot(*xy_m, color="tab:blue", linewidth=1)
    if doubtful.any():
        axes.plot(*np.where(doubtful, xy_m, np.nan), color="tab:red", linewidth=2, label="may be wrong")
        axes.legend()


def html(run: Run) -> str:
    """Return the verdict and the picture of the map, if there is one, for a notebook."""
    verdict = run.verdict
    advice = f"<br>{escape(verdict['advice'])}" if verdict.get("advice") else ""
    text = f"<p><b>{escape(verdict['word'])}</b>: {escape(verdict['reason'])}{advice}</p>"
    if "map.png" not in run.metrics["outputs"]:
        return text
    data = b64encode(run.file("map.png").read_bytes()).decode("ascii")
    return f'{text}<img alt="map" style="max-width: 100%" src="data:image/png;base64,{data}">'
