"""The table of methods, by their names in the configuration: a new method is one class and one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.slam.localization import Localizer
from mavnav.slam.paper import Paper
from mavnav.slam.robust import Robust

if TYPE_CHECKING:
    from mavnav.config.models import Config
    from mavnav.slam.method import Method
    from mavnav.slam.prior_map import PriorMap

METHODS: dict[str, type[Robust | Paper]] = {"robust": Robust, "paper": Paper}
LOCALIZERS: dict[str, type[Localizer]] = {"robust": Localizer}
"""The methods that can localize in a prior map."""


def make_method(config: Config, prior_map: PriorMap | None = None) -> Method:
    """Return the configured method with an empty map; with a prior map, the one that localizes in it."""
    return METHODS[config.method](config) if prior_map is None else LOCALIZERS[config.method](config, prior_map)


def uses_odometry(config: Config) -> bool:
    """Return whether the configured method uses the odometry of a log."""
    return METHODS[config.method].uses_odometry


def load_kernels(config: Config) -> None:
    """Load the kernels that only the configured method has, compiled the first time; others load on import."""
    METHODS[config.method].load_kernels()
