"""The path planner: from the map so far, the estimated pose and the goal to one command (paper, "Path Planning").

Walls repel, the goal attracts, and a virtual mass makes the path smooth. What is done against local minima is a
choice, ``TECHNIQUES``. Whatever the forces want, a command keeps its distance from the walls of the map.
"""

from __future__ import annotations

from math import atan2, ceil, cos, sin

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import PlannerConfig
from mavnav.kernels.planning import potential
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, wrap_angle
from mavnav.simulation.planner.local_minima import TECHNIQUES, XY, Memory, Scene
from mavnav.units import DEG, MM

_LOOK_M = 1.0  # walls farther away decide no single step
_LAST_SAFETY_M = 0.1  # no step goes nearer to a wall than this, unless it leads away from it
_AHEAD_RAD = np.zeros(1)
_FAN_RAD = np.array([0, 20, -20, 40, -40, 60, -60, 80, -80]) * DEG  # ways round a wall that a step may not touch
_SHARES = np.array([1.0, 0.75, 0.5, 0.25])  # of the wanted step
_LEAST_PROGRESS = 0.15  # of the wanted step
_SAMPLE_M = 0.05  # clearance is checked along a step this often
_BACKING_OFF = 0.25  # of a step, where nothing is seen
_TAPER_RAD = 30 * DEG  # below ``view_deg`` steps are shortened over this range


class MotionCommand(Struct, frozen=True):
    """One step in the body (laser) frame at its beginning: m, m, rad."""

    dx_m: float = 0.0
    dy_m: float = 0.0
    dyaw_rad: float = 0.0


class Plan(Struct, frozen=True):
    """A command, and the ``reason`` why the planner is stuck, if it is; the command is then no motion."""

    command: MotionCommand
    reason: str = ""


class Planner:
    """Plans step by step on map and estimated pose alone; what it remembers is ``memory``, nothing else."""

    def __init__(self, config: PlannerConfig) -> None:
        """Start without memory."""
        self.config = config
        self.memory: Memory | None = None

    def plan(self, grid: GridBuilder, map_T_laser: Pose, goal_xy_map_m: tuple[float, float]) -> Plan:
        """Return the next command, and remember what the next call needs."""
        scene = _scene(self.config, grid, map_T_laser, goal_xy_map_m)
        drive = TECHNIQUES[self.config.technique](scene, _update_memory(self.memory, scene))
        step = np.zeros(2)
        turn_rad = 0.0 if drive.reason else self.config.max_turn_rad
        if drive.force is not None and not drive.reason:
            velocity = _accelerate(self.config, drive.memory.velocity_m, drive.force)
            bearing_rad = wrap_angle(atan2(velocity[1], velocity[0]) - map_T_laser.yaw_rad)
            turn_rad = _turn_rad(self.config, velocity, bearing_rad)
            wanted = _seen_share(scene, bearing_rad) * _limit_step(scene, velocity)
            step = _clear_step(scene, wanted, squeezes=drive.squeezes)
        self.memory = replace(drive.memory, velocity_m=step)
        return Plan(_in_body(step, turn_rad, map_T_laser), drive.reason)


def _scene(config: PlannerConfig, grid: GridBuilder, map_T_laser: Pose, goal_xy_map_m: tuple[float, float]) -> Scene:
    walls = potential.wall_centres(grid.hits, grid.passes, grid.lattice, config.min_hits, config.min_share)
    xy = map_T_laser.as_array()[:2]
    reach_m = max(_LOOK_M, config.safety_m + config.max_step_m)
    near = np.ascontiguousarray(walls[np.hypot(*(walls - xy).T) < reach_m])
    return Scene(config, grid.cell_m, walls, near, xy, np.array(goal_xy_map_m, np.float64))


def _update_memory(memory: Memory | None, scene: Scene) -> Memory:
    """Note where the vehicle is now; a new goal begins a new memory."""
    here = scene.xy_map_m
    if memory is None or not np.array_equal(memory.goal_xy_map_m, scene.goal_xy_map_m):
        velocity = np.zeros(2) if memory is None else memory.velocity_m
        return Memory(scene.goal_xy_map_m, velocity, here)
    if memory.following is not None:
        path_m = memory.following.path_m + float(np.hypot(*memory.velocity_m))
        memory = replace(memory, following=replace(memory.following, path_m=path_m))
    if np.hypot(*(here - memory.anchor_xy_map_m)) > scene.config.stall_m:
        return replace(memory, anchor_xy_map_m=here, idle_steps=0)
    return replace(memory, idle_steps=memory.idle_steps + 1)


