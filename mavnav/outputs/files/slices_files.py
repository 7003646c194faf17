"""The maps of slices by height, each a picture and a YAML file of map_server, in the frame of ``map.pgm``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct

from mavnav.mapping.occupancy_grid import occupancy
from mavnav.mapping.slices import slice_name
from mavnav.outputs.files.gridmap import write_pgm, yaml_text

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.mapping.slices import Slice
    from mavnav.outputs.run import RunResult


class _DrawnSlice(Struct, frozen=True):
    known: Grid

    @property
    def cells(self) -> NDArray[np.int8]:
        return occupancy(self.known)


def slice_files(layers: Iterable[Slice]) -> list[str]:
    """Return the names of the files of some slices."""
    return [f"{slice_name(layer)}.{suffix}" for layer in layers for suffix in ("pgm", "yaml")]


def write_slice(run: RunResult, path: Path) -> None:
    """Write one of the `slice_files` of a run that has slices: map_server's picture, or its description."""
    layers = run.slices.layers if run.slices else ()
    drawn = next(_DrawnSlice(layer.grid) for layer in layers if slice_name(layer) == path.stem)
    if path.suffix == ".pgm":
        write_pgm(drawn, path)
    else:
        path.write_text(yaml_text(drawn, f"{path.stem}.pgm"), encoding="ascii")
