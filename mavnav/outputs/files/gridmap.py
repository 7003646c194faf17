"""Map files: the picture and YAML of map_server, also of slices by height and in scale mode, and the raw counts.

walls.csv has the cuts across the walls of a map, one a line.
"""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Iterable, Iterator
from errno import ENOENT
from functools import cached_property
from math import isfinite, prod
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import FREE, OCCUPIED, OCCUPIED_SHARE, UNKNOWN, Grid, counts, occupancy
from mavnav.mapping.slices import Slice, slice_name
from mavnav.mapping.tiled_arrays import bands
from mavnav.metrics.wall_spread import WallCuts
from mavnav.outputs.documents.run_json import Map
from mavnav.outputs.run import RunResult, require
from mavnav.units import DEG, LARGEST_COORDINATE_M, MM

_PIXELS: Final = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}

HITS_FILE: Final = "hits.npz"

FREE_CELLS, CELLS_A_BYTE = 1 << 24, 8
"""Cells that every map may have, and those that it may have besides for each byte of its file: real ones have 1 to 20
in all, and more only if they are small."""

FREE_HITS, BYTES_A_HIT = 100_000, 2
"""Cells with hits that every map may have, and bytes of the file for each of the others: real ones have 5 or more."""

CELLS_M: Final = (1e-3, 10.0)
"""Least and greatest size of a cell of a run's map, m: the least setting, forty times the greatest."""

_PACKED: Final = 1
"""Of zlib's levels: a fifth of the time of 6, up to a fifth larger."""

_YAML: Final = Path(__file__).with_name("map_server.yaml").read_text("ascii")


class GridMap(Struct, frozen=True, dict=True):
    """A map as the writers of map files take it; a run is one, too."""

    known: Grid

    @cached_property
    def cells(self) -> NDArray[np.int8]:
        """What is free, occupied and unknown, (rows, cols)."""
        return occupancy(self.known)


def map_section(grid: Grid, accepted_share: float) -> Map:
    """Describe the known part of a map, which has the scans of a share of 0 to 1."""
    rows, cols = grid.hits.shape
    return Map(
        cell_mm=grid.cell_m / MM,
        rows=rows,
        cols=cols,
        cells=int(np.count_nonzero(grid.hits)),
        hits=int(grid.hits.sum(dtype=np.int64)),
        size_m=[cols * grid.cell_m, rows * grid.cell_m],
        origin_xy_m=list(grid.origin_xy_m),
        accepted_share=accepted_share,
    )


def write_pgm(run: GridMap | RunResult, path: Path) -> None:
    """Write the known part of the map as a binary PGM: 0 occupied, 254 free, 205 unknown, largest y on top."""
    with path.open("wb") as file:
        file.writelines(pgm_rows(run))


def pgm_rows(run: GridMap | RunResult) -> Iterator[bytes]:
    """Yield the picture of `write_pgm`: its header, and its rows, a band of them at a time."""
    cells, of_cell = run.cells[::-1], np.zeros(256, np.uint8)
    for cell, pixel in _PIXELS.items():
        of_cell[cell] = pixel
    rows, cols = cells.shape
    yield f"P5\n{cols} {rows}\n255\n".encode()
    for _, _, band in bands(cells.shape):
        yield of_cell[cells[band].view(np.uint8)].tobytes()


def write_yaml(run: GridMap | RunResult, path: Path) -> None:
    """Write map_server's description of ``map.pgm``; origin is the lower left corner, with all its digits."""
    path.write_text(yaml_text(run), encoding="ascii")


def yaml_text(
    run: GridMap | RunResult,
    image: str = "map.pgm",
    *,
    yaw_rad: float = 0.0,
    mode: str = "trinary",
    occupied: str = "0.65",
    free: str = "0.196",
) -> str:
    """Return the description of `write_yaml`; ``image`` is the file of the picture, turned by ``yaw_rad``.

    ``occupied`` and ``free`` are the least share of an occupied cell and the greatest of a free one; as of map_server's
    own map saver by default.
    """
    (x_m, y_m), cell_m = map(float, run.known.origin_xy_m), float(run.known.cell_m)
    return _YAML.format(
        image=image, mode=mode, cell_m=cell_m, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, occupied=occupied, free=free
    )


