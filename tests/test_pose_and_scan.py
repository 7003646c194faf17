"""Poses, trajectories and scans: the algebra that everything stands on."""

from __future__ import annotations

from math import cos, isclose, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavnav import errors
from mavnav.errors import ExitCode, MavnavError
from mavnav.pose import Pose, Trajectory, transform_points, wrap_angle, yaw_of_quaternion
from mavnav.scan import LaserSpec, Scan
from mavnav.units import pluralize
from support.synthetic import LDS_01, URG_04LX, cast, furnished_rooms, record, room, scan_at

metres = st.floats(-1e3, 1e3)
poses = st.builds(Pose, metres, metres, st.floats(-pi, 3.14))


def close(a: Pose, b: Pose) -> bool:
    return bool(np.hypot(a.x_m - b.x_m, a.y_m - b.y_m) < 1e-8) and abs(wrap_angle(a.yaw_rad - b.yaw_rad)) < 1e-9


def matrix(pose: Pose) -> np.ndarray:
    """Return the homogeneous matrix, the slow and obvious way to compose."""
    c, s = cos(pose.yaw_rad), sin(pose.yaw_rad)
    return np.array([[c, -s, pose.x_m], [s, c, pose.y_m], [0, 0, 1]])


@given(poses, poses)
def test_composition_is_the_product_of_matrices(a: Pose, b: Pose) -> None:
    np.testing.assert_allclose(matrix(a @ b), matrix(a) @ matrix(b), atol=1e-8)


@given(poses, poses)
def test_inverse_and_between(a: Pose, b: Pose) -> None:
    assert close(a @ a.inverse(), Pose())
    assert close(a @ a.between(b), b)
    assert a.between(b) == a.inverse() @ b


@given(st.floats(-100, 100))
def test_angles_wrap_to_one_turn(yaw_rad: float) -> None:
    wrapped = wrap_angle(yaw_rad)
    assert -pi <= wrapped < pi
    assert isclose(cos(wrapped), cos(yaw_rad), abs_tol=1e-9)
    assert isclose(sin(wrapped), sin(yaw_rad), abs_tol=1e-9)


@given(poses, metres, metres)
def test_points_move_with_their_frame(a: Pose, x: float, y: float) -> None:
    moved = transform_points(a, np.array([[x, y]]))[0]
    np.testing.assert_allclose(moved, (matrix(a) @ (x, y, 1))[:2], atol=1e-8)


@given(st.floats(-3.1, 3.1))
def test_yaw_of_a_quaternion_about_z(yaw_rad: float) -> None:
    assert isclose(yaw_of_quaternion(0, 0, sin(yaw_rad / 2), cos(yaw_rad / 2)), yaw_rad, abs_tol=1e-9)


def test_a_trajectory_interpolates_within_and_nowhere_else() -> None:
    track = Trajectory.of([0, 100, 1000], [Pose(0, 0, 3.0), Pose(1, 2, -3.0), Pose(5, 5, 0)])
    middle = track.at(50, max_gap_ns=100)
    assert middle is not None
    assert (middle.x_m, middle.y_m) == (0.5, 1.0)
    assert abs(middle.yaw_rad) > 3.0  # over the seam of the angles, not back round through zero
    assert track.at(100, 0) == track[1]
    assert track.at(500, max_gap_ns=100) is None
    assert track.at(-1, 10**9) is None
    assert track.at(1001, 10**9) is None


@given(poses, st.lists(poses, min_size=1, max_size=5))
def test_another_point_of_the_body_follows(lever: Pose, track: list[Pose]) -> None:
    followed = Trajectory.of(list(range(len(track))), track).compose(lever)
    assert all(close(followed[k], pose @ lever) for k, pose in enumerate(track))


def test_length_and_shapes_of_a_trajectory() -> None:
    assert Trajectory.of([1, 2, 3], [Pose(), Pose(3, 4), Pose(3, 5)]).length_m == 6.0
    assert Trajectory.of([1], [Pose()]).length_m == 0.0
    assert len(Trajectory.of([], [])) == 0
    with pytest.raises(ValueError, match="no trajectory"):
        Trajectory(np.zeros(2, np.int64), np.zeros((3, 3)))


def test_the_jitter_of_a_body_at_rest_is_no_distance_travelled() -> None:
    def travelled_m(xy_m: np.ndarray) -> float:
        return Trajectory(np.arange(len(xy_m)), np.column_stack((xy_m, np.zeros(len(xy_m))))).travelled_m

    rest = np.random.default_rng(0).normal(0.0, 0.004, (1200, 2))
    drive = np.linspace((0.0, 0.0), (3.0, 4.0), 251) + np.random.default_rng(1).normal(0.0, 0.001, (251, 2))
    drive_m = np.hypot(*np.diff(drive, axis=0).T).sum()
    assert travelled_m(rest) == 0.0
    assert travelled_m(drive) == pytest.approx(drive_m)
    there_and_back = np.vstack((rest, drive, rest + drive[-1], drive[::-1], rest))
    assert travelled_m(there_and_back) == pytest.approx(2 * drive_m, rel=0.01)
    assert travelled_m(drive[:3]) == pytest.approx(np.hypot(*np.diff(drive[:3], axis=0).T).sum())  # less than a step
    assert (travelled_m(drive[:1]), travelled_m(drive[:0])) == (0.0, 0.0)


