"""What a SLAM method is: what the tracker needs of it, and what the passes that look back need besides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid, GridBuilder
    from mavnav.mapping.tiled_arrays import Extent
    from mavnav.pose import Pose
    from mavnav.scan import Scan
    from mavnav.slam.motion_model import Motion
    from mavnav.slam.scan_matching import Match
    from mavnav.slam.track_state import Verdict


class Refiner(Protocol):
    """What a method can do beyond one causal step; without it there is no relocalization and no pass looks back.

    ``builds_map`` is False where the map is given: then no loop is closed, and no other track is compared.
    """

    builds_map: bool

    def relocalize(self, scan: Scan, match: Match, motion: Motion) -> Match | None:
        """Find the scan anywhere in the map; None unless exactly one place explains it. ``match`` is a hypothesis."""

    def match_between(self, scan: Scan, predicted: Pose, motion: Motion) -> Match:
        """Match a rejected scan between two accepted ones that lie far apart: not in wide regions."""

    def match_points(self, scan: Scan, motion: Motion | None = None) -> NDArray[np.float64]:
        """Return the points (n, 2) of the scan that are matched, m, laser frame; as recorded, or de-skewed."""

    def refine(self, points: NDArray[np.float64], match: Match) -> Match:
        """Match points (n, 2) of a scan, m, laser frame, against the finished map, close to an earlier match."""

    def placed_points(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> tuple[NDArray[np.float64], Extent]:
        """Return all points (n, 2) of the de-skewed scan as they enter the map, m, map frame, and their extent."""

    def observability(self, points: NDArray[np.float64], match: Match) -> tuple[float, NDArray[np.float64]]:
        """Return how well the map constrains a refined scan in its least constrained direction, 0 to 1.

        And the Hessian of half its squared distances in the map frame, (6,): xx, xy, yy, x yaw, y yaw, yaw yaw; m, rad.
        """

    def conflicts(self, points: NDArray[np.float64], match: Match) -> float:
        """Return the share of a refined scan's points that conflict with what the finished map shows as free."""

    def rival(self, points: NDArray[np.float64], match: Match) -> float:
        """Return by how much the best other heading of a refined scan costs more, as a share of the worst cost."""

    def remove_dynamic_cells(self) -> None:
        """Remove from the map what did not stay where it was seen."""


class Method(Protocol):
    """What the tracker needs; ``grid`` is the map that the method builds.

    ``expects_rest``: without odometry the laser is expected where it was. ``uses_odometry``: the log's is read.
    """

    grid: GridBuilder
    expects_rest: bool
    uses_odometry: bool

    @property
    def refiner(self) -> Refiner | None:
        """What the passes that look back need; None for a causal method."""

    def first(self, scan: Scan) -> Match:
        """Judge whether a scan can begin the map (``converged``)."""

    def match(self, scan: Scan, predicted: Pose, motion: Motion) -> Match:
        """Match the scan against the map."""

    def gate(self, match: Match, scan: Scan, motion: Motion) -> Verdict:
        """Decide whether the match is accepted; then the scan may be inserted as well."""

    def insert(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> None:
        """Add the scan to the map."""

    def finished(self) -> Grid:
        """Return the map, and forget it: of a large one there is no room for both."""
