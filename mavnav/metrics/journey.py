"""The scans of a run with their poses, as input of the metrics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import tau
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import Trajectory
from mavnav.scan import SAME_RAD, Floats, LaserSpec, Scan
from mavnav.units import NS

Scans = Callable[[], Iterable[Scan]]
"""Reads all scans again at every call."""

PAUSE_NS: Final = round(1000.0 / NS)
"""Between two sessions, so that no two scans of different ones are neighbors in time."""

NEAR_M: Final = 0.1
FAR_SHORT_M, FAR_LONG_M, SHORT_SENSOR_M = 4.0, 8.0, 6.0
"""Maximum range of points: the first for sensors that reach no farther than the third, else the second."""


class Journey(Struct, frozen=True):
    """The run from which a map was made.

    ``map_T_laser`` are the poses of the tracked scans, ``scans`` reads all scans again, ``mapped_share`` is the share
    of usable scans in the map, ``lost_for_good`` and ``planar`` are those of `mavnav.slam.SlamResult`.
    """

    map_T_laser: Trajectory
    scans: Scans
    mapped_share: float
    lost_for_good: bool = False
    planar: bool = True


def one_after_another(tracks: Sequence[tuple[Trajectory, Scans]], mapped_share: float) -> Journey:
    """Return the tracks of several sessions in one map frame as one, each `PAUSE_NS` after the end of that before."""
    begins_ns = np.array([poses.stamps_ns[0] for poses, _ in tracks])
    lasting_ns = np.array([poses.stamps_ns[-1] for poses, _ in tracks]) - begins_ns + PAUSE_NS
    shifts_ns = np.cumsum(lasting_ns) - lasting_ns - begins_ns
    stamps_ns = [poses.stamps_ns + shift_ns for (poses, _), shift_ns in zip(tracks, shifts_ns, strict=True)]

    def scans() -> Iterator[Scan]:
        for (_, read), shift_ns in zip(tracks, shifts_ns.tolist(), strict=True):
            yield from (replace(scan, stamp_ns=scan.stamp_ns + shift_ns) for scan in read())

    together = Trajectory(np.concatenate(stamps_ns), np.concatenate([poses.xyyaw for poses, _ in tracks]))
    return Journey(together, scans, mapped_share)


class PlacedScans(Struct, frozen=True):
    """Scans on the beams of one geometry: stamps (n,), poses (n, 3) in the map frame (m, m, rad), ranges (n, beams).

    Ranges are in m, NaN without a return. ``others`` are the scans, by number, that were recorded with another
    geometry: in ``ranges_m`` each beam has the range of their nearest one, and none where they did not look.
    """

    spec: LaserSpec
    stamps_ns: NDArray[np.int64]
    poses: Floats
    ranges_m: Floats
    others: dict[int, Scan] = field(default_factory=dict)

    def recorded_beams(self, k: int) -> tuple[Floats, Floats]:
        """Return the ranges (beams,), m, and directions (beams, 2) of scan ``k`` as they were recorded."""
        if other := self.others.get(k):
            return other.ranges_m, other.spec.directions
        return self.ranges_m[k], self.spec.directions


class UsedBeams(NamedTuple):
    """The points of a scan in comparisons: bearing of the first beam and step (rad), least and greatest range (m).

    Kernels take it as an array (4,).
    """

    first_rad: float
    step_rad: float
    near_m: float
    far_m: float


def used_beams(spec: LaserSpec) -> UsedBeams:
    """Return the points of a laser's scans that are compared."""
    far_m = FAR_SHORT_M if spec.range_max_m <= SHORT_SENSOR_M else FAR_LONG_M
    return UsedBeams(spec.angle_min_rad, spec.angle_step_rad, NEAR_M, min(far_m, spec.range_max_m))


def spread(n: int, most: int) -> NDArray[np.intp]:
    """Return up to ``most`` of n rows, evenly spread."""
    return np.arange(n) if n <= most else np.linspace(0, n - 1, most).round().astype(np.intp)


def placed_scans(journey: Journey, wanted: NDArray[np.intp]) -> PlacedScans | None:
    """Read the scans of some rows of the trajectory; None without any.

    Beams are compared by number: scans are brought to the geometry that most of them have.
    """
    trajectory = journey.map_T_laser
    row_of = {int(trajectory.stamps_ns[row]): row for row in wanted.tolist()}
    scan_of = {row: s for s in journey.scans() if (row := row_of.pop(s.stamp_ns, None)) is not None}
    if not scan_of:
        return None
    rows, scans = list(scan_of), list(scan_of.values())
    ((spec, _),) = Counter(scan.spec for scan in scans).most_common(1)
    others = {k: scan for k, scan in enumerate(scans) if not (scan.spec is spec or _same_beams(scan.spec, spec))}
    ranges_m = [_on_beams(scan, spec) if k in others else scan.ranges_m for k, scan in enumerate(scans)]
    return PlacedScans(spec, trajectory.stamps_ns[rows], trajectory.xyyaw[rows], np.array(ranges_m), others)


def _on_beams(scan: Scan, spec: LaserSpec) -> Floats:
    """Return the ranges (beams,) of a scan on the beams of another geometry, of its nearest beam within half a step."""
    own, step_rad = scan.spec, max(abs(scan.spec.angle_step_rad), SAME_RAD)
    off_rad = (spec.angles_rad - own.angle_min_rad) * np.sign(own.angle_step_rad) % tau
    off_rad[off_rad > tau - 0.5 * step_rad] = 0.0
    beam = np.floor(off_rad / step_rad + 0.5).astype(np.intp)
    return np.where(beam < own.beams, scan.ranges_m[np.minimum(beam, own.beams - 1)], np.nan)


def _same_beams(a: LaserSpec, b: LaserSpec) -> bool:
    same = (a.beams, a.range_max_m) == (b.beams, b.range_max_m)
    return same and np.allclose((a.angle_min_rad, a.angle_step_rad), (b.angle_min_rad, b.angle_step_rad), atol=1e-6)
