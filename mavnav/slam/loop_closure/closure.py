"""Closures: pairs of key frames that saw the same walls, the directions they constrain, and their consistency."""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING

from msgspec import Struct

from mavnav.pose import Pose
from mavnav.slam.loop_closure.pose_graph import root_information
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from mavnav.slam.loop_closure.key_frames import KeyFrame
    from mavnav.slam.matching.scan_matching import Match

SIGMA_M, SIGMA_RAD = 0.03, 0.5 * DEG
"""Standard deviations of a closure."""

NEIGHBOR_M = 10.0
"""Longest path between two closures that are compared."""

AGREE_M, AGREE_RAD = (0.15, 0.05), (2 * DEG, 1 * DEG)
"""Largest difference of two closures that agree: a constant, and the increase per metre of path between them."""

PARALLEL_RAD = 20 * DEG
"""Largest angle between the weak directions of two closures that are compared."""

SMALL_M, SMALL_RAD = 0.06, 1 * DEG
"""Largest correction by a closure that confirms the track, which then does not change."""


class KeyClosure(Struct, frozen=True):
    """Key frame ``end`` saw the same walls as key frame ``start`` (numbers of key frames); ``match`` is the evidence.

    ``weak_rad`` is the direction, frame of ``start``, in which the pose is not observable (along a plain corridor);
    None if all directions are observable.
    """

    start: int
    end: int
    start_T_end: Pose
    match: Match
    weak_rad: float | None = None

    def correction(self, keys: Sequence[KeyFrame]) -> Pose:
        """Return the corrected pose of ``end`` in its present frame, without the direction that is not observable."""
        off = keys[self.end].map_T_laser.between(keys[self.start].map_T_laser @ self.start_T_end)
        if self.weak_rad is None:
            return off
        return Pose(*across_direction(off, self.weak_rad - self.start_T_end.yaw_rad + off.yaw_rad), off.yaw_rad)

    @property
    def sqrt_information(self) -> NDArray[np.float64]:
        """Square root (3, 3) of the information matrix of x, y and yaw, frame of ``start``; 1/m, 1/m and 1/rad."""
        root = root_information(SIGMA_M, SIGMA_RAD)
        if self.weak_rad is not None:
            c, s = cos(self.weak_rad), sin(self.weak_rad)
            root[:2] = (0.0, 0.0, 0.0), (-s / SIGMA_M, c / SIGMA_M, 0.0)
        return root


def across_direction(offset: Pose, direction_rad: float) -> tuple[float, float]:
    """Return the translation (x, y) of an offset, m, without its component along a direction."""
    c, s = cos(direction_rad), sin(direction_rad)
    across_m = -s * offset.x_m + c * offset.y_m
    return -s * across_m, c * across_m


def agreeing_closures(
    closures: Sequence[KeyClosure], keys: Sequence[KeyFrame], accepted: Sequence[KeyClosure] = ()
) -> list[KeyClosure]:
    """Return the closures that agree with more of each other, and of the accepted ones, than they contradict."""
    kept, before = list(closures), len(closures) + 1
    while len(kept) < before:
        before = len(kept)
        kept = [a for a in kept if is_confirmed(a, [*accepted, *kept], keys)]
    return kept


def is_confirmed(a: KeyClosure, others: Sequence[KeyClosure], keys: Sequence[KeyFrame]) -> bool:
    """Return whether a closure agrees with more of the others than it contradicts."""
    verdicts = [agree(a, b, keys) for b in others if b is not a]
    return verdicts.count(True) > verdicts.count(False)


def agree(a: KeyClosure, b: KeyClosure, keys: Sequence[KeyFrame]) -> bool | None:
    """Return whether two closures agree in the directions that both constrain; None if they cannot be compared."""
    path_m = sum(abs(keys[p].path_m - keys[q].path_m) for p, q in ((a.start, b.start), (a.end, b.end)))
    if path_m > NEIGHBOR_M:
        return None
    starts, ends = (keys[p].map_T_laser.between(keys[q].map_T_laser) for p, q in ((a.start, b.start), (a.end, b.end)))
    end_by_a = a.start_T_end @ ends
    off = end_by_a.between(starts @ b.start_T_end)
    weak = [c.weak_rad + turn for c, turn in ((a, 0.0), (b, starts.yaw_rad)) if c.weak_rad is not None]
    if len(weak) > 1 and abs(sin(weak[0] - weak[1])) > sin(PARALLEL_RAD):
        return None
    for direction_rad in weak:
        off = Pose(*across_direction(off, direction_rad - end_by_a.yaw_rad), off.yaw_rad)
    return (
        off.distance_m <= AGREE_M[0] + AGREE_M[1] * path_m and abs(off.yaw_rad) <= AGREE_RAD[0] + AGREE_RAD[1] * path_m
    )


def is_small(correction: Pose, times: float = 1.0) -> bool:
    """Return whether a correction is within ``times`` the bounds of a small one."""
    return correction.distance_m <= times * SMALL_M and abs(correction.yaw_rad) <= times * SMALL_RAD