def _accelerate(config: PlannerConfig, velocity_m: XY, force: XY) -> XY:
    """Move the virtual mass by one step of time: F - v = m a, with v in longest steps; implicit, so always stable."""
    return np.asarray((velocity_m + force * config.max_step_mm * MM / config.mass_kg) / (1.0 + 1.0 / config.mass_kg))


def _limit_step(scene: Scene, velocity_m: XY) -> XY:
    """Bound a step by the longest one and by the distance to the goal."""
    longest_m = min(scene.config.max_step_m, scene.goal_m)
    return velocity_m * min(1.0, longest_m / max(1e-9, float(np.hypot(*velocity_m))))


def _turn_rad(config: PlannerConfig, velocity_m: XY, bearing_rad: float) -> float:
    """Turn the laser to where the vehicle wants to go, unless it hardly moves."""
    if np.hypot(*velocity_m) < 0.1 * config.max_step_m:
        return 0.0
    return float(np.clip(bearing_rad, -config.max_turn_rad, config.max_turn_rad))


def _seen_share(scene: Scene, bearing_rad: float) -> float:
    """Return the share of a step that may be made in a direction that the laser hardly sees, or not at all.

    A vehicle that is too near to a wall backs off at once, slowly.
    """
    too_near = _clearance_m(scene) < scene.config.safety_m
    seen = (scene.config.view_rad - abs(bearing_rad)) / _TAPER_RAD
    return float(np.clip(seen, _BACKING_OFF if too_near else 0.0, 1.0))


def _clear_step(scene: Scene, step_m: XY, *, squeezes: bool) -> XY:
    """Return the step, shortened or turned aside so that it keeps its distance from the walls; none if need be.

    With ``squeezes`` the safety clearance is given up in stages where no other step makes progress. A vehicle that is
    nearer to a wall already may go anywhere that is no nearer.
    """
    if np.hypot(*step_m) < 1e-6 or len(scene.near_xy_map_m) == 0:
        return step_m
    steps, progress = _candidates(step_m, _AHEAD_RAD if scene.config.technique == "field" else _FAN_RAD)
    clearances = _least_clearances_m(scene, steps)
    now_m = _clearance_m(scene)
    for level_m in _levels_m(scene.config)[: None if squeezes else 1]:
        allowed = (clearances >= min(level_m, now_m)) & (progress >= _LEAST_PROGRESS)
        if allowed.any():
            return np.asarray(steps[np.argmax(np.where(allowed, progress, -1.0))])
    return np.zeros(2)


def _levels_m(config: PlannerConfig) -> list[float]:
    safety_m, least_m = config.safety_m, config.least_safety_m
    return [safety_m, (safety_m + least_m) / 2, least_m, min(least_m, _LAST_SAFETY_M)]


def _candidates(step_m: XY, aside_rad: NDArray[np.float64]) -> tuple[XY, NDArray[np.float64]]:
    """Return steps (n, 2) turned aside and shortened, and each one's progress (n,) as a share of the wanted step."""
    c, s = np.cos(aside_rad), np.sin(aside_rad)
    turned = np.column_stack((c * step_m[0] - s * step_m[1], s * step_m[0] + c * step_m[1]))
    steps = (_SHARES[:, None, None] * turned).reshape(-1, 2)
    return steps, (_SHARES[:, None] * c).ravel()


def _least_clearances_m(scene: Scene, steps_m: XY) -> NDArray[np.float64]:
    """Return the least clearance (n,) along each step (n, 2)."""
    samples = ceil(float(np.hypot(*steps_m[0])) / _SAMPLE_M)
    shares = np.arange(1, samples + 1)[:, None, None] / samples
    points = (scene.xy_map_m + shares * steps_m).reshape(-1, 2)
    return np.asarray(potential.clearance(scene.near_xy_map_m, points).reshape(samples, -1).min(axis=0))


def _clearance_m(scene: Scene) -> float:
    return float(potential.clearance(scene.near_xy_map_m, scene.xy_map_m[None])[0])


def _in_body(step_m: XY, turn_rad: float, map_T_laser: Pose) -> MotionCommand:
    c, s = cos(map_T_laser.yaw_rad), sin(map_T_laser.yaw_rad)
    return MotionCommand(float(c * step_m[0] + s * step_m[1]), float(c * step_m[1] - s * step_m[0]), turn_rad)
