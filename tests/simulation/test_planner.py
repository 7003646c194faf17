"""The planner in closed loop with a tiny exact world, and each promise of a command on its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import ValidationError, convert

from mavnav.config.models import PlannerConfig
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose
from mavnav.simulation.planner.local_minima import aim_on_shortest_path, in_the_open, unit
from mavnav.simulation.planner.potential_field import TECHNIQUES, MotionCommand, Planner
from support import closed_loop, naive_planner
from support.closed_loop import CLOSED, CORNER, DOORWAY, OPEN, U_TRAP, World, fly, paint
from support.synthetic import DEG, polyline


def grid_of(walls: np.ndarray, cell_m: float = 0.02) -> GridBuilder:
    grid = GridBuilder(cell_m)
    paint(grid, walls, Pose())
    return grid


def first_command(walls: np.ndarray, pose: Pose, goal: tuple[float, float], **settings: object) -> MotionCommand:
    return Planner(PlannerConfig(**settings)).plan(grid_of(walls), pose, goal).command


def test_every_technique_can_be_chosen_by_its_name() -> None:
    for name in TECHNIQUES:
        assert PlannerConfig(technique=name).technique == name
    assert PlannerConfig().technique == "wavefront"
    with pytest.raises(ValidationError, match="technique"):
        convert({"technique": "teleport"}, PlannerConfig)


def test_safety_clearances_must_be_in_order() -> None:
    with pytest.raises(ValueError, match="least_safety_mm 150 above safety_mm 100"):
        PlannerConfig(safety_mm=100)


# ---- missions --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [True, False], ids=["painted", "seen"])
@pytest.mark.parametrize("technique", TECHNIQUES)
def test_open_space_is_crossed_in_nearly_a_straight_line(technique: str, known: bool) -> None:
    flight = fly(OPEN, technique, known=known)
    assert flight.reached
    assert flight.length_m < 1.1 * np.hypot(*OPEN.goal_m)


@pytest.mark.parametrize("known", [True, False], ids=["painted", "seen"])
@pytest.mark.parametrize("technique", TECHNIQUES)
def test_a_corner_is_turned(technique: str, known: bool) -> None:
    flight = fly(CORNER, technique, known=known)
    assert flight.reached
    assert flight.clearance_m > 0.28


@pytest.mark.parametrize("known", [True, False], ids=["painted", "seen"])
@pytest.mark.parametrize(("world", "longest_m"), [(DOORWAY, 6.3), (U_TRAP, 6.5)], ids=["doorway", "u_trap"])
def test_wavefront_finds_the_short_way_with_clearance(world: World, longest_m: float, known: bool) -> None:
    flight = fly(world, known=known)
    assert flight.reached
    assert flight.clearance_m > 0.4
    assert flight.length_m < longest_m


@pytest.mark.parametrize("seed", range(3))
def test_wavefront_bears_noise(seed: int) -> None:
    flight = fly(U_TRAP, noisy=True, seed=seed)
    assert flight.reached
    assert flight.clearance_m > 0.35


@pytest.mark.parametrize("known", [True, False], ids=["painted", "seen"])
def test_the_plain_field_is_trapped_and_says_so(known: bool) -> None:
    flight = fly(U_TRAP, "field", known=known)
    assert not flight.reached
    assert flight.reason == "the forces are in balance"
    assert len(flight.plans) < 100


@pytest.mark.parametrize("known", [True, False], ids=["painted", "seen"])
@pytest.mark.parametrize("technique", ["wall_following", "virtual_obstacles"])
def test_other_techniques_leave_the_trap(technique: str, known: bool) -> None:
    flight = fly(U_TRAP, technique, known=known)
    assert flight.reached
    assert flight.clearance_m > 0.22


@pytest.mark.parametrize("known", [True, False], ids=["painted", "seen"])
def test_a_narrow_doorway_is_passed_though_it_leaves_less_than_the_safety_clearance(known: bool) -> None:
    walls = np.vstack((DOORWAY.walls[:4], polyline((3, 0), (3, 2.4)), polyline((3, 2.8), (3, 4))))
    flight = fly(World(walls, DOORWAY.start, DOORWAY.goal_m), known=known)
    assert flight.reached
    assert 0.15 < flight.clearance_m < 0.2


def test_a_wide_doorway_aside_is_taken_rather_than_a_narrow_one_ahead() -> None:
    wall = [polyline((3, 0), (3, 0.65)), polyline((3, 0.95), (3, 2.4)), polyline((3, 3.3), (3, 4))]
    flight = fly(World(np.vstack((DOORWAY.walls[:4], *wall)), DOORWAY.start, DOORWAY.goal_m), known=True)
    assert flight.reached
    assert flight.clearance_m > 0.35


def test_walls_that_repel_far_too_much_do_not_hold_the_wavefront_back() -> None:
    walls = np.vstack((DOORWAY.walls[:4], polyline((3, 0), (3, 1.8)), polyline((3, 2.2), (3, 4))))
    world = World(walls, Pose(1.0, 2.0, 0.0), (5.0, 2.0))
    assert fly(world, known=True, repulsion_gain=20).reached
    assert not fly(world, "field", known=True, repulsion_gain=20).reached


@pytest.mark.parametrize(
    ("technique", "reason"),
    [
        ("wavefront", "walls close off the goal"),
        ("field", "the forces are in balance"),
        ("wall_following", "the wall leads round to where it began"),
        ("virtual_obstacles", "virtual obstacles fill every way"),
    ],
)
def test_a_goal_behind_closed_walls_is_given_up_in_words(technique: str, reason: str) -> None:
    flight = fly(CLOSED, technique, known=True, steps=800)
    assert not flight.reached
    assert flight.reason == reason
    assert flight.plans[-1].command == MotionCommand()
    assert flight.clearance_m > 0.2


def test_wavefront_looks_round_before_it_gives_up() -> None:
    flight = fly(CLOSED)
    turned = sum(plan.command.dyaw_rad for plan in flight.plans)
    assert flight.plans[-1].reason
    assert turned >= 2 * np.pi - 1e-9
    assert flight.length_m == 0


def test_the_same_seed_gives_the_same_flight() -> None:
    a, b = (fly(CORNER, noisy=True, seed=5) for _ in range(2))
    np.testing.assert_array_equal(a.xy_m, b.xy_m)
    assert a.plans == b.plans


# ---- commands --------------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(x=st.floats(0.3, 5.7), y=st.floats(0.3, 3.7), yaw=st.floats(-3, 3), technique=st.sampled_from(list(TECHNIQUES)))
def test_commands_keep_the_limits_and_the_clearance(x: float, y: float, yaw: float, technique: str) -> None:
    planner = Planner(PlannerConfig(technique=technique, max_step_mm=80, max_turn_deg=10))
    pose = Pose(x, y, yaw)
    for _ in range(5):
        c = planner.plan(DOORWAY_GRID, pose, DOORWAY.goal_m).command
        before = closed_loop.true_clearance_m(DOORWAY.walls, (pose.x_m, pose.y_m))
        pose = pose @ Pose(c.dx_m, c.dy_m, c.dyaw_rad)
        assert np.hypot(c.dx_m, c.dy_m) <= 0.08 + 1e-9
        assert abs(c.dyaw_rad) <= 10 * DEG + 1e-9
        after = closed_loop.true_clearance_m(DOORWAY.walls, (pose.x_m, pose.y_m))
        assert after >= min(0.25, before) - 0.03  # a wall is known to one or two cells


DOORWAY_GRID = grid_of(DOORWAY.walls)


@settings(max_examples=20, deadline=None)
@given(yaw=st.floats(-3, 3), technique=st.sampled_from(list(TECHNIQUES)))
def test_the_vehicle_goes_the_same_way_however_it_is_turned(yaw: float, technique: str) -> None:
    wide = {"technique": technique, "view_deg": 180, "max_turn_deg": 180}
    steps = []
    for at in (yaw, yaw + 0.3):
        c = first_command(CORNER.walls, Pose(0.8, 0.7, at), CORNER.goal_m, **wide)
        steps.append(Pose(0.8, 0.7, at) @ Pose(c.dx_m, c.dy_m, 0.0))
    # Where the laser looks away, a step is shortened: directions agree, not lengths.
    a, b = (np.array([p.x_m - 0.8, p.y_m - 0.7]) for p in steps)
    if min(np.hypot(*a), np.hypot(*b)) > 1e-6:
        np.testing.assert_allclose(unit(a), unit(b), atol=1e-6)


def test_the_vehicle_turns_before_it_moves_where_it_does_not_look() -> None:
    c = first_command(OPEN.walls, Pose(0, 0, np.pi), (4.0, 0.0))
    assert (c.dx_m, c.dy_m) == (0, 0)
    assert abs(c.dyaw_rad) == pytest.approx(15 * DEG)


def test_a_higher_mass_bends_the_way_less() -> None:
    """Flying along x, the goal turns up aside: the heavier vehicle keeps its direction longer."""
    sideways = []
    for mass in (0.5, 1.0, 4.0):
        planner = Planner(PlannerConfig(technique="field", mass_kg=mass, view_deg=180))
        pose, grid = Pose(), grid_of(OPEN.walls)
        for k in range(14):
            c = planner.plan(grid, pose, (4.0, 0.0) if k < 10 else (pose.x_m, 4.0)).command
            pose = pose @ Pose(c.dx_m, c.dy_m, 0.0)
        sideways.append(pose.y_m)
    assert sideways[0] > sideways[1] > sideways[2] > 0


def test_without_repulsion_the_wall_still_is_not_hit() -> None:
    flight = fly(U_TRAP, "field", known=True, repulsion_gain=0)
    assert not flight.reached
    assert flight.clearance_m > 0.2


def test_a_stray_hit_in_a_doorway_does_not_close_it() -> None:
    free, stray = grid_of(DOORWAY.walls), grid_of(DOORWAY.walls)
    at = np.array([[x, 2.85] for x in (2.97, 3.0, 3.03)])
    stray.insert(Pose(2.0, 2.85, 0.0), at[:1])
    pose = Pose(2.0, 2.85, 0.0)
    commands = [Planner(PlannerConfig()).plan(g, pose, DOORWAY.goal_m).command for g in (free, stray)]
    assert commands[0] == commands[1]
    for _ in range(3):
        stray.insert(pose, at)
    assert Planner(PlannerConfig()).plan(stray, pose, DOORWAY.goal_m).command != commands[0]  # now it is a thing


def test_a_vehicle_too_near_to_a_wall_backs_off_though_it_does_not_look_there() -> None:
    wall = polyline((1, -3), (1, 3))
    c = first_command(wall, Pose(0.9, 0.0, 0.0), (-3.0, 0.0), technique="field")
    assert c.dx_m < -0.01


def test_an_empty_map_and_a_goal_at_hand_are_no_trouble() -> None:
    for technique in TECHNIQUES:
        plan = Planner(PlannerConfig(technique=technique)).plan(GridBuilder(0.02), Pose(), (2.0, 0.0))
        assert plan.command.dx_m > 0
        there = Planner(PlannerConfig(technique=technique)).plan(GridBuilder(0.02), Pose(2.0, 0.0, 0.0), (2.0, 0.0))
        assert there.command == MotionCommand()
        assert not there.reason


def test_a_new_goal_begins_a_new_memory() -> None:
    grid, planner = grid_of(CLOSED.walls), Planner(PlannerConfig())
    pose = CLOSED.start
    while not planner.plan(grid, pose, CLOSED.goal_m).reason:
        pass
    plan = planner.plan(grid, pose, (3.0, 1.5))
    assert not plan.reason
    assert plan.command.dx_m > 0


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_the_last_step_does_not_pass_the_goal(technique: str) -> None:
    grid, planner, pose = grid_of(OPEN.walls), Planner(PlannerConfig(technique=technique)), Pose()
    for _ in range(30):
        c = planner.plan(grid, pose, (1.0, 0.0)).command
        pose = pose @ Pose(c.dx_m, c.dy_m, c.dyaw_rad)
        assert pose.x_m < 1.0 + 1e-9
    assert pose.x_m > 0.99


def test_a_goal_near_a_wall_is_approached() -> None:
    flight = fly(World(OPEN.walls, Pose(8.0, 0.0, 0.0), (9.96, 0.0)), known=True)
    assert flight.reached
    assert flight.clearance_m > 0.2


# ---- the open --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cell_m", "shape"), [(0.05, (90, 130)), (0.1, (33, 61)), (0.4, (21, 17))])
@pytest.mark.parametrize("seed", range(3))
def test_cells_in_the_open_are_their_twin(seed: int, cell_m: float, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    row = rng.integers(shape[0])
    along = np.column_stack((np.full(shape[1], row), np.arange(shape[1])))[: shape[1] // 2]
    walls = np.vstack((along, rng.integers(0, shape, (3, 2))))
    np.testing.assert_array_equal(in_the_open(walls, shape, cell_m), naive_planner.in_the_open(walls, shape, cell_m))


def test_the_way_keeps_near_a_wall_where_the_open_costs_more() -> None:
    wall = np.column_stack((np.arange(0.0, 12.0, 0.05), np.zeros(240)))
    highest_m = []
    for open_cost in (1.0, 8.0):
        here, path = np.array([1.0, 1.0]), []
        while here[0] < 5.0:
            aim = aim_on_shortest_path(wall, here, np.array([8.0, 7.0]), PlannerConfig(open_cost=open_cost))
            assert aim is not None
            here = here + 0.1 * unit(aim - here)
            path.append(here)
        highest_m.append(max(y for _, y in path))
    assert highest_m[0] > 3.0
    assert highest_m[1] < 2.1