def test_records_are_read_only() -> None:
    scan = Scan(0, np.ones(360), LDS_01)
    track = Trajectory.of([1], [Pose()])
    for array in (scan.ranges_m, track.stamps_ns, track.xyyaw):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_points_of_a_scan_leave_out_what_is_not_valid() -> None:
    spec = LaserSpec(0.0, pi / 2, 4, 0.1, 10.0)
    points = Scan(0, np.array([1.0, np.nan, 3.0, 2.0]), spec).points()
    np.testing.assert_allclose(points, [(1, 0), (-3, 0), (0, -2)], atol=1e-12)
    backwards = LaserSpec(0.0, -pi / 2, 4, 0.1, 10.0)
    assert backwards.field_of_view_rad == spec.field_of_view_rad == pytest.approx(1.5 * pi)
    np.testing.assert_allclose(
        Scan(0, np.array([np.nan, 1.0, np.nan, np.nan]), backwards).points(), [(0, -1)], atol=1e-12
    )


def test_nouns_agree_with_their_counts() -> None:
    found = [
        pluralize(n, noun) for n, noun in ((0, "place"), (1, "place"), (2, "place"), (1, "stretch"), (3, "stretch"))
    ]
    assert found == ["0 places", "1 place", "2 places", "1 stretch", "3 stretches"]


def test_every_error_has_an_exit_code_of_its_table() -> None:
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, MavnavError)]
    assert {kind.__name__: int(kind.exit_code) for kind in kinds} == {
        "MavnavError": 70,
        "UsageError": 2,
        "ConfigError": 2,
        "TopicError": 2,
        "SeveralTopicsError": 2,
        "MapTooLargeError": 2,
        "NoScansError": 4,
        "ProgramError": 1,
        "OutputError": 6,
        "StoppedError": 70,
    }
    assert len(set(ExitCode)) == 10


# --- the synthetic scenes that other tests trust ------------------------------------------------------------------


def test_rays_in_an_empty_room_are_as_long_as_geometry_says() -> None:
    ranges = cast(room(6, 4), (1.0, 1.5), np.array([0, pi / 2, pi, -pi / 2, pi / 4]))
    np.testing.assert_allclose(ranges, [5.0, 2.5, 1.0, 1.5, 2.5 * np.sqrt(2)])


def test_scan_points_lie_on_the_walls() -> None:
    pose = Pose(2.0, 1.0, 0.7)
    points = transform_points(pose, scan_at(room(6, 4), pose).points())
    to_walls = np.min([abs(points[:, 0]), abs(points[:, 0] - 6), abs(points[:, 1]), abs(points[:, 1] - 4)], axis=0)
    assert len(points) > 600
    assert to_walls.max() < 1e-9


def test_recordings_follow_their_seed_and_start_at_the_origin_of_the_map() -> None:
    way = Trajectory.of([0, 10**8], [Pose(1, 1, 0.5), Pose(1.1, 1, 0.6)])
    a, b, c = (record(furnished_rooms(), way, URG_04LX, 0.01, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.scans[1].ranges_m, b.scans[1].ranges_m)
    assert not np.array_equal(a.scans[1].ranges_m, c.scans[1].ranges_m, equal_nan=True)
    assert close(a.map_T_laser[0], Pose())


@pytest.mark.parametrize("max_gap_ns", [40, 10**9])
def test_many_poses_are_interpolated_as_one_is(max_gap_ns: int) -> None:
    rng = np.random.default_rng(3)
    stamps_ns = np.cumsum(rng.integers(1, 80, 30))
    path = Trajectory(stamps_ns, np.column_stack((rng.normal(size=(30, 2)), rng.uniform(-np.pi, np.pi, 30))))
    times_ns = np.arange(-5, int(stamps_ns[-1]) + 5)
    none = Pose(np.nan, np.nan, np.nan)
    expected = np.array([path.at(int(t), max_gap_ns) or none for t in times_ns])
    off = path.poses_at(times_ns, max_gap_ns) - expected
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_array_equal(np.isnan(off), np.isnan(expected))
    np.testing.assert_allclose(off[np.isfinite(off)], 0.0, atol=1e-9)
    assert not len(Trajectory.of([], []).poses_at(times_ns[:0], 1))
