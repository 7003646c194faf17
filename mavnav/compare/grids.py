"""The settings of a comparison: methods and search grids, each grid with its number of yaw samples."""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING, Final

from mavnav.batch.settings import named_settings, yaw_samples
from mavnav.config.loading import load_config
from mavnav.config.models import GridSize

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mavnav.batch.settings import Setting
    from mavnav.config.models import Config

PAPER_GRIDS: Final = ("5x5", "10x10", "20x20")
"""What the paper compares in its Fig. 8, and what is compared where no grid is named."""

MOST_YAW_SAMPLES: Final = 40
"""Yaw samples that go with the finest grids: the paper's Fig. 7 pairs 40 with 40x40."""


def paired_yaw_samples(grid: GridSize) -> int:
    """Return the number of yaw samples that goes with a grid: twice its points along an axis, 40 at most.

    That holds both pairs that the paper names, 20 with 10x10 and 40 with 40x40 (its Fig. 7).
    """
    return min(2 * max(grid.nx, grid.ny), MOST_YAW_SAMPLES)


def comparison_settings(
    file: str | None,
    sets: Sequence[str],
    methods: Sequence[str],
    grids: Sequence[str],
    azimuths: Sequence[int],
    options: Mapping[str, object],
) -> list[Setting]:
    """Return a setting for every method and grid, methods in order, grids from coarse to fine.

    Parameters
    ----------
    file, sets, options
        The configuration that all of them share: as in `load_config`.
    methods
        Names; none means the configuration's own.
    grids
        ``NxM``; none means the paper's three, and a single one is joined by the configuration's own (10x10).
    azimuths
        Yaw samples: none, one number for all the grids named, or one for each of them. If none are given, a grid takes
        the configuration's own if that gives them, else `paired_yaw_samples`.

    Raises
    ------
    ConfigError
        A value that no configuration takes.
    UsageError
        Neither none, one, nor as many yaw samples as grids.
    """
    named: list[dict[str, object]] = [{"method": method} for method in methods] or [{}]
    return named_settings(
        load_config(file, sets, {**options, **method, "grid": str(grid), "azimuth": azimuth})
        for method in named
        for grid, azimuth in _searches(load_config(file, sets, {**options, **method}), grids, azimuths)
    )


def _searches(base: Config, grids: Sequence[str], azimuths: Sequence[int]) -> list[tuple[GridSize, int]]:
    """Return the grids with their yaw samples, from coarse to fine."""
    sizes = [GridSize.parse(grid) for grid in grids or PAPER_GRIDS]
    if len(grids) == 1 and base.grid not in sizes:
        sizes.append(base.grid)
    given = yaw_samples(grids or PAPER_GRIDS, azimuths)
    found = {(size, _own_samples(base, size) if n is None else n) for size, n in zip_longest(sizes, given)}
    return sorted(found, key=lambda search: (search[0].points, search[1]))


def _own_samples(base: Config, grid: GridSize) -> int:
    return base.azimuth if "azimuth" in base.model_fields_set else paired_yaw_samples(grid)
