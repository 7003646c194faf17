"""The settings of a comparison: methods and search grids, each grid with its azimuth grid."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from mavnav.config.loading import load_config
from mavnav.config.models import GridSize
from mavnav.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mavnav.config.models import Config

PAPER_GRIDS: Final = ("5x5", "10x10", "20x20")
"""What the paper compares in its Fig. 8, and what is compared where no grid is named."""

MOST_AZIMUTH: Final = 40
"""Points of the azimuth grid that go with the finest grids: the paper's Fig. 7 pairs 40 with 40x40."""


def paired_azimuth(grid: GridSize) -> int:
    """Return the azimuth grid that goes with a grid: twice its points along an axis, 40 at most.

    That holds both pairs that the paper names, 20 with 10x10 and 40 with 40x40 (its Fig. 7).
    """
    return min(2 * max(grid.nx, grid.ny), MOST_AZIMUTH)


def settings(
    file: str | None,
    sets: Sequence[str],
    methods: Sequence[str],
    grids: Sequence[str],
    azimuths: Sequence[int],
    options: Mapping[str, object],
) -> list[Config]:
    """Return a configuration for every method and grid, methods in order, grids from coarse to fine.

    Parameters
    ----------
    file, sets, options
        The configuration that all of them share: as in `load_config`.
    methods
        Names; none means the configuration's own.
    grids
        ``NxM``; none means the paper's three, and a single one is joined by the configuration's own (10x10).
    azimuths
        None, one for all the grids named, or one for each of them. Without, a grid takes the configuration's own if
        that gives one, else `paired_azimuth`.

    Raises
    ------
    ConfigError
        A value that no configuration takes.
    UsageError
        Neither none, one, nor as many azimuth grids as grids.
    """
    chosen: dict[str, Config] = {}
    for method in ({"method": method} for method in methods) if methods else ({},):
        shared = dict(options) | method
        for grid, azimuth in _pairs(load_config(file, sets, shared), grids, azimuths):
            config = load_config(file, sets, shared | {"grid": str(grid), "azimuth": azimuth})
            chosen.setdefault(config.model_dump_json(), config)
    return list(chosen.values())


def _pairs(base: Config, grids: Sequence[str], azimuths: Sequence[int]) -> list[tuple[GridSize, int]]:
    """Give every grid its azimuth grid; from coarse to fine."""
    sizes = [GridSize.parse(grid) for grid in grids or PAPER_GRIDS]
    if len(azimuths) not in {0, 1, len(sizes)}:
        raise UsageError(
            f"{len(azimuths)} values of --azimuth for {len(sizes)} grids; give none, one for all, or one for each"
        )
    own = [_azimuth(base, size) for size in sizes]
    pairs = set(zip(sizes, (list(azimuths) * len(sizes))[: len(sizes)] or own, strict=True))
    if len(grids) == 1 and base.grid not in sizes:
        pairs.add((base.grid, _azimuth(base, base.grid)))
    return sorted(pairs, key=lambda pair: (pair[0].points, pair[1]))


def _azimuth(base: Config, grid: GridSize) -> int:
    return base.azimuth if "azimuth" in base.model_fields_set else paired_azimuth(grid)