def read_npz(path: Path) -> Grid:
    """Read the counts that `write_npz` wrote; raises OSError, and ValueError for anything else than them."""
    if not path.is_file():
        raise FileNotFoundError(ENOENT, "no such file", str(path))
    size = path.stat().st_size
    try:
        with zipfile.ZipFile(path) as archive:
            x_m, y_m = _read_array(archive, "origin_xy_m", 2).tolist()
            cell_m = float(_read_array(archive, "cell_m", 1))
            hits, passes = (_read_counts(archive, name, size) for name in ("counts", "passes"))
    except (OSError, ValueError, MemoryError):
        raise
    except Exception as error:  # numpy, zipfile and zlib have many
        raise ValueError(f"{path.name} is damaged ({type(error).__name__})") from error
    sound = hits.shape == passes.shape
    placed = CELLS_M[0] <= cell_m <= CELLS_M[1] and all(abs(v) <= LARGEST_COORDINATE_M for v in (x_m, y_m))
    if not (sound and placed):
        raise ValueError(f"{path.name} holds no counts of a map")
    return Grid(cell_m, (x_m, y_m), hits, passes)


def _read_counts(archive: zipfile.ZipFile, name: str, size: int) -> NDArray[np.uint16]:
    """Return counts (rows, cols) from an archive of so many bytes; raises ValueError where they can be none."""
    cells = _read_array(archive, name, FREE_CELLS + CELLS_A_BYTE * size)
    whole = cells.ndim == 2 and cells.dtype.kind in {"i", "u"}
    if not (whole and cells.min(initial=0) >= 0 and cells.max(initial=0) <= np.iinfo(np.int32).max):
        raise ValueError(f"{name} of {HITS_FILE} are no counts of a map")
    if name == "counts" and np.count_nonzero(cells) > FREE_HITS + size // BYTES_A_HIT:
        raise ValueError(f"{HITS_FILE} has more cells with hits than a file of {size} bytes can hold of a real map")
    return counts(cells)


def _read_array(archive: zipfile.ZipFile, name: str, most: int) -> NDArray[Any]:
    """Return an array of an archive; raises ValueError, before it is unpacked, for more than ``most`` elements."""
    file = f"{name}.npy"
    if archive.getinfo(file).compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
        raise ValueError(f"{HITS_FILE} is packed as numpy packs none")
    with archive.open(file) as packed:
        version = np.lib.format.read_magic(packed)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, _ = read(packed)
    if prod(shape) > most:
        raise ValueError(f"{HITS_FILE} has {prod(shape)} cells, more than a file of its size can hold of a real map")
    with archive.open(file) as packed:
        array: NDArray[Any] = np.lib.format.read_array(packed, allow_pickle=False)
    return array


