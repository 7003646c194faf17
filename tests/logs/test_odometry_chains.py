"""Odometry without jumps: what no vehicle can have driven is left out, and the rest goes on from there."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.logs import odometry_chains
from mavnav.logs.odometry_chains import LeftOut, without_jumps
from mavnav.pose import Pose, Trajectory

MS = 10**6
STEP = Pose(0.03, 0.0, 0.01)


def drive(n: int = 200, period_ns: int = 50 * MS, step: Pose = STEP) -> Trajectory:
    poses = [Pose()]
    for _ in range(n - 1):
        poses.append(poses[-1] @ step)
    return Trajectory.of([k * period_ns for k in range(n)], poses)


def changed(path: Trajectory, rows: slice | list[int], by: Pose) -> Trajectory:
    """Return a path of which some poses are seen in another frame."""
    xyyaw = path.xyyaw.copy()
    chosen = Trajectory(path.stamps_ns[rows], path.xyyaw[rows])
    xyyaw[rows] = chosen.seen_from(by).xyyaw
    return Trajectory(path.stamps_ns, xyyaw)


def error_m(found: Trajectory, path: Trajectory) -> float:
    true = path.xyyaw[np.isin(path.stamps_ns, found.stamps_ns)]
    return float(np.abs(found.xyyaw - true).max())


@pytest.mark.parametrize("by", [Pose(-1.5, 0.2, 0.0), Pose(1e6), Pose(0.0, 0.0, 1.0), Pose(3.0, -2.0, 2.0)], ids=str)
def test_odometry_goes_on_after_a_jump(by: Pose) -> None:
    path = drive()
    found, left_out = without_jumps(changed(path, slice(80, None), by))
    assert left_out == LeftOut(0, 1, 4.0)
    assert len(found) == len(path)
    assert error_m(found, path) < 1e-6 + 1e-9 * by.distance_m


def test_poses_that_jump_there_and_back_are_left_out() -> None:
    path = drive()
    found, left_out = without_jumps(changed(path, [50, 51, 120], Pose(2.0)))
    assert left_out == LeftOut(3, 0, 2.5)
    assert len(found) == len(path) - 3
    assert error_m(found, path) == 0.0


def test_of_two_publishers_the_one_with_most_poses_is_used() -> None:
    path = drive()
    found, left_out = without_jumps(changed(path, list(range(0, 200, 3)), Pose(5.0, 1.0, 0.4)))
    assert left_out is not None
    assert left_out.poses == 67
    assert error_m(found, path) == 0.0


@pytest.mark.parametrize(
    "path",
    [drive(), drive(step=Pose(1.5, 0.0, 0.2)), drive(period_ns=1000 * MS, step=Pose(1.0, 0.0, 1.0)), drive(2)],
    ids=["robot", "car", "rare", "short"],
)
def test_motion_of_a_vehicle_stays_as_it_is(path: Trajectory) -> None:
    assert without_jumps(path) == (path, None)


def test_starts_stops_and_quantized_encoders_are_no_jumps() -> None:
    rng = np.random.default_rng(0)
    speeds = np.repeat(rng.uniform(0.0, 1.5, 20), 20) * 0.02
    where_m = np.round(np.cumsum(speeds) / 0.02) * 0.02
    path = Trajectory.of([k * 20 * MS for k in range(400)], [Pose(float(x)) for x in where_m])
    assert without_jumps(path) == (path, None)


def test_odometry_that_always_jumps_stays() -> None:
    rng = np.random.default_rng(0)
    path = Trajectory.of([k * 50 * MS for k in range(60)], [Pose(*p) for p in rng.uniform(-50, 50, (60, 3)).tolist()])
    assert without_jumps(path) == (path, None)


def test_a_pose_is_compared_with_few_chains_however_often_odometry_jumps(monkeypatch: pytest.MonkeyPatch) -> None:
    compared, n = [0], 2000
    speed = odometry_chains._speed

    def counted(*args: object) -> np.ndarray:
        compared[0] += 1
        return speed(*args)

    monkeypatch.setattr(odometry_chains, "_speed", counted)
    rng = np.random.default_rng(0)
    path = Trajectory.of([k * MS for k in range(n)], [Pose(*p) for p in rng.uniform(-50, 50, (n, 3)).tolist()])
    assert without_jumps(path) == (path, None)
    assert n < compared[0] <= odometry_chains.MOST_OPEN * n


def test_what_was_left_out_is_said() -> None:
    text = LeftOut(3, 1, 2.25).text
    assert "1 jump and 3 poses, the first 2.2 s after its start" in text
    assert "pose" not in LeftOut(0, 2, 1.0).text


@pytest.mark.parametrize("unit", [1.0, 100.0, 1000.0])
def test_setting_off_is_no_jump_in_any_unit(unit: float) -> None:
    """After a rest odometry in centimeters is at once faster than any vehicle, which is no reset."""
    path = drive(100)
    rest = np.repeat(path.xyyaw[:1], 20, axis=0)
    xyyaw = np.vstack((rest, path.xyyaw)) * (unit, unit, 1.0)
    found, left_out = without_jumps(Trajectory(np.arange(len(xyyaw)) * 50 * MS, xyyaw))
    assert left_out is None
    assert np.array_equal(found.xyyaw, xyyaw)
    far = Trajectory(np.arange(len(xyyaw)) * 50 * MS, xyyaw + np.arange(len(xyyaw))[:, None] // 60 * (unit, 0.0, 0.0))
    assert without_jumps(far)[1] == LeftOut(0, 1, 3.0)
