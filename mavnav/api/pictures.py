"""A run as a picture: for notebooks and scripts."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from html import escape
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import Grid, occupancy

Path = tuple[NDArray[np.float64], NDArray[np.bool_]]


UNKNOWN_SHADE: Final = 0.85
"""Grey of unknown cells, between black 0 and white 1."""


def plot(grid: Grid, path: Path, title: str, axes: Any = None) -> Any:  # noqa: ANN401  matplotlib is no dependency
    """Draw a map and a path into axes of matplotlib, new ones if none are given; None without matplotlib.

    ``path`` has the positions (n, 2) in the map frame, m, NaN where not tracked, and (n,) whether they may be wrong.
    """
    try:
        from matplotlib import pyplot  # noqa: PLC0415  optional
    except ImportError:
        return None
    axes = axes or pyplot.subplots()[1]
    cells, (rows, cols), (x_m, y_m) = occupancy(grid), grid.hits.shape, grid.origin_xy_m
    extent = (x_m, x_m + cols * grid.cell_m, y_m, y_m + rows * grid.cell_m)
    shade = np.where(cells > 0, 0.0, np.where(cells == 0, 1.0, UNKNOWN_SHADE))
    axes.imshow(shade, origin="lower", extent=extent, cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
    xy_m, doubtful = path
    axes.plot(*xy_m.T, color="tab:blue", linewidth=1)
    if doubtful.any():
        axes.plot(*np.where(doubtful[:, None], xy_m, np.nan).T, color="tab:red", linewidth=2, label="may be wrong")
        axes.legend()
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.set_title(title, wrap=True)
    return axes


def html(verdict: Mapping[str, str], png: bytes | None) -> str:
    """Return a verdict, and the picture of the map if there is one, for a notebook."""
    advice = f"<br>{escape(verdict['advice'])}" if verdict.get("advice") else ""
    text = f"<p><b>{escape(verdict['word'])}</b>: {escape(verdict['reason'])}{advice}</p>"
    if png is None:
        return text
    data = b64encode(png).decode("ascii")
    return f'{text}<img alt="map" style="max-width: 100%" src="data:image/png;base64,{data}">'
