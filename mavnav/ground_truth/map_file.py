"""Map files of map_server: a YAML description and a picture, of mavnav or another tool.

Format: the ROS wiki's map_server page and nav2_map_server's README. PGM pictures (P2, P5, any depth up to 16 bits) are
read here, PNG by Pillow.
"""

from __future__ import annotations

import os
import re
import warnings
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeGuard

import numpy as np
from msgspec import Struct

from mavnav.config.named_files import read_named
from mavnav.errors import ConfigError, UsageError, brief
from mavnav.mapping.occupancy_grid import Grid, occupied_xy_m
from mavnav.pose import Pose, transform_points
from mavnav.units import LARGEST_COORDINATE_M

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from PIL import Image

MODES: Final = ("trinary", "scale", "raw")
MAX_CELLS: Final = 400_000_000
MAX_PICTURE_BYTES: Final = 1 << 30
FREE_CELLS: Final = 1 << 25
"""Pixels that a compressed picture may have even if that is more than its bytes: 290 m x 290 m in cells of 50 mm."""

BAND_ROWS: Final = 256
MAX_OCCUPIED: Final = 5_000_000
"""Maximum number of occupied cells, more than the walls of a town have; measuring them takes gigabytes."""

CELLS_M: Final = (1e-3, 100.0)
"""Least and greatest size of a cell of a map, m."""

SAVED_UNKNOWN: Final = 205
SAVED_SHADES: Final = (0, SAVED_UNKNOWN, 254)
"""Shades that map savers write; some also write a ``free_thresh`` of 0.25, by which unknown cells would be free."""

_DEEP_MODES: Final = ("I;16", "I;16B", "I")
"""Modes of Pillow for greyscale PNG of 16 bits; older versions call it ``I``."""

_GAP: Final = rb"(?:\s|#[^\n\r]*[\n\r])+"
_HEADER: Final = re.compile(rb"P([25])" + 3 * (_GAP + rb"(\d{1,9})") + rb"\s")


class MapFile(Struct, frozen=True):
    """A map from a file: ``grid`` has a hit in every occupied cell and a crossing in every free one.

    ``map_T_grid`` is the pose of the picture's lower left corner, the grid's own origin.
    """

    grid: Grid
    map_T_grid: Pose

    def occupied_xy_m(self) -> NDArray[np.float64]:
        """Return the centres of the occupied cells in the map frame, (n, 2) in m."""
        return transform_points(self.map_T_grid, occupied_xy_m(self.grid))


def read_map(path: Path) -> MapFile:
    """Read a map: the YAML file gives the name of the picture, its scale and its thresholds.

    Cells above ``occupied_thresh`` are occupied, below ``free_thresh`` free, others unknown. In mode ``raw`` the value
    of a pixel is the occupancy in per cent, and unknown above 100. Transparent pixels are unknown.

    Raises
    ------
    UsageError
        One line: which file, what is wrong with it, what to do.
    """
    from mavnav.config.yaml_layers import read_yaml  # noqa: PLC0415  yaml takes 10 ms to load

    about = read_yaml(path, "the YAML file of a map, or a run directory").tree()
    if "image" not in about or "resolution" not in about:
        raise UsageError(f"{path} describes no map, it has no image or no resolution; name a map_server YAML file")
    cell_m = _number(path, about, "resolution", None)
    if not CELLS_M[0] <= cell_m <= CELLS_M[1]:
        raise UsageError(f"{path}: resolution {cell_m:g} is no size of a cell; write meters, for example 0.05")
    if not isinstance(about["image"], str):
        raise UsageError(f"{path}: image {brief(about['image'])} is no name of a file; write one")
    shades = _read_picture(path.parent / about["image"], path)
    occupied, free = (shades.upwards(kind) for kind in _kinds(path, about, shades))
    if (count := np.count_nonzero(occupied)) > MAX_OCCUPIED:
        raise UsageError(
            f"{path}: {count} cells are occupied, more than {MAX_OCCUPIED}; see 'negate' and the thresholds"
        )
    return MapFile(Grid(cell_m, (0.0, 0.0), occupied, free), _origin(path, about))


