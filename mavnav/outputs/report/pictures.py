"""All pictures of the runs of one log: panels for the page, and sheets of panels for files.

Close-ups show the squares where maps of the log differ most (after the paper's Figure 8).
"""

from __future__ import annotations

from collections.abc import Sequence
from string import ascii_uppercase
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from PIL.Image import Image

from mavnav.mapping.occupancy_grid import Grid, cell_centres
from mavnav.outputs.documents.quantities import why_not_meaningful
from mavnav.outputs.pictures.map_axes import Viewport, top_of_scale
from mavnav.outputs.report import panels
from mavnav.outputs.report.charts import caption, cost_panels, motion_panel, thickness_panels
from mavnav.outputs.report.entry import Entry


class Closeup(Struct, frozen=True):
    """A close-up: its letter, center, side, and its pictures by the names of the runs."""

    letter: str
    x_m: float
    y_m: float
    side_m: float
    images: dict[str, Image]


class Pictures(Struct, frozen=True):
    """The pictures of each kind, one panel per run in their order; ``shape`` is the shape of the maps.

    ``motion`` is drawn only for a single run; ``views_3d`` are those of the runs with slices.
    """

    shape: str
    maps: list[Image]
    legend: Image
    closeups: list[Closeup]
    thickness: list[Image]
    cost: list[Image]
    cost_caption: str
    motion: Image | None
    views_3d: list[Image]

    @property
    def count(self) -> int:
        """Number of pictures on the page."""
        closeups = sum(len(c.images) for c in self.closeups)
        return 3 * len(self.maps) + 1 + (self.motion is not None) + len(self.views_3d) + closeups

    def sheets(self) -> dict[str, Image]:
        """Return the pictures that are also written as files, by name."""
        columns = 1 if self.shape == "wide" else None
        sheets = {
            "maps": panels.stack([panels.sheet(self.maps, columns), panels.sheet([self.legend])]),
            "thickness": panels.sheet(self.thickness),
            "cost": panels.sheet(self.cost),
        }
        if self.motion:
            sheets["motion"] = self.motion
        if self.closeups:
            sheets["closeups"] = panels.stack([panels.sheet(list(c.images.values())) for c in self.closeups])
        return sheets


def draw(entries: Sequence[Entry]) -> Pictures:
    """Draw the runs of one log, all at the same scale.

    Maps that are not meaningful are drawn too, but affect neither scale nor close-ups, unless there are no others.
    """
    sound = [e for e in entries if not why_not_meaningful(e.document)] or entries
    window, top_hits = panels.common_window(sound), top_of_scale(e.grid for e in sound)
    places = differing_places([e.grid for e in sound], window) or _ghost_places(sound)
    alone = len(entries) == 1
    boxes = list(zip(ascii_uppercase, places, strict=False))
    return Pictures(
        shape=panels.shape(window),
        maps=[panels.map_panel(e, window, top_hits, boxes, ends=alone) for e in entries],
        legend=panels.legend_panel(entries, top_hits, ends=alone),
        closeups=[_closeup(letter, box, sound, top_hits) for letter, box in boxes],
        thickness=thickness_panels(entries),
        cost=cost_panels(entries),
        cost_caption=caption(entries),
        motion=motion_panel(entries[0]) if alone else None,
        views_3d=[e.view_3d for e in entries if e.view_3d],
    )


def _ghost_places(entries: Sequence[Entry]) -> list[Viewport]:
    """Return windows around the longest ghost walls, as close-ups of runs without differences."""
    worst = sorted((place for e in entries for place in panels.ghosts(e)), key=lambda p: -p["length_m"])[:3]
    halves = [(p, max(0.75 * p["length_m"], MIN_SIDE_M / 2)) for p in worst]
    return [Viewport(p["x_m"] - h, p["x_m"] + h, p["y_m"] - h, p["y_m"] + h) for p, h in halves]


def _closeup(letter: str, box: Viewport, entries: Sequence[Entry], top_hits: float) -> Closeup:
    images = {e.name: panels.closeup_panel(e, box, top_hits, letter) for e in entries}
    return Closeup(letter, (box.x0_m + box.x1_m) / 2, (box.y0_m + box.y1_m) / 2, box.size_m[0], images)


MAX_CLOSEUPS: Final = 3
MIN_HITS: Final = 2
"""Minimum number of hits of a wall cell; single hits are outliers as often as walls."""

