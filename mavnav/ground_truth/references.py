"""References for the comparison of a run, besides its log: a true trajectory, a true map, relations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct

from mavnav.errors import UsageError
from mavnav.metrics.fields import ABSENT
from mavnav.metrics.reference import START_POSE, TOLERANCE_NS, Reference, map_distance, pose_errors, relation_errors
from mavnav.units import NS

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from mavnav.metrics.reference import Relations, TrueMap
    from mavnav.pose import Trajectory


class References(Struct, frozen=True):
    """The references of a run, each None if it is not given.

    ``truth`` is the true trajectory of the laser in any frame; ``true_map`` the true walls in the map frame.
    """

    truth: Trajectory | None = None
    true_map: TrueMap | None = None
    relations: Relations | None = None

    @property
    def of_poses(self) -> bool:
        """Whether there are references for the poses of a run, not only for its map."""
        return self.truth is not None or self.relations is not None

    @property
    def of_first_scan(self) -> bool:
        """Whether the true walls are known only in the frame of the first scan of a log."""
        return self.true_map is not None and self.true_map.alignment == START_POSE


def load_references(
    truth: Path | None = None, truth_map: Path | None = None, relations: Path | None = None
) -> References:
    """Read the given files; raises UsageError."""
    if truth is None and truth_map is None and relations is None:
        return References()
    from mavnav.ground_truth.tables import read_relations, read_tum  # noqa: PLC0415  few runs need them
    from mavnav.ground_truth.true_map import read_true_map  # noqa: PLC0415

    return References(
        truth=None if truth is None else read_tum(truth),
        true_map=None if truth_map is None else read_true_map(truth_map),
        relations=None if relations is None else read_relations(relations),
    )


def check_times(references: References, first_ns: int, last_ns: int) -> None:
    """Raise UsageError if a truth or relations lie outside the time of a log."""
    known = {}
    if references.truth is not None:
        known["the truth"] = references.truth.stamps_ns
    if references.relations is not None:
        columns = references.relations.stamps_ns.T
        known |= zip(("the first times of the relations", "the second times of the relations"), columns, strict=True)
    for what, stamps_ns in known.items():
        first, last = int(stamps_ns.min()), int(stamps_ns.max())
        if last < first_ns - TOLERANCE_NS or first > last_ns + TOLERANCE_NS:
            spans = f"{first * NS:.1f} to {last * NS:.1f} s, and the log, {first_ns * NS:.1f} to {last_ns * NS:.1f} s"
            raise UsageError(f"{what}, {spans}, share no time; give a reference of the same log and clock")


def compare_to(
    references: References, trajectory: Trajectory | None, occupied_xy_map_m: NDArray[np.float64]
) -> Reference | None:
    """Return the comparison of a run with its references; None without references.

    ``occupied_xy_map_m`` (n, 2) are the centres of the occupied cells. Without a trajectory (a single map file) only
    maps are compared. ATE and RPE are None if too few poses have a truth.
    """
    ate = rpe = distance = relations = ABSENT
    if references.truth is not None and trajectory is not None:
        ate, rpe = pose_errors(trajectory, references.truth)
    if references.true_map is not None:
        distance = map_distance(occupied_xy_map_m, references.true_map)
    if references.relations is not None and trajectory is not None:
        relations = relation_errors(references.relations, trajectory)
    comparison = Reference(ate, rpe, distance, relations)
    return None if comparison == Reference() else comparison
