"""Files of truth, and what a run is told by them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.errors import MavnavError, UsageError
from mavnav.ground_truth.references import (
    References,
    check_times,
    compare_to,
    load_references,
    of_scenario,
    place_walls,
    read_true_map,
)
from mavnav.ground_truth.tables import read_relations, read_trajectory, read_tum
from mavnav.metrics.reference import Reference
from mavnav.pose import Pose, Trajectory
from mavnav.simulation.world.scenario_file import load_scenario
from support.map_files import pgm

TUM = (
    "# t x y z qx qy qz qw\n2.000000002 1 2 9 0 0 0.7071067811865476 0.7071067811865476\n\n1.5 0 0 0 0 0 0 1 # first\n"
)


def test_a_trajectory_keeps_its_nanoseconds(tmp_path) -> None:
    (tmp_path / "t.tum").write_text(TUM)
    trajectory = read_tum(tmp_path / "t.tum")
    assert trajectory.stamps_ns.tolist() == [1_500_000_000, 2_000_000_002]
    np.testing.assert_allclose(trajectory.xyyaw, [(0, 0, 0), (1, 2, np.pi / 2)], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("1 2 3\n", ":1: 3 columns"), ("# nothing\n", "is empty"), ("1 0 0 0 0 0 0 2\n", "length 1"),
        ("1 0 0 0 0 0 0 1\nx 0 0 0 0 0 0 1\n", ":2: 'x' is no time"), ("1 nan 0 0 0 0 0 1\n", "no number"),
        ("1e12 0 0 0 0 0 0 1\n", "no time"), ("inf 0 0 0 0 0 0 1\n", "no time"), ("1 0 0 0 0 0 zero 1\n", "no number"),
    ],
)  # fmt: skip
def test_a_bad_line_is_named(tmp_path, text, word) -> None:
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(UsageError, match=word):
        load_references(truth=tmp_path / "t.tum")


@pytest.mark.parametrize("option", ["truth", "truth_map", "relations"])
def test_no_file_or_no_text(tmp_path, option) -> None:
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    for name in ("gone", "binary"):
        with pytest.raises(MavnavError) as caught:
            load_references(**{option: tmp_path / name})
        assert caught.value.exit_code == 2
        assert "\n" not in str(caught.value)


def wander(seed: int = 0, n: int = 300) -> Trajectory:
    rng = np.random.default_rng(seed)
    yaw = np.cumsum(rng.normal(0, 0.1, n))
    xy = np.cumsum(0.05 * np.column_stack((np.cos(yaw), np.sin(yaw))), axis=0)
    return Trajectory(np.arange(n) * 100_000_000, np.column_stack((xy, (yaw + np.pi) % (2 * np.pi) - np.pi)))


def write_relations(path, truth: Trajectory, pairs) -> None:
    rows = []
    for i, j in pairs:
        motion = truth[i].between(truth[j])
        stamps = f"{truth.stamps_ns[i] * 1e-9:.9f} {truth.stamps_ns[j] * 1e-9:.9f}"
        rows.append(f"{stamps} {motion.x_m:.12f} {motion.y_m:.12f} 0 0 0 {motion.yaw_rad:.12f}\n")
    path.write_text("".join(rows))


PAIRS = [(0, 10), (10, 40), (5, 290), (100, 299)]


@settings(max_examples=20)
@given(x=st.floats(-50, 50), y=st.floats(-50, 50), yaw=st.floats(-3.1, 3.1))
def test_relations_and_errors_do_not_depend_on_the_frame(tmp_path_factory, x, y, yaw) -> None:
    path = tmp_path_factory.mktemp("relations") / "r.txt"
    truth = wander()
    write_relations(path, truth, PAIRS)
    found = compare_to(References(truth=truth, relations=read_relations(path)), truth.seen_from(Pose(x, y, yaw)), None)
    assert found.relations["all"].scored == 4
    assert found.relations["all"].translation_mean_m < 1e-8
    assert found.relations["all"].rotation_mean_deg < 1e-6
    assert found.ate.max_m < 1e-8
    assert found.rpe.translation_rmse_m < 1e-8


def test_relations_against_the_definition(tmp_path) -> None:
    truth, estimate = wander(), wander(1)
    write_relations(tmp_path / "r.txt", truth, PAIRS)
    found = compare_to(References(relations=read_relations(tmp_path / "r.txt")), estimate, None).relations
    errors = [truth[i].between(truth[j]).between(estimate[i].between(estimate[j])) for i, j in PAIRS]
    assert found["all"].translation_mean_m == pytest.approx(np.mean([e.distance_m for e in errors]), abs=1e-9)
    assert found["all"].translation_std_m == pytest.approx(np.std([e.distance_m for e in errors]), abs=1e-9)
    assert found["all"].rotation_mean_deg == pytest.approx(
        np.degrees(np.mean([abs(e.yaw_rad) for e in errors])), abs=1e-7
    )
    assert found["all"].rotation_std_deg == pytest.approx(
        np.degrees(np.std([abs(e.yaw_rad) for e in errors])), abs=1e-7
    )
    assert (found["sequential"].relations, found["loops"].relations) == (3, 1)
    assert found["loops"].translation_mean_m == pytest.approx(errors[2].distance_m, abs=1e-9)


def test_a_trajectory_that_stops_early_misses_relations(tmp_path) -> None:
    truth = wander()
    write_relations(tmp_path / "r.txt", truth, PAIRS)
    early = Trajectory(truth.stamps_ns[:50].copy(), truth.xyyaw[:50].copy())
    found = compare_to(References(relations=read_relations(tmp_path / "r.txt")), early, None).relations
    assert (found["all"].scored, found["all"].share) == (2, 0.5)
    assert found["loops"].scored == 0
    assert np.isnan(found["loops"].translation_mean_m)


def test_another_clock_is_told_before_the_work() -> None:
    truth = wander()
    check_times(References(truth=truth), 0, 10**9)
    with pytest.raises(UsageError, match="share no time"):
        check_times(References(truth=truth), 10**18, 10**18 + 10**9)


def test_a_trajectory_in_the_place_of_relations_is_refused(tmp_path) -> None:
    rows = [f"{t} {0.1 * t} 0 0 0 0 {np.sin(0.05 * t)} {np.cos(0.05 * t)}\n" for t in range(5)]
    (tmp_path / "t.tum").write_text("".join(rows))
    with pytest.raises(UsageError, match=r"t\.tum is a TUM trajectory, .*; give it with --truth"):
        read_relations(tmp_path / "t.tum")


def test_both_times_of_relations_are_those_of_the_log(tmp_path) -> None:
    (tmp_path / "r.txt").write_text("1700000000 1.75 1 0 0 0 0 0\n1700000001 1.7 1 0 0 0 0 0\n")
    with pytest.raises(UsageError, match=r"the second times of the relations, 1\.7 to 1\.8 s, .* share no time"):
        check_times(References(relations=read_relations(tmp_path / "r.txt")), 17 * 10**17, 17 * 10**17 + 10**10)


def test_too_few_poses_measure_nothing() -> None:
    truth = wander()
    two = Trajectory(truth.stamps_ns[:2].copy(), truth.xyyaw[:2].copy())
    assert compare_to(References(truth=truth), two, None) == Reference(ate=None, rpe=None)
    assert compare_to(References(), truth, None) is None


def test_a_scenario_is_seen_from_its_start() -> None:
    scenario = load_scenario("corner")
    start = scenario.world_T_base @ scenario.base_T_laser
    truth = of_scenario(scenario, start)
    assert truth.distance_m(truth.xy_m).max() < 1e-9
    found = compare_to(References(true_map=truth), None, truth.xy_m + 0.03 * np.array([1.0, 0.0])).map_distance
    assert found.alignment == "start pose"
    assert 0 < found.mean_mm <= found.p95_mm <= found.max_mm <= 30.0001
    assert found.covered_share == 1.0
    half = truth.xy_m[: len(truth.xy_m) // 2]
    assert 0.3 < compare_to(References(true_map=truth), None, half).map_distance.covered_share < 0.8


@pytest.mark.parametrize("name", ["corner", "curved"])
def test_walls_that_are_moved_are_those_seen_from_another_place(name) -> None:
    scenario, map_T_start = load_scenario(name), Pose(2.0, -1.0, 0.8)
    start = scenario.world_T_base @ scenario.base_T_laser
    placed, twin = (
        place_walls(of_scenario(scenario, start), map_T_start),
        of_scenario(scenario, start @ map_T_start.inverse()),
    )
    assert placed.alignment == twin.alignment
    assert np.allclose(placed.xy_m, twin.xy_m)
    assert np.allclose(placed.segments_map, twin.segments_map)
    assert np.allclose(placed.arcs_map[:, :3], twin.arcs_map[:, :3])
    assert np.allclose(np.exp(1j * placed.arcs_map[:, 3]), np.exp(1j * twin.arcs_map[:, 3]))
    assert np.array_equal(placed.arcs_map[:, 4], twin.arcs_map[:, 4])
    points = np.random.default_rng(0).uniform(-5.0, 5.0, (50, 2))
    assert np.allclose(placed.distance_m(points), twin.distance_m(points))


@pytest.mark.parametrize("name", ["corner", "curved.yaml"])
def test_shipped_scenarios_are_truths(name, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    from pathlib import Path

    truth, file = read_true_map(Path(name))
    assert file is None
    assert len(truth.xy_m) > 100
    assert truth.distance_m(truth.xy_m).max() < 1e-9


def test_an_empty_map_has_no_distance() -> None:
    scenario = load_scenario("corner")
    found = compare_to(References(true_map=of_scenario(scenario, Pose())), None, np.zeros((0, 2))).map_distance
    assert found.cells == 0
    assert np.isnan(found.mean_mm)


def test_neither_scenario_nor_map(tmp_path) -> None:
    (tmp_path / "x.yaml").write_text("a: 1\n")
    with pytest.raises(UsageError, match="neither a scenario"):
        read_true_map(tmp_path / "x.yaml")


def test_a_map_file_is_true_in_its_own_frame(tmp_path) -> None:
    (tmp_path / "map.pgm").write_bytes(pgm(np.array([[254, 0], [254, 254]])))
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 0.5\norigin: [1, 2, 0]\n")
    truth, _ = read_true_map(tmp_path / "map.yaml")
    assert truth.xy_m.tolist() == [[1.75, 2.75]]
    assert truth.distance_m(np.array([(1.75, 2.25), (1.75, 2.75)])).tolist() == [0.5, 0.0]
    assert not References(true_map=truth).of_first_scan
    (tmp_path / "map.pgm").write_bytes(pgm(np.full((2, 2), 254)))
    with pytest.raises(UsageError, match="no occupied cell"):
        read_true_map(tmp_path / "map.yaml")


QUARTER = 0.5**0.5
"""Sine and cosine of half a quarter turn."""

FORMATS = {
    "tum": f"# t x y z qx qy qz qw\n7.5 1 2 0 0 0 {QUARTER} {QUARTER}\n7 0 0 0 0 0 0 1\n",
    "begins with a mark": "\ufeff7 0 0 0 0 0 0 1\n7.5 1 2 0 0 0 0.7071067812 0.7071067812\n",
    "plain": "7,0,0,0\n7.5,1,2,1.5707963267948966\n",
    "headed": "# t, x, y, yaw\n7,0,0,0\n7.5,1,2,1.5707963267948966\n",
    "other order": "yaw,t,x,y\n0,7,0,0\n1.5707963267948966,7.5,1,2\n",
    "run": "index,stamp,x_m,y_m,yaw_rad,tracked\n0,7,0,0,0,1\n1,7.2,,,,0\n2,7.5,1,2,1.5707963267948966,1\n",
    "euroc": "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z [],v_x [m s^-1]\n"
    f"7000000000,0,0,0,1,0,0,0,9\n7500000000,1,2,0,{QUARTER},0,0,{QUARTER},9\n",
}


@pytest.mark.parametrize("name", FORMATS)
def test_trajectories_are_read_by_their_content(tmp_path, name) -> None:
    file = tmp_path / "poses.txt"
    file.write_text(FORMATS[name])
    trajectory, several = read_trajectory(file)
    assert several == 0
    assert trajectory.stamps_ns.tolist() == [7_000_000_000, 7_500_000_000]
    np.testing.assert_allclose(trajectory.xyyaw, [[0, 0, 0], [1, 2, np.pi / 2]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1 0 0 4 0 1 0 5 0 0 1 6\n", "without times"),
        ("t,x,y,yaw\n1,2,3\n", "3 columns are too few"),
        ("1,2,3,0,0,0,0,1\n", "row 1: 8 columns, of which none is named yaw"),
        ("1,2,3,north\n", "'north' is no number"),
        ("t,x,y,yaw\n", "has no pose"),
        ("#timestamp [ns],x,y,z,qw,qx,qy,qz\n7,0,0,0,2,0,0,0\n", "not of length 1"),
        ("", "is empty"),
    ],
)
def test_what_is_no_trajectory_is_refused_with_the_reason(tmp_path, text, why) -> None:
    file = tmp_path / "poses.csv"
    file.write_text(text)
    with pytest.raises(UsageError, match=why):
        read_trajectory(file)