def map_files(path: Path) -> tuple[Path, ...]:
    """Return the YAML file of a map, or the one in a run directory, and the picture that it names, if it is there."""
    from mavnav.config.yaml_layers import read_yaml  # noqa: PLC0415  yaml takes 10 ms to load

    file = path / "map.yaml" if path.is_dir() else path
    try:
        image = read_yaml(file).tree().get("image")
    except ConfigError:
        return (file,)
    picture = file.parent / str(image)
    return (file, picture) if image and os.path.lexists(picture) else (file,)


def _origin(path: Path, about: dict[str, Any]) -> Pose:
    origin = about.get("origin", [0.0, 0.0, 0.0])
    numbers = isinstance(origin, list) and all(_is_number(v) for v in origin)
    if not numbers or len(origin) not in {2, 3} or not all(abs(v) <= LARGEST_COORDINATE_M for v in origin):
        raise UsageError(f"{path}: origin {brief(origin)} is no pose; write [x, y, yaw] in m, m, rad")
    return Pose(*(float(v) for v in origin))


def _number(path: Path, about: dict[str, Any], key: str, default: float | None) -> float:
    value = about.get(key, default)
    if not _is_number(value) or not abs(value) <= LARGEST_COORDINATE_M:
        raise UsageError(f"{path}: {key} {brief(value)} is no number of use; write one")
    return float(value)


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


class _Shades(NamedTuple):
    """The pixels of a picture: ``levels`` (rows, cols) are indices into ``values`` (n,), 0 black to 255 white.

    A pixel therefore takes one or two bytes, not eight. ``solid`` (rows, cols) are those that are not transparent.
    """

    levels: NDArray[np.integer]
    values: NDArray[np.float64]
    solid: NDArray[np.bool_]

    def upwards(self, kind: NDArray[np.bool_]) -> NDArray[np.uint16]:
        """Return 1 where a pixel is of a kind (n,) and solid, 0 elsewhere, (rows, cols) with the lowest row first."""
        cells = np.empty(self.levels.shape, np.uint16)
        for row, (levels, seen) in enumerate(zip(self.levels[::-1], self.solid[::-1], strict=True)):
            cells[row] = kind[levels] & seen
        return cells


