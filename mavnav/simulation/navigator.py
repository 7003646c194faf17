"""What a vehicle knows in flight: its pose and map over the scans so far, which the loops that it closes correct."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct

from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, transform_points
from mavnav.scan import Scan
from mavnav.simulation.world.scenario import Scenario
from mavnav.slam.findings import Loops
from mavnav.slam.loop_closure.detection import LOOP_M, close_loops
from mavnav.slam.matching.motion_model import motions_along
from mavnav.slam.matching.steps import Step, Steps, tracked_trajectory
from mavnav.slam.track import Track
from mavnav.slam.tracker import track


class Obstacles(Struct, frozen=True):
    """What the planner goes round: the whole map, or of an aerial vehicle that knows its attitude a slice of it.

    ``slice_m`` are the lower and upper end of the slice, None for the whole map.
    """

    grid: GridBuilder
    slice_m: tuple[float, float] | None = None

    @classmethod
    def of(cls, scenario: Scenario, whole: GridBuilder) -> Obstacles:
        """Take the map of the SLAM method as it is, or begin a slice of the same cells where scans are levelled."""
        if scenario.flight is None or not scenario.levels_scans:
            return cls(whole)
        return cls(GridBuilder(whole.cell_m), scenario.flight.slice_m)

    def note(self, scan: Scan, step: Step) -> None:
        """Count the returns of an accepted scan in the slice; their beams have not left it, as the laser is in it."""
        if self.slice_m is None or scan.heights_m is None or not step.tracked:
            return
        low_m, high_m = self.slice_m
        with np.errstate(invalid="ignore"):  # NaN: no return
            within = (scan.heights_m > low_m) & (scan.heights_m < high_m)
        xy_m = scan.ranges_m[within, None] * scan.spec.directions[within]
        self.grid.insert(step.match.map_T_laser, transform_points(step.match.map_T_laser, xy_m))


class Navigator:
    """Tracks a vehicle through its scans as they come; ``flown`` is the track so far, ``obstacles`` what it must avoid.

    Loops are closed as after a log ("Loop closure"), once every ``LOOP_M`` of path: path and map change then.
    """

    def __init__(self, scenario: Scenario, coming: Iterator[Scan], seen: Sequence[Scan], start: Track) -> None:
        """Begin with the first of the scans, which are in ``seen`` once they came; ``start`` has no steps yet."""
        self.flown, self._scenario, self._coming, self._seen = start, scenario, coming, seen
        self._tracking = track(coming, start.method, start.motion)
        self._obstacles = Obstacles.of(scenario, start.method.grid)
        self._here, self._path_m, self._search_m = Pose(), 0.0, LOOP_M

    @property
    def obstacles(self) -> GridBuilder:
        """The map that the planner uses."""
        return self._obstacles.grid

    @property
    def steps(self) -> Steps:
        """The steps so far, at the corrected poses."""
        return self.flown.steps

    def locate(self) -> Step:
        """Return the step of the next scan."""
        step, here = next(self._tracking), self._here
        self.steps.append(step)
        self._obstacles.note(self._seen[-1], step)
        if not step.tracked:
            return step
        self._here = step.match.map_T_laser
        self._path_m += here.gap(self._here)[0]
        if self._path_m >= self._search_m:
            self._search_m = self._path_m + LOOP_M
            self._close_loops()
        return self.steps[-1]

    def _close_loops(self) -> None:
        """Close the loops of the path so far, and go on in the map at its corrected poses, if that changes them."""
        refiner, steps = self.flown.refiner, self.steps
        closed = close_loops(self.flown, refiner) if refiner else self.flown
        if closed.method is self.flown.method:
            return
        *_, here = motions_along(tracked_trajectory(closed.steps), closed.motion)
        self._here = here.map_T_laser
        self._tracking = track(self._coming, closed.method, here._replace(odometry=closed.motion.odometry), len(steps))
        self._obstacles = Obstacles.of(self._scenario, closed.method.grid)
        for scan, step in zip(self._seen, closed.steps, strict=True):
            self._obstacles.note(scan, step)
        self.flown = closed.with_findings(loops=Loops())
