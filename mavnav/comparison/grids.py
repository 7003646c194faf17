"""The settings of a comparison: methods and search grids, each grid with its number of yaw samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from mavnav.batch.request import crossed_settings, named_settings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.batch.request import Setting
    from mavnav.config.models import Config

PAPER_GRIDS: Final = ("5x5", "10x10", "20x20")
"""The search grids of the paper's Fig. 8, compared by default."""


def comparison_settings(
    file: str | None,
    sets: Sequence[str],
    methods: Sequence[str],
    grids: Sequence[str],
    azimuths: Sequence[int],
    options: dict[str, object],
) -> list[Setting]:
    """Return a setting for every method and grid, methods in order, grids from coarse to fine.

    Parameters
    ----------
    file, sets, options
        The common configuration, as in `load_config`.
    methods
        Names of methods; if empty, the method of the configuration.
    grids
        Search grids ``NxM``; if empty, the three of the paper. A single grid is compared with that of the
        configuration (10x10).
    azimuths
        Yaw samples: none, one number for all named grids, or one per grid. If empty, those of the configuration, else
        `mavnav.config.models.paired_yaw_samples`.

    Raises
    ------
    ConfigError
        A value is not valid in a configuration.
    UsageError
        The number of yaw samples is neither 0, 1, nor the number of grids.
    """
    configs: list[Config] = []
    for method in [[name] for name in methods] or [[]]:
        settings = crossed_settings(file, sets, method, grids or PAPER_GRIDS, azimuths, options)
        if len(grids) == 1:
            settings += crossed_settings(file, sets, method, (), (), options)
        configs += sorted((each.config for each in settings), key=lambda c: (c.grid.points, c.azimuth))
    return named_settings(configs)
