"""The paper's Figure 1 on recorded scans: predict, match, gate, insert."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.beam_order import GLANCE_EVERY, backwards, is_backwards, is_plainly_told, turning_stretch
from mavnav.slam.degeneracy import NOT_ASKED, sliding
from mavnav.slam.localization import Localised
from mavnav.slam.loop_closure.detection import Loops
from mavnav.slam.loop_closure.remap import close
from mavnav.slam.method import METHODS
from mavnav.slam.motion_model import LONGEST_S, Motion, misleads
from mavnav.slam.relocalization import apart
from mavnav.slam.resampled_track import blur, coarser, in_doubt
from mavnav.slam.scan_matching import with_effort
from mavnav.slam.smoothing import steady
from mavnav.slam.steps import LostInterval, Step, Steps, lost_intervals, tracked_way
from mavnav.slam.track_state import Belief, Verdict
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mavnav.config.models import Config
    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.pose import Trajectory
    from mavnav.scan import Scan
    from mavnav.slam.method import Method
    from mavnav.slam.motion_model import Odometry
    from mavnav.slam.prior_map import KnownMap
    from mavnav.slam.scan_matching import Match

LONG_LOST_SCANS, RARELY_SCANS = 8, 64
"""The whole map is searched after so many scans without a believed pose, then ever more rarely, down to one in 64."""

ODOMETRY_GAP_NS = 500_000_000
"""Odometry is interpolated over gaps up to this."""

LEAST_TRACKED_SHARE = 0.5
"""With poses for fewer of its scans a log is lost for good: what is found again at its end by chance tracks no log."""

PLACED_AT_ONCE = 16
"""In the final pass the same is done for so many scans in a row: it is found in the processor's caches."""

SHORTEST_PERIOD_S = 1e-3
"""A log of one scan has no period."""


@dataclass(frozen=True, slots=True)
class Slam:
    """The outcome: a step for every scan, the poses of the tracked ones (map_T_laser), map, lost stretches, loops.

    ``warnings`` are lines for the user: what of the log was not taken as it stands there. ``opinions`` counts the
    tracks of which the crispest was kept.
    """

    steps: Steps
    trajectory: Trajectory
    grid: Grid
    lost: tuple[LostInterval, ...]
    loops: Loops = field(default_factory=Loops)
    warnings: tuple[str, ...] = ()
    opinions: int = 1

    @property
    def tracked_share(self) -> float:
        """The part of the scans that have a pose; 0 where there are no scans."""
        return len(self.trajectory) / max(len(self.steps), 1)

    @property
    def lost_for_good(self) -> bool:
        """Whether the track ended before the log did, or has fewer than ``LEAST_TRACKED_SHARE`` of its scans."""
        ended = bool(self.lost) and not self.lost[-1].recovered
        return ended or (bool(self.steps) and self.tracked_share < LEAST_TRACKED_SHARE)


def track(scans: Iterable[Scan], method: Method, motion: Motion) -> Iterator[Step]:
    """Follow the laser through the scans while the method's map grows (paper, Figure 1).

    The first scan that the method can use becomes the map, and its pose the map frame. Afterwards a scan that does
    not match well enough moves neither map nor pose (paper, "Map Update").
    """
    belief = None
    for index, scan in enumerate(scans):
        if belief is None:
            match = method.first(scan)
            here, tracked = motion, match.converged
            belief = Belief(motion.started_at(match.map_T_laser, scan.stamp_ns)) if tracked else None
        else:
            here = belief.here
            match = method.match(scan, here.predict(scan.stamp_ns), here)
            verdict = method.gate(match, scan, here)
            if belief.trial is None and worth_a_look(verdict, belief.missed):
                match, verdict = look_everywhere(scan, match, verdict, here, method)
            belief = belief.after(verdict, match.map_T_laser, scan.stamp_ns)
            tracked = belief.missed == 0
        if tracked:
            method.insert(scan, match.map_T_laser, here)
        yield Step(index, scan.stamp_ns, match, tracked)


def look_everywhere(scan: Scan, match: Match, verdict: Verdict, here: Motion, method: Method) -> tuple[Match, Verdict]:
    """Search the whole map: a doubtful place is believed if no other explains the scan as well, another on trial."""
    found = method.relocalise(scan, match, here)
    if found is None:
        return match, Verdict.REFUSED
    agree = verdict is Verdict.PROBABLE and not apart(found.map_T_laser, match.map_T_laser)
    return found, Verdict.SURE if agree else Verdict.PROBABLE


