"""The table of methods by their names in the configuration, and what tracker and later passes need of a method."""

from __future__ import annotations

from importlib import import_module
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.kernels.machine.building import prepare
from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.mapping.tiled_arrays import Extent
from mavnav.pose import Pose
from mavnav.profiling import Progress
from mavnav.scan import Scan
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.prior_map import PriorMap
from mavnav.slam.matching.scan_matching import Match, MatchVerdict
from mavnav.slam.methods.fused import Fused
from mavnav.slam.methods.localization import Localizer
from mavnav.slam.methods.paper import Paper


class Refiner(Protocol):
    """Interface for relocalization and for the passes after tracking; a method without it runs neither.

    ``builds_map`` is False where the map is given: then no loop is closed, and no other track is compared.
    """

    builds_map: bool

    def reserve_whole_map_search(self, scan: Scan) -> bool:
        """Spend the work of ``relocalize`` if the budget covers it; return whether it does."""

    def relocalize(self, scan: Scan, match: Match, motion: Motion) -> Match | None:
        """Find the scan anywhere in the map; None unless exactly one pose fits. ``match`` is a further hypothesis."""

    def match_points(self, scan: Scan, motion: Motion | None = None) -> NDArray[np.float64]:
        """Return the points (n, 2) of the scan for matching, m, laser frame; de-skewed if the motion is given."""

    def refine(self, points: NDArray[np.float64], match: Match) -> Match:
        """Match points (n, 2), m, laser frame, against the finished map, close to an earlier match."""

    def placed_points(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> tuple[NDArray[np.float64], Extent]:
        """Return all points (n, 2) of the de-skewed scan for insertion, m, map frame, and their extent."""

    def sweep_T_mid(self, scan: Scan, motion: Motion) -> Pose:
        """Return the pose of the laser at mid-sweep, seen from that at which the scan as recorded fits best."""

    def observability(self, points: NDArray[np.float64], match: Match) -> tuple[float, NDArray[np.float64]]:
        """Return how well the map constrains a refined scan in its least constrained direction (0 to 1), and a Hessian.

        The Hessian (6,) is that of half the squared distances, map frame: xx, xy, yy, x yaw, y yaw, yaw yaw; m, rad.
        """

    def conflicts(self, points: NDArray[np.float64], match: Match) -> float:
        """Return the share of visibility conflicts of a refined scan with the finished map."""

    def remove_dynamic_cells(self) -> None:
        """Remove the hits of dynamic cells from the map."""


class Method(Protocol):
    """Interface for the tracker; ``grid`` is the map that the method builds.

    ``expects_rest``: without odometry the last pose is the prediction. ``uses_odometry``: odometry of the log is used.
    """

    grid: GridBuilder
    expects_rest: bool
    uses_odometry: bool

    @property
    def refiner(self) -> Refiner | None:
        """Refiner for the passes after tracking; None for a causal method."""

    def first(self, scan: Scan) -> Match:
        """Return the first match; ``converged`` if the scan can begin the map."""

    def match(self, scan: Scan, predicted: Pose, motion: Motion) -> Match:
        """Match the scan against the map."""

    def gate(self, match: Match, scan: Scan, motion: Motion) -> MatchVerdict:
        """Decide whether to accept the match."""

    def insert(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> None:
        """Add the scan to the map."""

    def release_map(self) -> Grid:
        """Return the map and release the working copy: two copies of a large map may not fit into memory."""


METHODS: dict[str, type[Fused | Paper]] = {"robust": Fused, "paper": Paper}
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