def write_npz(run: GridMap | RunResult, path: Path) -> None:
    """Write the counts of the known part: ``counts`` and ``passes`` (rows, cols), ``cell_m``, ``origin_xy_m`` (2,).

    Row and column grow with y and x; cell [0, 0] is the lower left pixel of ``map.pgm``.
    """
    grid = run.known
    arrays: dict[str, NDArray[Any]] = {
        "counts": grid.hits,
        "passes": grid.passes,
        "cell_m": np.array(grid.cell_m, np.float64),
        "origin_xy_m": np.array(grid.origin_xy_m, np.float64),
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=_PACKED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                (_write_counts if array.ndim == 2 else np.lib.format.write_array)(file, array)


def _write_counts(file: IO[bytes], counts: NDArray[np.uint16]) -> None:
    """Write counts (rows, cols) as numpy writes an array of four bytes each, a band of rows at a time."""
    about = {"descr": "<i4", "fortran_order": False, "shape": counts.shape}
    np.lib.format.write_array_header_1_0(file, about)
    for _, _, band in bands(counts.shape):
        file.write(counts[band].astype("<i4").tobytes())


def slice_files(layers: Iterable[Slice]) -> list[str]:
    """Return the names of the files of some slices."""
    return [f"{slice_name(layer)}.{suffix}" for layer in layers for suffix in ("pgm", "yaml")]


def write_slice(run: RunResult, path: Path) -> None:
    """Write one of the `slice_files` of a run that has slices: map_server's picture, or its description."""
    layers = require(run.slices, "the map by height").layers
    drawn = next(GridMap(layer.grid) for layer in layers if slice_name(layer) == path.stem)
    if path.suffix == ".pgm":
        write_pgm(drawn, path)
    else:
        path.write_text(yaml_text(drawn, f"{path.stem}.pgm"), encoding="ascii")


SCALE_PICTURE: Final = "map_scale.png"
FREE_SHARE: Final = 0.002
"""Below one step of the 255 shades: a cell that no beam ended in is free."""

HALF_A_SHADE: Final = 0.5 / 255.0


def write_scale(run: RunResult, path: Path) -> None:
    """Write the picture or its description, by the name of the file.

    A pixel is darker the larger the share of the beams that ended in the cell, of those that reached it; black for all.
    Unknown cells are transparent, as map_server has it. From `OCCUPIED_SHARE` on a cell is occupied, as in map.pgm.
    """
    if path.suffix == ".yaml":
        least = f"{OCCUPIED_SHARE - HALF_A_SHADE:.4f}"
        text = yaml_text(run, SCALE_PICTURE, mode="scale", occupied=least, free=str(FREE_SHARE))
        path.write_text(text, encoding="ascii")
        return
    from PIL import Image  # noqa: PLC0415  few runs need it

    hits, pixels = run.known.hits, np.empty((*run.known.hits.shape, 2), np.uint8)
    for _, _, band in bands(hits.shape):
        seen = hits[band].astype(np.float64) + run.known.passes[band]
        share = hits[band] / np.maximum(seen, 1.0)
        pixels[band] = np.dstack((np.round(255.0 * (1.0 - share)), np.where(seen > 0, 255, 0)))
    Image.fromarray(pixels[::-1]).save(path, format="PNG")


WALLS_FILE: Final = "walls.csv"
WALL_COLUMNS: Final = ("x_m", "y_m", "direction_deg", "width_mm", "length_m")


def write_walls(run: RunResult, path: Path) -> None:
    """Write the cuts of a run."""
    write_cuts(run.measures.cuts, path)


def write_cuts(cuts: WallCuts | None, path: Path) -> None:
    """Write a row for each place where the scans saw a wall; the width is empty where the map has none to measure."""
    columns = () if cuts is None else (cuts.xy_m, cuts.direction_rad, cuts.width_m, cuts.length_m)
    with path.open("w", encoding="ascii", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(WALL_COLUMNS)
        for x, y, direction, width, length in np.column_stack(columns).tolist() if columns else ():
            wide = f"{width / MM:.2f}" if isfinite(width) else ""
            rows.writerow((f"{x:.4f}", f"{y:.4f}", f"{direction / DEG % 180.0:.2f}", wide, f"{length:.4f}"))


def read_cuts(path: Path) -> WallCuts:
    """Read the cuts of a run; raises OSError where there is no such file, ValueError where it is another."""
    with path.open(encoding="ascii", newline="") as file:
        rows = list(csv.reader(file))
    if not rows or tuple(rows[0]) != WALL_COLUMNS:
        raise ValueError(f"{path.name} has other columns")
    table = np.array([[float(value or "nan") for value in row] for row in rows[1:]], np.float64).reshape(-1, 5)
    return WallCuts(table[:, :2], table[:, 2] * DEG, table[:, 3] * MM, table[:, 4])