TOLERANCE_CELLS: Final = 2.0
"""Displacement of a wall that is ignored if there are larger differences, in cells."""

MAX_DISTANCE_M: Final = 0.5
"""Upper bound on the displacement of a wall, also used for a wall that is missing."""

SIDE_SHARE, MIN_SIDE_M, MAX_SIDE_M = 0.12, 0.8, 4.0
MIN_CELLS: Final = 6.0
"""Minimum sum of the displacements in a close-up, in cells; smaller sums are noise."""


def differing_places(grids: Sequence[Grid], window: Viewport) -> list[Viewport]:
    """Return squares where the walls of maps in one frame differ most, the worst first; none for a single map.

    The difference at a wall cell is the largest distance, over all maps, to the map's nearest wall, minus a tolerance.
    """
    if len(grids) < 2:
        return []
    from scipy.ndimage import distance_transform_edt  # noqa: PLC0415  it loads longer than a page is drawn

    cell_m = max(g.cell_m for g in grids)
    walls = [wall_cells(g, window, cell_m) for g in grids]
    gap = np.max([distance_transform_edt(~w) if w.any() else np.full(w.shape, np.inf) for w in walls], axis=0)
    seen = np.any(walls, axis=0)
    side_m = float(np.clip(SIDE_SHARE * max(window.size_m), MIN_SIDE_M, MAX_SIDE_M))
    for tolerance in (TOLERANCE_CELLS, 0.0):
        difference = np.where(seen, np.clip(gap - tolerance, 0.0, max(MAX_DISTANCE_M / cell_m, 1.0)), 0.0)
        places = peaks(difference, max(3, round(side_m / cell_m)))
        if places:
            return [_square(row, col, side_m, window, cell_m) for row, col in places]
    return []


def wall_cells(grid: Grid, window: Viewport, cell_m: float) -> NDArray[np.bool_]:
    """Return which cells (rows, cols) of a grid over the window contain a wall of the map; row 0 at the minimum y."""
    cols, rows = (max(1, int(np.ceil(length / cell_m))) for length in window.size_m)
    middle = cell_centres(grid, *np.nonzero(grid.hits >= MIN_HITS))
    at = np.floor((middle - (window.x0_m, window.y0_m)) / cell_m).astype(np.int64)
    inside = np.all((at >= 0) & (at < (cols, rows)), axis=1)
    walls = np.zeros((rows, cols), np.bool_)
    walls[at[inside, 1], at[inside, 0]] = True
    return walls


def peaks(difference: NDArray[np.float64], side_cells: int) -> list[tuple[int, int]]:
    """Return the centers (row, col) of up to `MAX_CLOSEUPS` squares with the largest sums, without overlap."""
    from scipy.ndimage import uniform_filter  # noqa: PLC0415  as above

    left, centers = difference.copy(), []
    for _ in range(MAX_CLOSEUPS):
        content = uniform_filter(left, side_cells, mode="constant") * side_cells**2
        best = divmod(int(np.argmax(content)), content.shape[1])
        if content[best] < MIN_CELLS:
            break
        row, col = _center(left, best, side_cells)
        centers.append((row, col))
        left[_around(row, side_cells), _around(col, side_cells)] = 0.0
    return centers


def _around(middle: int, reach: int) -> slice:
    return slice(max(middle - reach, 0), middle + reach + 1)


def _center(difference: NDArray[np.float64], at: tuple[int, int], side_cells: int) -> tuple[int, int]:
    """Center a square on the weighted mean of its differences, because many squares have the same sum."""
    rows, cols = (_around(k, side_cells // 2) for k in at)
    content = difference[rows, cols]
    middle = np.indices(content.shape).reshape(2, -1) @ content.ravel() / content.sum()
    return round(rows.start + float(middle[0])), round(cols.start + float(middle[1]))


def _square(row: int, col: int, side_m: float, window: Viewport, cell_m: float) -> Viewport:
    """Return the square around a cell, moved into the window if it fits."""
    ends = ((window.x0_m, window.x1_m, col), (window.y0_m, window.y1_m, row))
    half = side_m / 2
    x, y = (
        float(np.clip(a + (k + 0.5) * cell_m, min(a + half, (a + b) / 2), max(b - half, (a + b) / 2)))
        for a, b, k in ends
    )
    return Viewport(x - half, x + half, y - half, y + half)