def worth_a_look(verdict: Verdict, missed: int) -> bool:
    """Tell whether to search the whole map: for the first doubtful places, and ever more rarely when lost."""
    if missed < LONG_LOST_SCANS:
        return verdict is Verdict.PROBABLE
    return verdict is not Verdict.SURE and (missed.bit_count() == 1 or missed % RARELY_SCANS == 0)


def settle(log_scans: Callable[[], Iterable[Scan]], steps: Steps, method: Method, motion: Motion) -> Steps:
    """Look again at the scans that were not believed, now that it is known where the track went on after them.

    From the next believed pose backwards, each is expected between its neighbours; one that convinces then enters
    trajectory and map, the others are left out for good.
    """
    before = {} if steps.column("tracked").all() else waiting(steps)
    if not before:
        return steps
    scans = {index: scan for index, scan in enumerate(log_scans()) if index in before}
    settled, after = Steps(steps), steps[-1]
    for step in reversed(steps):
        if step.index in scans and (after.stamp_ns - step.stamp_ns) * NS <= LONGEST_S:
            settled[step.index] = second_look(scans[step.index], step, before[step.index], after, method, motion)
        after = settled[step.index] if settled[step.index].tracked else after
    return settled


def waiting(steps: Iterable[Step]) -> dict[int, Step]:
    """Return the believed step before each scan that was not believed and lies between two that were."""
    before: dict[int, Step] = {}
    between: dict[int, Step] = {}
    last: Step | None = None
    for step in steps:
        if step.tracked:
            before.update(between)
            between, last = {}, step
        elif last:
            between[step.index] = last
    return before


def second_look(scan: Scan, step: Step, before: Step, after: Step, method: Method, motion: Motion) -> Step:
    """Match a scan between two believed ones; return its step, tracked if it fits there."""
    here = motion.started_at(after.match.map_T_laser, after.stamp_ns)
    here = here.coming_from(before.match.map_T_laser, before.stamp_ns)
    match = method.match(scan, here.predict(scan.stamp_ns), here)
    if method.gate(match, scan, here) is not Verdict.SURE:
        return step
    method.insert(scan, match.map_T_laser, here)
    return step._replace(match=with_effort(match, step.match, match), tracked=True)


def place(
    scans: Iterable[Scan], steps: Iterable[Step], method: Method, holds: array[float] | None = None
) -> Iterator[Step]:
    """Match every tracked scan once more, against the finished map, close to where it was.

    Steps whose scans do not come, because the run is being stopped, stay as they are. How firmly the map holds each of
    the others is added to ``holds``.
    """
    waiting, coming = iter(steps), iter(scans)
    while some := list(islice(waiting, PLACED_AT_ONCE)):
        points = [method.match_points(scan) for scan in islice(coming, len(some))]
        matches = [method.place(p, s.match) if s.tracked else s.match for p, s in zip(points, some, strict=False)]
        if holds is not None:
            placed = zip(points, some, matches, strict=False)
            holds.extend(method.hold(p, m) if s.tracked else NOT_ASKED for p, s, m in placed)
        yield from (Step(*step[:2], match, *step[3:]) for step, match in zip(some, matches, strict=False))
        yield from some[len(matches) :]


def replay(
    log_scans: Callable[[], Iterable[Scan]],
    config: Config,
    period_s: float,
    odom_T_laser: Trajectory | None = None,
    on_step: Callable[[str, int], None] | None = None,
    known: KnownMap | None = None,
) -> Slam:
    """Run the configured method over a recorded log.

    Parameters
    ----------
    log_scans : gives the scans, from the first one again at every call
    config : the method, its grids and its numbers
    period_s : the sensor's time between scans, 0 if unknown
    odom_T_laser : odometry of the laser, used as the prediction
    on_step : called with the name of the pass ("track", "track again", "final pass") and the number of scans done
    known : localise in this map, and leave it as it is, instead of making one
    """
    odometry = None if odom_T_laser is None else partial(odom_T_laser.at, max_gap_ns=ODOMETRY_GAP_NS)
    start, warnings, opinions = Start(config, max(period_s, SHORTEST_PERIOD_S), odometry, known), [], 1
    method, steps = start.tracked(log_scans(), on_step)

    def again(start: Start, scans: Callable[[], Iterable[Scan]]) -> tuple[Method, Steps] | None:
        """Track once more; None if the run is being stopped: the longer track is kept."""
        method, anew = start.tracked(scans(), on_step, "track again")
        return (method, anew) if len(anew) == len(steps) else None

    if start.odometry and misleads(start.odometry, tracked_way(steps)):
        alone = replace(start, odometry=None)
        if other := again(alone, log_scans):
            start, (method, steps) = alone, other
            warnings.append("odometry contradicts the scans and is not used; check its scale, axes and clock")
    if fires_backwards(log_scans, steps, start, method):
        turned = partial(_backwards, log_scans)
        if other := again(start, turned):
            log_scans, (method, steps) = turned, other
            warnings.append(
                "beams were fired in the reverse of the listed order, judged by the turns, and are de-skewed so"
            )
    if config.final_pass and method.closes_loops and in_doubt(steps):
        second = replace(start, config=coarser(config))
        if other := again(second, log_scans):
            opinions = 2
            if blur(*other) < blur(method, steps):
                start, (method, steps) = second, other
    if config.final_pass and method.places:
        steps = settle(log_scans, steps, method, start.motion)
    outcome = conclude(steps, log_scans, method, start.motion, start.config, on_step)
    return replace(outcome, warnings=(*warnings, *outcome.warnings), opinions=opinions)


