"""Map files: the picture and YAML of map_server, and the raw counts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.grid import FREE, OCCUPIED, UNKNOWN, Grid

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.outputs.run import Run

_PIXELS: Final = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
_MARGIN_CELLS: Final = 2

_YAML = """\
image: map.pgm
mode: trinary
resolution: {cell_m!r}
origin: [{x_m!r}, {y_m!r}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def known_part(grid: Grid, *, hits_only: bool = False) -> Grid:
    """Cut the grid to the cells that a beam reached (or ended in) and a small margin; one cell if there is none.

    The arrays are views of the grid's.
    """
    counts = [grid.hits] if hits_only else [grid.hits, grid.passes]
    if not any(part.any() for part in counts):
        return Grid(grid.cell_m, grid.origin_xy_m, np.zeros((1, 1), np.int32), np.zeros((1, 1), np.int32))
    rows, cols = (_extent(np.flatnonzero(sum(np.any(p, axis=axis) for p in counts))) for axis in (1, 0))
    # Whole numbers of cells: the same corner however far the grid reaches.
    x_m, y_m = (
        (round(at / grid.cell_m) + part.start) * grid.cell_m
        for at, part in zip(grid.origin_xy_m, (cols, rows), strict=True)
    )
    return Grid(grid.cell_m, (x_m, y_m), grid.hits[rows, cols], grid.passes[rows, cols])


def _extent(known: NDArray[np.intp]) -> slice:
    return slice(max(int(known[0]) - _MARGIN_CELLS, 0), int(known[-1]) + 1 + _MARGIN_CELLS)


def write_pgm(run: Run, path: Path) -> None:
    """Write the known part of the map as a binary PGM: 0 occupied, 254 free, 205 unknown, largest y on top."""
    cells, of_cell = run.cells[::-1], np.zeros(256, np.uint8)
    for cell, pixel in _PIXELS.items():
        of_cell[cell] = pixel
    rows, cols = cells.shape
    with path.open("wb") as file:
        file.write(f"P5\n{cols} {rows}\n255\n".encode())
        for row in cells:
            file.write(of_cell[row.view(np.uint8)].tobytes())


def write_yaml(run: Run, path: Path) -> None:
    """Write map_server's description of ``map.pgm``; origin is the lower left corner, with all its digits."""
    grid = run.known
    x_m, y_m = (float(v) for v in grid.origin_xy_m)
    path.write_text(_YAML.format(cell_m=float(grid.cell_m), x_m=x_m, y_m=y_m), encoding="ascii")


def read_npz(path: Path) -> Grid:
    """Read the counts that `write_npz` wrote."""
    with np.load(path) as counts:
        x_m, y_m = counts["origin_xy_m"].tolist()
        return Grid(float(counts["cell_m"]), (x_m, y_m), counts["counts"], counts["passes"])


def write_npz(run: Run, path: Path) -> None:
    """Write the counts of the known part: ``counts`` and ``passes`` (rows, cols), ``cell_m``, ``origin_xy_m`` (2,).

    Row and column grow with y and x; cell [0, 0] is the lower left pixel of ``map.pgm``.
    """
    grid = run.known
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            counts=grid.hits,
            passes=grid.passes,
            cell_m=np.float64(grid.cell_m),
            origin_xy_m=np.array(grid.origin_xy_m, np.float64),
        )
