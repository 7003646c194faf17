"""A track: the steps and the map of one pass over a log, and the inputs of that pass."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice
from typing import Any

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import Grid
from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam.findings import Findings, TrackedAgain
from mavnav.slam.matching.motion_model import Motion, motions_along
from mavnav.slam.matching.odometry_fit import LogOdometry, OdometryFit
from mavnav.slam.matching.prior_map import PriorMap
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step, Steps, tracked_trajectory
from mavnav.slam.methods.registry import Method, Refiner, make_method
from mavnav.slam.tracker import track

LogScans = Callable[[], Iterable[Scan]]
"""Return the scans of a log; every call starts at the first scan."""
OnStep = Callable[[str, int], None]
"""Called with the name of the pass ("track", "close loops", "final pass", ...) and the scans done."""
Placement = Callable[[Grid], Pose | None]
"""Return the pose, in the map frame, of the frame in which a map was made; None where it has no place."""
Pass = Callable[["Track", Refiner], "Track"]
"""Return the track after a pass with its method's refiner, unchanged where the pass does not apply."""
Until = Callable[[Iterable[Step]], Iterator[Step]]
"""Yield the steps of a track up to the one that ends it."""


class Track(Struct, frozen=True):
    """A pass of the tracker over a log, and what was found out about it since.

    ``prior_map`` is the map to localize in, ``around_map`` the one in whose frame a map of its own is placed.
    ``placement`` puts the finished map elsewhere.
    ``motion`` is the state before the first scan, with the odometry that is used; ``log_odometry`` is that of the log.
    ``recorded_ns`` are the stamps (n,) of all odometry in the log, that which is left out or not asked for, too.
    The map begins with the first usable scan from number ``begin`` on. The first scan is ``start_s`` after that of the
    log.
    """

    log_scans: LogScans
    config: Config
    motion: Motion
    method: Method
    steps: Steps = field(default_factory=Steps)
    prior_map: PriorMap | None = None
    around_map: PriorMap | None = None
    placement: Placement | None = None
    on_step: OnStep | None = None
    log_odometry: LogOdometry | None = None
    begin: int = 0
    start_s: float = 0.0
    recorded_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    findings: Findings = Findings()

    @property
    def refiner(self) -> Refiner | None:
        """Refiner for the passes after tracking; None if the method has none, or in causal mode."""
        return self.method.refiner if self.config.final_pass else None

    @property
    def builds_map(self) -> bool:
        """Whether passes after tracking may change the map: they run, and the map is not given."""
        return self.refiner is not None and self.refiner.builds_map

    @property
    def odometry_contradicts(self) -> bool:
        """Whether the log has odometry, but it contradicts the scans and is not used."""
        return self.log_odometry is not None and self.motion.odometry is None

    def without_odometry(self) -> Track:
        """Return the track as of a log without odometry."""
        return replace(self, motion=self.motion._replace(odometry=None), log_odometry=None)

    def with_odometry(self, odometry: LogOdometry | None, fit: OdometryFit) -> Track:
        """Return the track before its first scan with odometry, corrected, or without; that of the log then stays."""
        motion = self.motion._replace(odometry=odometry.lookup(fit) if odometry else None)
        other = replace(self, motion=motion, log_odometry=odometry or self.log_odometry)
        return other.with_findings(odometry=fit)

    def with_findings(self, **changes: Any) -> Track:  # noqa: ANN401
        """Return the track with new values of some fields of its findings."""
        return replace(self, findings=replace(self.findings, **changes))

    def with_warning(self, text: str) -> Track:
        """Return the track with one more warning for the user."""
        return self.with_findings(warnings=(*self.findings.warnings, text))

    def with_attempt(self, name: str, *, kept: bool, refused_steps: Steps | None = None) -> Track:
        """Return the track with one more attempt to track the log again, and its steps if they are of use later."""
        attempts = (*self.findings.attempts, TrackedAgain(name, kept))
        return self.with_findings(attempts=attempts, refused_steps=refused_steps)

    def over(self, scans: Iterable[Scan], phase: str = "", until: Until | None = None) -> Track:
        """Track scans from an empty map, or in the prior map; report progress if the phase has a name.

        The steps of the scans before ``begin`` have no pose. ``until`` may end the track early.
        """
        method, coming = make_method(self.config, self.prior_map), iter(scans)
        skipped = enumerate(islice(coming, self.begin))
        before = (Step(k, scan.stamp_ns, no_match(Pose()), tracked=False) for k, scan in skipped)
        steps: Iterator[Step] = chain(before, track(coming, method, self.motion, self.begin))
        steps = until(steps) if until else steps
        return replace(self, method=method, steps=Steps(self.report_progress(steps, phase)))

    def placed_scans(self, phase: str = "") -> Iterator[tuple[Step, Scan, Motion]]:
        """Yield the tracked steps with their scans, and the motion there along the path; fewer if the run is stopped.

        Progress is reported if the phase has a name.
        """
        motions = motions_along(tracked_trajectory(self.steps), self.motion)
        steps = zip(self.report_progress(self.steps, phase), self.log_scans(), strict=False)
        tracked = (pair for pair in steps if pair[0].tracked)
        yield from ((step, scan, motion) for (step, scan), motion in zip(tracked, motions, strict=False))

    def report_progress(self, steps: Iterable[Step], phase: str) -> Iterator[Step]:
        """Yield the steps of a pass, and report the progress at each if the phase has a name."""
        for done, step in enumerate(steps, start=1):
            if self.on_step and phase:
                self.on_step(phase, done)
            yield step
