"""The paper's Figure 1, closed: scan, virtual scan, match, map update, potential field, noisy command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum
from itertools import pairwise
from math import inf

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.scan import Attitude, Scan, level_scan
from mavnav.simulation.planner.potential_field import MotionCommand, Planner
from mavnav.simulation.vehicle import Vehicle, disturbance, sweeping, tilts_over, vehicle_of
from mavnav.simulation.world.laser import LaserModel, take_scan
from mavnav.simulation.world.scenario import Scenario, laser_model
from mavnav.simulation.world.shapes import XY
from mavnav.slam.findings import Loops
from mavnav.slam.loop_closure.detection import LOOP_M, close_loops
from mavnav.slam.matching.motion_model import Motion, motions_along
from mavnav.slam.matching.steps import Step, tracked_trajectory
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import finish
from mavnav.slam.result import SlamResult
from mavnav.slam.track import OnStep, Track
from mavnav.slam.tracker import track
from mavnav.units import NS


class End(StrEnum):
    """Why a mission ended."""

    GOAL = "goal"
    WRONG_PLACE = "believed to be at the goal, but is elsewhere"
    WRONG_WAY = "the estimated path passes via_m, the true one does not"
    COLLISION = "collision"
    STUCK = "stuck"
    STEP_LIMIT = "step limit"
    LOST = "tracking lost"


class Mission(Struct, frozen=True):
    """How a mission went; lengths of the true path, m. ``goal_distance_m`` is the true one at the end.

    ``steps`` are the scans taken; a command may take several.
    """

    end: End
    steps: int
    path_length_m: float
    min_clearance_m: float
    goal_distance_m: float

    @property
    def reached(self) -> bool:
        """Whether the vehicle reached via_m and the goal, by its own estimate and in truth."""
        return self.end is End.GOAL


class Flight(Struct, frozen=True):
    """A finished mission: what SLAM made of it, the scans, and the truth.

    ``map_T_laser`` and ``odom_T_base`` hold the true pose and the commanded one for every scan; ``world_T_map`` is the
    true first laser pose, where the map frame begins. ``tilts`` are the true attitudes of the laser at every scan,
    ``attitudes`` the measured ones; both are empty of a vehicle that moves level.
    """

    scenario: Scenario
    slam: SlamResult
    mission: Mission
    scans: tuple[Scan, ...]
    map_T_laser: Trajectory
    odom_T_base: Trajectory
    world_T_map: Pose
    tilts: tuple[Attitude, ...] = ()
    attitudes: tuple[Attitude, ...] = ()


def fly(scenario: Scenario, on_step: OnStep | None = None) -> Flight:
    """Fly a mission until its goal is reached or lost; every number of it follows from the scenario and its seed.

    The pilot sees the estimated pose and the map built so far, never the truth.
    """
    config, laser = scenario.slam, _laser(scenario)
    noise = np.random.default_rng([scenario.seed, 1])
    vehicle = vehicle_of(scenario, laser.spec.scan_time_s)
    pilot = Pilot(scenario)
    method = make_method(config)
    odometry = vehicle.odometry if scenario.uses_odometry else None
    motion = Motion(laser.spec.scan_time_s, odometry, method.expects_rest, commanded=scenario.uses_odometry)
    scans: list[Scan] = []
    seen: list[Scan] = [] if scenario.levels_scans else scans
    coming = _level(_scans(scenario, vehicle, scans), scenario, vehicle, seen)
    navigator = Navigator(scenario, coming, seen, Track(lambda: seen, config, motion, method))
    executing: Iterator[None] = iter(())
    while True:
        flown = navigator.flown
        step = navigator.locate()
        if navigator.flown is not flown:
            pilot.review(tracked_trajectory(navigator.flown.steps))
        if on_step:
            on_step("fly", step.index + 1)
        here = pilot.locate(step, vehicle.odometry(step.stamp_ns))
        if next(executing, DONE) is DONE:
            decision = pilot.decide(step, here, navigator.obstacles.grid)
            if isinstance(decision, End):
                end = decision
                break
            executing = vehicle.execute(decision, disturbance(scenario, noise, decision))
            next(executing)
        if _closest_m(scenario, vehicle.world_T_base[-2:]) < scenario.vehicle.radius_m:
            end = End.COLLISION
            break
    return _sum_up(scenario, vehicle, scans, end, finish(replace(navigator.flown, on_step=on_step)))


DONE = object()
"""What a finished command gives instead of a further scan."""

SAMPLES = 6
"""Number of points of a step at which the clearance is looked at, its ends included."""

SPACING_RADII = 0.5
"""Largest distance of these points, in radii of the vehicle."""

TOLERANCE_RADII = 2.0
"""Distance from a position in truth at which it still counts as reached, in radii of the goal."""


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
        self.obstacles = Obstacles.of(scenario, start.method.grid)
        self._here, self._path_m, self._search_m = Pose(), 0.0, LOOP_M

    def locate(self) -> Step:
        """Return the step of the next scan."""
        step, here = next(self._tracking), self._here
        self.flown.steps.append(step)
        self.obstacles.note(self._seen[-1], step)
        if not step.tracked:
            return step
        self._here = step.match.map_T_laser
        self._path_m += here.gap(self._here)[0]
        if self._path_m >= self._search_m:
            self._search_m = self._path_m + LOOP_M
            self._close_loops()
        return self.flown.steps[-1]

    def _close_loops(self) -> None:
        """Close the loops of the path so far, and go on in the map at its corrected poses, if that changes them."""
        refiner, steps = self.flown.refiner, self.flown.steps
        closed = close_loops(self.flown, refiner) if refiner else self.flown
        if closed.method is self.flown.method:
            return
        *_, here = motions_along(tracked_trajectory(closed.steps), closed.motion)
        self._here = here.map_T_laser
        self._tracking = track(self._coming, closed.method, here._replace(odometry=closed.motion.odometry), len(steps))
        self.obstacles = Obstacles.of(self._scenario, closed.method.grid)
        for scan, step in zip(self._seen, closed.steps, strict=True):
            self.obstacles.note(scan, step)
        self.flown = closed.with_findings(loops=Loops())


class Pilot:
    """Decides on estimates alone: the next command, or that the mission has ended."""

    def __init__(self, scenario: Scenario) -> None:
        """Bring the goals to the map frame."""
        map_T_world = (scenario.world_T_base @ scenario.base_T_laser).inverse()
        self.places = [map_T_world @ Pose(x, y) for x, y in scenario.goals_xy_m]
        self.goals = [*self.places]
        self.radius_m = scenario.goal_radius_m
        self.max_steps = scenario.max_steps
        self.recovery = scenario.recovery
        self.planner = Planner(scenario.planner)
        self.commands = self.rejected = 0
        self.accepted: tuple[Pose, Pose] | None = None

    def locate(self, step: Step, odom_T_laser: Pose | None) -> Pose:
        """Return the estimated pose: the accepted match, else where the commands since the last one should have led."""
        odom_T_laser = odom_T_laser or Pose()
        if step.tracked:
            self.accepted = step.match.map_T_laser, odom_T_laser
            return step.match.map_T_laser
        map_T_laser, then = self.accepted or (Pose(), odom_T_laser)
        return map_T_laser @ then.between(odom_T_laser)

    def review(self, map_T_laser: Trajectory) -> None:
        """Go back to places that the corrected path did not pass after all."""
        visited = self.places[: len(self.places) - len(self.goals)]
        xy_m = [(pose.x_m, pose.y_m) for pose in visited]
        self.goals = self.places[count_passed(map_T_laser.xyyaw[:, :2], xy_m, TOLERANCE_RADII * self.radius_m) :]

    def decide(self, step: Step, here: Pose, grid: GridBuilder) -> MotionCommand | End:
        """Plan the next command from a pose of `locate`, or end the mission.

        After a rejected match the vehicle carries on by dead reckoning, then hovers, and at last gives up.
        """
        self.rejected = 0 if step.tracked else self.rejected + 1
        while step.tracked and self.goals and here.between(self.goals[0]).distance_m <= self.radius_m:
            self.goals.pop(0)
        if not self.goals:
            return End.GOAL
        blind = self.rejected - (self.recovery.fly_on_steps if self.accepted else 0)
        if blind >= self.recovery.hover_steps:
            return End.LOST
        if self.commands == self.max_steps:
            return End.STEP_LIMIT
        self.commands += 1
        if blind > 0:
            return MotionCommand()
        plan = self.planner.plan(grid, here, (self.goals[0].x_m, self.goals[0].y_m))
        return End.STUCK if plan.reason else plan.command


def _scans(scenario: Scenario, vehicle: Vehicle, scans: list[Scan]) -> Iterator[Scan]:
    """Take a scan wherever the vehicle is by then, and keep it."""
    laser, rng = _laser(scenario), np.random.default_rng([scenario.seed, 0])
    while True:
        here = vehicle.world_T_base[-1] @ vehicle.base_T_laser
        pose = sweeping(vehicle, here, laser.spec) if scenario.laser.moving else here
        tilts = tilts_over(vehicle.body.true, laser.spec, vehicle.period_ns * NS) if vehicle.body else None
        scans.append(take_scan(scenario.world, pose, laser, rng, vehicle.stamps_ns[-1], tilts))
        yield scans[-1]


def _level(scans: Iterator[Scan], scenario: Scenario, vehicle: Vehicle, seen: list[Scan]) -> Iterator[Scan]:
    """Level the scans by the measured attitude, and keep them in ``seen``; without attitude they pass as they are."""
    if vehicle.body is None or not scenario.levels_scans:
        yield from scans
        return
    ceiling_m = scenario.ceiling_m or inf
    for scan in scans:
        roll_rad, pitch_rad, height_m = tilts_over(vehicle.body.measured, scan.spec, vehicle.period_ns * NS)
        seen.append(level_scan(scan, roll_rad, pitch_rad, height_m, ceiling_m))
        yield seen[-1]


def _laser(scenario: Scenario) -> LaserModel:
    """Return the sensor; where the vehicle rests during a sweep all beams are of one time."""
    laser = laser_model(scenario)
    return laser if scenario.laser.moving else replace(laser, spec=replace(laser.spec, time_increment_s=0.0))


def _closest_m(scenario: Scenario, poses: list[Pose]) -> float:
    """Least clearance along the straight path through the poses: at points of it, exact in steps too long for that."""
    xy = np.array([(p.x_m, p.y_m) for p in poses])
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    path = [a + share * (b - a) for a, b in pairwise(xy)] or [xy]
    sampled_m = float(scenario.obstacles.clearance_m(np.vstack(path)).min())
    long_m = (SAMPLES - 1) * SPACING_RADII * scenario.vehicle.radius_m
    long = [(a, b) for a, b in pairwise(xy) if np.hypot(*(b - a)) > long_m]
    return min([sampled_m, *(scenario.obstacles.least_clearance_m(a, b) for a, b in long)])


def count_passed(xy_m: NDArray[np.float64], places: Sequence[XY], within_m: float) -> int:
    """Return how many of the places the straight path through points (n, 2) passes in order, within a distance."""
    before, moves = np.vstack((xy_m[:1], xy_m[:-1])), np.diff(xy_m, axis=0, prepend=xy_m[:1])
    squared = np.maximum((moves**2).sum(axis=1), np.finfo(np.float64).tiny)
    step = 0
    for number, place in enumerate(places):
        share = np.clip(((place - before) * moves).sum(axis=1) / squared, 0.0, 1.0)
        near = np.hypot(*(before + share[:, None] * moves - place).T) <= within_m
        if not near[step:].any():
            return number
        step += int(near[step:].argmax())
    return len(places)


def _sum_up(scenario: Scenario, vehicle: Vehicle, scans: list[Scan], end: End, outcome: SlamResult) -> Flight:
    """Sum up a flight: only here does anybody look at the truth."""
    n = len(scans)
    stamps, world_T_base = vehicle.stamps_ns[:n], vehicle.world_T_base
    world_T_map = scenario.world_T_base @ scenario.base_T_laser
    map_T_world = world_T_map.inverse()
    truth = Trajectory.of(stamps, [map_T_world @ p @ vehicle.base_T_laser for p in world_T_base[:n]])
    xy_m = np.array([(p.x_m, p.y_m) for p in (pose @ vehicle.base_T_laser for pose in world_T_base)])
    goal_distance_m = float(np.hypot(*(xy_m[-1] - scenario.goals_xy_m[-1])))
    tolerance_m = TOLERANCE_RADII * scenario.goal_radius_m
    if end is End.GOAL and goal_distance_m > tolerance_m:
        end = End.WRONG_PLACE
    elif end is End.GOAL and count_passed(xy_m, scenario.via_m, tolerance_m) < len(scenario.via_m):
        end = End.WRONG_WAY
    base = Trajectory.of(list(range(len(world_T_base))), world_T_base)
    mission = Mission(end, n, base.length_m, _closest_m(scenario, world_T_base), goal_distance_m)
    odom = Trajectory.of(stamps, vehicle.odom_T_base[:n])
    body = vehicle.body
    tilts, attitudes = (tuple(body.true[:n]), tuple(body.measured[:n])) if body else ((), ())
    return Flight(scenario, outcome, mission, tuple(scans), truth, odom, world_T_map, tilts, attitudes)
