"""The paper's Figure 1 on recorded scans: predict, match, gate, insert."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from mavnav.methods import METHODS
from mavnav.motion import Motion
from mavnav.pose import Pose, Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mavnav.config import Config
    from mavnav.grid import Grid
    from mavnav.matcher import Match
    from mavnav.methods import Method
    from mavnav.scan import Scan

LOST_SCANS = 5
"""So many scans in a row without a believed pose are called lost; fewer are rejected scans."""

ODOMETRY_GAP_NS = 500_000_000
"""Odometry is interpolated over gaps up to this."""

SHORTEST_PERIOD_S = 1e-3
"""A log of one scan has no period."""


@dataclass(frozen=True, slots=True)
class Step:
    """What became of one scan.

    ``tracked``: the match is believed and stands in the trajectory. ``accepted``: the scan was inserted into the map
    as well. ``predicted`` is where the search began.
    """

    index: int
    stamp_ns: int
    predicted: Pose
    match: Match
    tracked: bool
    accepted: bool


@dataclass(frozen=True, slots=True)
class LostInterval:
    """A stretch of scans without a believed pose, and whether the track was found again after it."""

    start_ns: int
    end_ns: int
    scans: int
    recovered: bool


@dataclass(frozen=True, slots=True)
class Slam:
    """The outcome: a step for every scan, the poses of the tracked ones (map_T_laser), the map, the lost stretches."""

    steps: tuple[Step, ...]
    trajectory: Trajectory
    grid: Grid
    lost: tuple[LostInterval, ...]

    @property
    def lost_for_good(self) -> bool:
        """Whether the track ended before the log did."""
        return bool(self.lost) and not self.lost[-1].recovered


def track(scans: Iterable[Scan], method: Method, motion: Motion) -> Iterator[Step]:
    """Follow the laser through the scans while the method's map grows (paper, Figure 1).

    The first scan that the method can use becomes the map, and its pose the map frame. Afterwards a scan that does
    not match well enough moves neither map nor pose (paper, "Map Update").
    """
    started = False
    for index, scan in enumerate(scans):
        if not started:
            match = method.first(scan)
            predicted, tracked = match.map_T_laser, match.converged
            accepted = started = tracked
            motion = motion.started_at(predicted, scan.stamp_ns)
        else:
            predicted = motion.predict(scan.stamp_ns)
            match = method.match(scan, predicted, motion)
            tracked, accepted = method.gate(match, scan, motion)
        if accepted:
            method.insert(scan, match.map_T_laser, motion)
        if tracked:
            motion = motion.moved_to(match.map_T_laser, scan.stamp_ns)
        yield Step(index, scan.stamp_ns, predicted, match, tracked, accepted)


def place(scans: Iterable[Scan], steps: Iterable[Step], method: Method) -> Iterator[Step]:
    """Match every tracked scan once more, against the finished map, close to where it was."""
    for scan, step in zip(scans, steps, strict=True):
        yield replace(step, match=method.place(scan, step.match)) if step.tracked else step


def replay(
    log_scans: Callable[[], Iterable[Scan]],
    config: Config,
    period_s: float,
    odom_T_laser: Trajectory | None = None,
    on_step: Callable[[str, int], None] | None = None,
) -> Slam:
    """Run the configured method over a recorded log.

    Parameters
    ----------
    log_scans : gives the scans, from the first one again at every call
    config : the method, its grids and its numbers
    period_s : the sensor's time between scans, 0 if unknown
    odom_T_laser : odometry of the laser, used as the prediction
    on_step : called with the name of the pass ("track", "final pass") and the number of scans done
    """
    method = METHODS[config.method](config)
    odometry = None if odom_T_laser is None else partial(odom_T_laser.at, max_gap_ns=ODOMETRY_GAP_NS)
    motion = Motion(max(period_s, SHORTEST_PERIOD_S), odometry, method.expects_rest)
    steps = list(_told(track(log_scans(), method, motion), "track", on_step))
    return conclude(steps, log_scans, method, config, on_step)


def conclude(
    steps: list[Step],
    log_scans: Callable[[], Iterable[Scan]],
    method: Method,
    config: Config,
    on_step: Callable[[str, int], None] | None = None,
) -> Slam:
    """Make the final pass where it is wanted, and sum up."""
    if config.final_pass and method.places:
        steps = list(_told(place(log_scans(), steps, method), "final pass", on_step))
    tracked = [s for s in steps if s.tracked]
    trajectory = Trajectory.of([s.stamp_ns for s in tracked], [s.match.map_T_laser for s in tracked])
    return Slam(tuple(steps), trajectory, method.grid, tuple(lost_intervals(steps)))


def _told(steps: Iterable[Step], name: str, on_step: Callable[[str, int], None] | None) -> Iterator[Step]:
    for done, step in enumerate(steps, start=1):
        if on_step:
            on_step(name, done)
        yield step


def lost_intervals(steps: list[Step]) -> Iterator[LostInterval]:
    """Find the runs of ``LOST_SCANS`` or more scans without a believed pose."""
    run: list[Step] = []
    for step in steps:
        if not step.tracked:
            run.append(step)
            continue
        if len(run) >= LOST_SCANS:
            yield LostInterval(run[0].stamp_ns, run[-1].stamp_ns, len(run), recovered=True)
        run = []
    if len(run) >= min(LOST_SCANS, len(steps)):
        yield LostInterval(run[0].stamp_ns, run[-1].stamp_ns, len(run), recovered=False)