@dataclass(frozen=True, slots=True)
class Start:
    """All that a track begins with."""

    config: Config
    period_s: float
    odometry: Odometry | None
    known: KnownMap | None = None

    @property
    def motion(self) -> Motion:
        """The laser at rest at the origin."""
        return Motion(self.period_s, self.odometry, METHODS[self.config.method](self.config).expects_rest)

    def tracked(
        self, scans: Iterable[Scan], on_step: Callable[[str, int], None] | None = None, told_as: str = "track"
    ) -> tuple[Method, Steps]:
        """Track scans from an empty map on, or in the known one."""
        method = Localised(self.config, self.known) if self.known else METHODS[self.config.method](self.config)
        return method, Steps(_told(track(scans, method, self.motion), told_as, on_step))


def _backwards(log_scans: Callable[[], Iterable[Scan]]) -> Iterator[Scan]:
    return map(backwards, log_scans())


def fires_backwards(log_scans: Callable[[], Iterable[Scan]], steps: Steps, start: Start, method: Method) -> bool:
    """Try both orders of firing where the laser turned most, each on a map of its own, unless a glance tells enough."""
    if start.config.method == "paper" or start.config.robust.deskew != "auto":
        return False
    stretch = turning_stretch(steps.column("map_T_laser")[:, 2])
    scans = list(islice(log_scans(), stretch.start, stretch.stop))
    if not any(scan.spec.time_increment_s for scan in scans):
        return False
    if is_plainly_told(*glance(scans, steps[stretch.start : stretch.stop], start.motion, method)):
        return False
    start = replace(start, known=None)
    told, other = (start.tracked(some)[1] for some in (scans, map(backwards, scans)))
    return is_backwards([s.match for s in told], [s.match for s in other])


def glance(scans: list[Scan], steps: list[Step], motion: Motion, method: Method) -> tuple[list[Match], list[Match]]:
    """Place a few tracked scans once more, as told and backwards, in the map that they made."""
    told, other = [], []
    for before, step, scan in islice(zip(steps, steps[1:], scans[1:], strict=False), 0, None, GLANCE_EVERY):
        if before.tracked and step.tracked:
            here = motion.started_at(step.match.map_T_laser, step.stamp_ns)
            here = here.coming_from(before.match.map_T_laser, before.stamp_ns)
            told.append(method.place(method.match_points(scan, here), step.match))
            other.append(method.place(method.match_points(backwards(scan), here), step.match))
    return told, other


def conclude(
    steps: Steps,
    log_scans: Callable[[], Iterable[Scan]],
    method: Method,
    motion: Motion,
    config: Config,
    on_step: Callable[[str, int], None] | None = None,
) -> Slam:
    """Close loops and make the final pass where they are wanted, and sum up; ``motion`` is as before the first scan.

    The steps themselves take what the final pass finds: there are many.
    """
    loops, holds = Loops(), None if motion.odometry else array("d")
    if config.final_pass and method.places:
        if config.loop_closure == "auto" and method.closes_loops:
            steps, method, loops = close(steps, log_scans, method, motion, config)
        method.clear_passing()
        for step in _told(place(log_scans(), steps, method, holds), "final pass", on_step):
            steps[step.index] = step
        steady(steps, motion.period_s)
    told = sliding(steps, np.array(holds)) if holds else ""
    return Slam(
        steps, tracked_way(steps), method.finished(), tuple(lost_intervals(steps)), loops, (told,) if told else ()
    )


def _told(steps: Iterable[Step], name: str, on_step: Callable[[str, int], None] | None) -> Iterator[Step]:
    for done, step in enumerate(steps, start=1):
        if on_step:
            on_step(name, done)
        yield step
