"""The scans of a run with their poses, as input of the metrics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from mavnav.pose import Trajectory
    from mavnav.scan import LaserSpec, Scan

NEAR_M: Final = 0.1
FAR_SHORT_M, FAR_LONG_M, SHORT_SENSOR_M = 4.0, 8.0, 6.0
"""Maximum range of points: the first for sensors that reach no farther than the third, else the second."""


class Journey(Struct, frozen=True):
    """The run from which a map was made.

    ``map_T_laser`` are the poses of the tracked scans, ``scans`` reads all scans again, ``mapped_share`` is the share
    of usable scans in the map, ``lost_for_good`` and ``planar`` are those of `mavnav.slam.SlamResult`.
    """

    map_T_laser: Trajectory
    scans: Callable[[], Iterable[Scan]]
    mapped_share: float
    lost_for_good: bool = False
    planar: bool = True


class PlacedScans(Struct, frozen=True):
    """Scans of one geometry: stamps (n,), poses (n, 3) in the map frame (m, m, rad), ranges (n, beams) in m or NaN."""

    spec: LaserSpec
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    ranges_m: NDArray[np.float64]


def used_ranges_m(spec: LaserSpec) -> tuple[float, float]:
    """Return the least and greatest range, m, of points in comparisons of scans."""
    return NEAR_M, min(FAR_SHORT_M if spec.range_max_m <= SHORT_SENSOR_M else FAR_LONG_M, spec.range_max_m)


def spread(n: int, most: int) -> NDArray[np.intp]:
    """Return up to ``most`` of n rows, evenly spread."""
    return np.arange(n) if n <= most else np.linspace(0, n - 1, most).round().astype(np.intp)


def placed_scans(journey: Journey, wanted: NDArray[np.intp]) -> PlacedScans | None:
    """Read the scans of some rows of the trajectory; None without any.

    Scans with another geometry than the first are left out, because beams are compared by number.
    """
    trajectory = journey.map_T_laser
    row_of = {int(trajectory.stamps_ns[row]): row for row in wanted.tolist()}
    rows: list[int] = []
    ranges: list[NDArray[np.float64]] = []
    spec = None
    for scan in journey.scans():
        row = row_of.pop(scan.stamp_ns, None)
        if row is None:
            continue
        spec = spec or scan.spec
        if scan.spec is spec or _same_beams(scan.spec, spec):
            rows.append(row)
            ranges.append(scan.ranges_m)
    if spec is None:
        return None
    return PlacedScans(spec, trajectory.stamps_ns[rows], trajectory.xyyaw[rows], np.array(ranges))


def _same_beams(a: LaserSpec, b: LaserSpec) -> bool:
    same = a.beams == b.beams and a.range_max_m == b.range_max_m
    return same and bool(
        np.allclose((a.angle_min_rad, a.angle_step_rad), (b.angle_min_rad, b.angle_step_rad), atol=1e-6)
    )