def _kinds(path: Path, about: dict[str, Any], shades: _Shades) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which values of a picture are occupied and which are free, (n,) each."""
    shade = shades.values
    mode = about.get("mode", "trinary")
    if mode not in MODES:
        raise UsageError(f"{path}: mode {mode!r} is none of {', '.join(MODES)}; write one of them")
    least, most = _number(path, about, "occupied_thresh", 0.65), _number(path, about, "free_thresh", 0.196)
    if not 0.0 <= most < least <= 1.0:
        raise UsageError(
            f"{path}: free_thresh {most:g} is not below occupied_thresh {least:g} within 0 to 1; mend them"
        )
    negate = about.get("negate")
    negate = negate if isinstance(negate, bool) else _number(path, about, "negate", 0) != 0.0
    if mode == "raw":
        share = np.where(shade <= 100.0, shade / 100.0, np.nan)
    else:
        share = (shade if negate else 255.0 - shade) / 255.0
    used = np.zeros(len(shade), np.bool_)
    for row in shades.levels:
        used[row] = True
    if mode == "trinary" and not negate and np.isin(shade[used], SAVED_SHADES).all():
        share = np.where(shade == SAVED_UNKNOWN, np.nan, share)
    return share > least, share < most


def _read_picture(path: Path, described_by: Path) -> _Shades:
    """Return the shades of the pixels."""
    try:
        data = read_named(path, MAX_PICTURE_BYTES)
    except OSError as error:
        reason = f"cannot be read: {error.strerror}"
        raise UsageError(f"{path}, the image of {described_by}, {reason}; mend 'image:'") from error
    header = _HEADER.match(data)
    return _read_by_pillow(path, data) if header is None else _read_pgm(path, header, data)


def _read_pgm(path: Path, header: re.Match[bytes], data: bytes) -> _Shades:
    kind, cols, rows, depth = (int(group) for group in header.groups())
    if not (0 < cols * rows <= MAX_CELLS and 0 < depth < 65536):
        raise UsageError(f"{path}: {cols} x {rows} pixels of depth {depth} is no map; mend its header")
    body = data[header.end() :]
    pixels: NDArray[np.integer]
    if kind == 2:
        pixels = _plain_pixels(path, body)
    elif depth > 255:
        pixels = np.frombuffer(body[: len(body) // 2 * 2], ">u2").astype(np.uint16)
    else:
        pixels = np.frombuffer(body, np.uint8)
    if len(pixels) < rows * cols:
        raise UsageError(f"{path} is cut short, {len(pixels)} of {rows * cols} pixels; get a whole copy")
    levels = pixels[: rows * cols]
    if kind == 2:
        values, levels = np.unique(levels, return_inverse=True)
    else:
        values = np.arange(1 << 8 * levels.itemsize)
    levels, solid = levels.reshape(rows, cols), np.ones((rows, cols), np.bool_)
    return _Shades(levels, values.astype(np.float64) * (255.0 / depth), solid)


def _plain_pixels(path: Path, text: bytes) -> NDArray[np.int64]:
    try:
        return np.array(re.sub(rb"#[^\n\r]*", b"", text).split(), np.int64)
    except ValueError as error:
        raise UsageError(f"{path}: a pixel is no number; get a sound copy") from error


def _read_by_pillow(path: Path, data: bytes) -> _Shades:
    from PIL import Image, UnidentifiedImageError  # noqa: PLC0415  only for pictures that need it

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(BytesIO(data), formats=("PNG", "BMP")) as image:
                _check_pixels(image.width * image.height, len(data))
                if image.mode in {"1", "L"} and "transparency" not in image.info:
                    grey = np.asarray(image.convert("L"))
                    return _Shades(grey, np.arange(256.0), np.ones(grey.shape, np.bool_))
                return _deep(image) if image.mode in _DEEP_MODES else _read_coloured(image)
    except UnidentifiedImageError as error:
        raise UsageError(f"{path} is no picture of a map (PGM or PNG); mend 'image:'") from error
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise UsageError(f"{path} is no picture of a map (PGM or PNG): {error}; mend 'image:'") from error


def _check_pixels(pixels: int, size: int) -> None:
    """Raise ValueError for so many pixels in so few bytes that most of them are blank."""
    if pixels > max(FREE_CELLS, size):
        raise ValueError(f"{pixels} pixels in {size} bytes are too many; crop it, or save it as PGM")


def _deep(image: Image.Image) -> _Shades:
    """Return the same as `_read_picture` for a PNG of 16 bits a pixel, whose conversions by Pillow clip at 255."""
    levels = np.asarray(image).astype(np.uint16)
    return _Shades(levels, np.arange(65536) * 255.0 / 65535, levels != image.info.get("transparency", -1))


def _read_coloured(image: Image.Image) -> _Shades:
    """Return the same as `_read_picture` for a picture with colours or transparency, read in bands of rows."""
    total, solid = np.empty((image.height, image.width), np.uint16), np.empty((image.height, image.width), np.bool_)
    for row in range(0, image.height, BAND_ROWS):
        band = (0, row, image.width, min(row + BAND_ROWS, image.height))
        pixels = np.asarray(image.crop(band).convert("RGBA"))
        pixels[:, :, :3].sum(axis=2, dtype=np.uint16, out=total[row : band[3]])
        solid[row : band[3]] = pixels[:, :, 3] > 0
    return _Shades(total, np.arange(766) / 3.0, solid)
