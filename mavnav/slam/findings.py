"""What is found out about a track after its first pass: attempts, loops, parts, evidence and doubt."""

from __future__ import annotations

from functools import partial
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.pose import Pose, Trajectory
from mavnav.scan import Line
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, OdometryFit
from mavnav.slam.matching.steps import Step, Steps

HIGH: Final = 0.5
"""Probability above which a track is marked as doubtful."""

NOT_PLANAR: Final = "not planar"
"""The reason with which a map of the plane is meaningless."""

SECOND_LOST: Final = "a second track is lost"
"""The reason that another track of the same log has not all of its poses."""

SECOND_MOTION: Final = "another motion fits as well"
"""The reason that something large moves with the laser, or past it."""


class Edge(Struct, frozen=True):
    """Pose ``end`` was measured from pose ``start`` (numbers of poses).

    ``sqrt_information`` (3, 3) is the square root of the information matrix of x, y (m) and yaw (rad) in the frame of
    ``start``: a diagonal of inverse standard deviations, or a row of zeros for an unconstrained direction.
    """

    start: int
    end: int
    start_T_end: Pose
    sqrt_information: NDArray[np.float64]


class Loop(Struct, frozen=True):
    """A closed loop: the scan of row ``end`` of the trajectory lies at ``start_T_end`` from that of row ``start``.

    ``correction`` is the corrected pose of the later scan in its tracked frame, without the direction that is not
    observable. ``inliers`` is the share of its points that agree.
    """

    start: int
    end: int
    start_T_end: Pose
    correction: Pose
    inliers: float


class PoseGraph(Struct, frozen=True):
    """The pose graph of a track: the rows of the key frames in the trajectory, and the edges between key frames."""

    rows: tuple[int, ...]
    edges: tuple[Edge, ...]


class Loops(Struct, frozen=True):
    """The closed loops, the number of closures that were measured and refused, and the corrected poses.

    ``map_T_laser`` is None if the track does not change, ``graph`` is None if no loop was searched.
    """

    closed: tuple[Loop, ...] = ()
    refused: int = 0
    map_T_laser: Trajectory | None = None
    graph: PoseGraph | None = None


class Reason(NamedTuple):
    """A reason to doubt a track: its stretch from and to a scan, stamps in ns, and its largest value there."""

    name: str
    start_ns: int
    end_ns: int
    value: float


class Doubt(Struct, frozen=True):
    """The probability that an accepted track is wrong somewhere, and the reasons, the strongest first.

    ``tried`` names what was done because of it.
    """

    probability: float
    reasons: tuple[Reason, ...] = ()
    tried: tuple[str, ...] = ()

    @property
    def high(self) -> bool:
        """Whether the track is marked as doubtful."""
        return self.probability > HIGH

    def marks(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which of the scans (n,) are doubtful: those of the reasons, if the doubt is high.

        A reason that holds for all scans marks them only if there is no other reason.
        """
        marked_by_reason = [(stamps_ns >= r.start_ns) & (stamps_ns <= r.end_ns) for r in self.reasons if self.high]
        local = [some for some in marked_by_reason if not some.all()]
        return np.asarray(np.any([np.zeros(len(stamps_ns), np.bool_), *(local or marked_by_reason)], axis=0))


class TrackedAgain(NamedTuple):
    """An attempt to track a log again with one thing changed, and whether its track was kept."""

    name: str
    kept: bool


class Findings(Struct, frozen=True):
    """What is found out about a track.

    ``warnings`` are lines for the user. ``refused_steps`` are those of the last attempt if it was not kept. ``parts``
    are the accepted steps of each stretch that was tracked on a separate map. ``by_odometry_m`` (n,) is the error to be
    expected of the steps that are placed by odometry alone, 0 for the others; empty without parts. ``observed`` and
    ``conflicts`` (n,) are the observability and the visibility conflicts of the steps in the finished map, ``hessians``
    (n, 6) their Hessians, from which covariances are computed; empty before the final pass. ``doubt`` is None where it
    was not judged. ``map_T_begin`` is the pose at which the scan that begins the map was put in the map frame, if it
    was. ``odometry`` is what corrects the odometry; ``sweep_s`` the time of a sweep where it is another than stated,
    None where it is not. ``floor_m`` is the line from which on returns are left out (`scan_before`), if any are.
    """

    warnings: tuple[str, ...] = ()
    attempts: tuple[TrackedAgain, ...] = ()
    refused_steps: Steps | None = None
    parts: tuple[tuple[Step, ...], ...] = ()
    by_odometry_m: NDArray[np.float64] = field(default_factory=partial(np.zeros, 0))
    loops: Loops = Loops()
    observed: NDArray[np.float64] = field(default_factory=partial(np.zeros, 0))
    conflicts: NDArray[np.float64] = field(default_factory=partial(np.zeros, 0))
    hessians: NDArray[np.float64] = field(default_factory=partial(np.zeros, (0, 6)))
    doubt: Doubt | None = None
    map_T_begin: Pose | None = None
    sweep_s: float | None = None
    odometry: OdometryFit = GOOD_ODOMETRY
    floor_m: Line | None = None
