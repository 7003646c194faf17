"""The table of methods by their names in the configuration; a new method takes one class and one line."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

from mavnav.kernels.machine.building import prepare
from mavnav.slam.methods.localization import Localizer
from mavnav.slam.methods.paper import Paper
from mavnav.slam.methods.robust import Robust

if TYPE_CHECKING:
    from mavnav.config.models import Config
    from mavnav.profiling import Progress
    from mavnav.slam.matching.prior_map import PriorMap
    from mavnav.slam.methods.method import Method

METHODS: dict[str, type[Robust | Paper]] = {"robust": Robust, "paper": Paper}
LOCALIZERS: dict[str, type[Localizer]] = {"robust": Localizer}
"""The methods that can localize in a prior map."""


def make_method(config: Config, prior_map: PriorMap | None = None) -> Method:
    """Return the configured method with an empty map, or its localizer if there is a prior map."""
    return METHODS[config.method](config) if prior_map is None else LOCALIZERS[config.method](config, prior_map)


def uses_odometry(config: Config) -> bool:
    """Return whether the configured method uses the odometry of a log."""
    return METHODS[config.method].uses_odometry


RARE_KERNELS: Final = ("maps.cost_floors", "maps.free_cells", "maps.height_slices", "scans.lowest_poses")
"""Modules that only loops, lost scans, slices and given maps need: compiled in 5 s when first used, or by warmup."""


def load_kernels(config: Config, progress: Progress, *, rare: bool = False) -> None:
    """Compile missing kernels of the imported modules, except those of other methods, and rare ones unless asked for.

    ``progress`` is called while kernels are compiled, which happens once on a machine.
    """
    chosen = METHODS[config.method]
    for name in chosen.own_kernels:
        import_module(f"mavnav.kernels.{name}")
    others = {name for method in METHODS.values() for name in method.own_kernels}
    prepare(progress, others.difference(chosen.own_kernels).union(() if rare else RARE_KERNELS))
