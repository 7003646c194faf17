"""Time offset, scales and noise of odometry, estimated beside a tracked path."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.pose import Pose, Trajectory
from mavnav.slam.matching.motion_model import GAP_S
from mavnav.slam.matching.odometry_fit import (
    GOOD_ODOMETRY,
    LEAST_ERROR,
    NEIGHBOURS,
    LogOdometry,
    OdometryFit,
    average_stamps,
    fit_odometry,
    in_meters,
    share_of_turns,
    with_noise,
)
from mavnav.units import NS

MS, S = 10**6, 10**9
CENTRED, MOUNTING = Pose(), Pose(0.2, -0.1, 0.3)


def swerving(steps: int = 300) -> Trajectory:
    """Return a path of 10 poses a second whose speed and turns change all the time."""
    poses = [Pose()]
    for k in range(steps):
        poses.append(poses[-1] @ Pose(0.05 + 0.04 * np.sin(0.5 * k), 0.0, 0.1 * np.cos(0.08 * k)))
    return Trajectory.of([S + 100 * MS * k for k in range(steps + 1)], poses)


def steady(steps: int = 300) -> Trajectory:
    return Trajectory.of([S + 100 * MS * k for k in range(steps + 1)], [Pose(0.05 * k) for k in range(steps + 1)])


def wheels(
    path: Trajectory,
    offset_s: float = 0.0,
    scale: float = 1.0,
    turn: float = 1.0,
    jitter_s: float = 0.0,
    mounting: Pose = CENTRED,
) -> LogOdometry:
    """Return the odometry of a laser on a base: adding ``offset_s`` and dividing by the scales makes it right."""
    base = path.compose(mounting.inverse())
    poses = [base[0]]
    for k in range(len(base) - 1):
        moved = base[k].between(base[k + 1])
        step = scale * complex(moved.x_m, moved.y_m) * np.exp(0.5j * (turn - 1.0) * moved.yaw_rad)
        poses.append(poses[-1] @ Pose(float(step.real), float(step.imag), turn * moved.yaw_rad))
    jitter = np.random.default_rng(1).uniform(-jitter_s, jitter_s, len(path))
    stamps_ns = np.sort(path.stamps_ns + np.round((jitter - offset_s) / NS).astype(np.int64))
    return LogOdometry(Trajectory.of(stamps_ns.tolist(), poses), mounting)


@pytest.mark.parametrize("mounting", [CENTRED, MOUNTING], ids=["centred", "mounted"])
@pytest.mark.parametrize("scales", [(1.0, 1.0), (1.08, 0.93), (100.0, 1.0)], ids=str)
@pytest.mark.parametrize("offset_s", [-0.62, 0.0, 0.44])
def test_offset_and_scales_are_those_planted(offset_s: float, scales: tuple[float, float], mounting: Pose) -> None:
    path = swerving()
    fit = fit_odometry(wheels(path, offset_s, *scales, mounting=mounting), path, GOOD_ODOMETRY)
    assert fit is not None
    assert fit.offset_s == pytest.approx(offset_s, abs=0.01)
    assert fit.distance_scale == pytest.approx(1.0 / scales[0], rel=0.02)
    assert fit.turn_scale == pytest.approx(1.0 / scales[1], rel=0.02)
    assert LEAST_ERROR <= fit.error < 0.05


@pytest.mark.parametrize("offset_s", [-0.1, 0.16])
def test_jitter_of_the_stamps_hides_no_offset(offset_s: float) -> None:
    path = swerving()
    fit = fit_odometry(wheels(path, offset_s, jitter_s=0.04), path, GOOD_ODOMETRY)
    assert fit is not None
    assert fit.offset_s == pytest.approx(offset_s, abs=0.02)
    assert fit.error < 0.15


def test_stamps_of_arrival_are_averaged_where_odometry_then_fits_better() -> None:
    path = swerving()
    late_ns = np.round(np.random.default_rng(2).uniform(0.0, 0.09, len(path)) / NS).astype(np.int64)
    arrived = Trajectory(path.stamps_ns + late_ns, path.xyyaw)
    odometry = replace(wheels(path), scans_ns=arrived.stamps_ns)
    fit, as_recorded = fit_odometry(odometry, arrived, GOOD_ODOMETRY), fit_odometry(odometry, path, GOOD_ODOMETRY)
    assert fit is not None
    assert fit.mean_stamps
    assert fit.offset_s == pytest.approx(0.045, abs=0.01)
    recorded = with_noise(odometry, arrived, fit._replace(mean_stamps=False))
    assert fit.noise_m_per_m < 0.3 * recorded.noise_m_per_m
    assert as_recorded is not None
    assert not as_recorded.mean_stamps
    pose = odometry.lookup(fit)(int(arrived.stamps_ns[50]))
    assert pose is not None
    assert pose.gap(path[50])[0] < 0.01


def test_averaged_stamps_are_means_of_as_many_on_both_sides_and_across_no_gap() -> None:
    steps_ns = np.random.default_rng(3).integers(50, 150, 60) * MS
    steps_ns[30] = S
    stamps_ns = np.cumsum(steps_ns)
    for k, averaged_ns in enumerate(average_stamps(stamps_ns).tolist()):
        run = range(30) if k < 30 else range(30, 60)
        beside = min(k - run.start, run.stop - 1 - k, NEIGHBOURS)
        assert averaged_ns == pytest.approx(stamps_ns[k - beside : k + beside + 1].mean(), abs=1)
    assert average_stamps(stamps_ns[:1]).tolist() == stamps_ns[:1].tolist()


def test_a_scale_that_may_be_one_is_one() -> None:
    path = swerving()
    jittery = fit_odometry(wheels(path, scale=1.005, turn=0.995, jitter_s=0.04), path, GOOD_ODOMETRY)
    assert jittery is not None
    assert jittery[1:3] == (1.0, 1.0)


def test_turns_that_are_noise_show_no_scale() -> None:
    """Along a corridor the turns of wheels are noise, and a scale of nearly 0 would fit best."""
    path, rng = steady(), np.random.default_rng(3)
    noisy, odometry = (replace(path, xyyaw=path.xyyaw + np.outer(rng.normal(0, 0.01, 301), (0, 0, 1))) for _ in "ab")
    fit = fit_odometry(LogOdometry(odometry), noisy, GOOD_ODOMETRY)
    assert fit is not None
    assert fit.turn_scale == 1.0


def test_a_fifth_of_wrong_motions_changes_nothing() -> None:
    path = swerving()
    wrong = path.xyyaw.copy()
    wrong[200:, 0] += 3.0
    odometry = wheels(path, 0.3)
    clean, spoilt = (
        fit_odometry(odometry, Trajectory(path.stamps_ns, xyyaw), GOOD_ODOMETRY) for xyyaw in (path.xyyaw, wrong)
    )
    assert clean is not None
    assert spoilt is not None
    assert spoilt.offset_s == pytest.approx(clean.offset_s, abs=0.01)
    assert spoilt.error < 0.05


@pytest.mark.parametrize("fault", [{"turn": -1.0}, {"scale": 0.0, "turn": 0.0}, {"offset_s": 3.0}], ids=str)
def test_nothing_makes_wrong_odometry_fit(fault: dict[str, float]) -> None:
    path = swerving()
    fit = fit_odometry(wheels(path, **fault), path, GOOD_ODOMETRY)
    assert fit is None or fit.error > 0.3


def test_at_constant_speed_the_offset_stays() -> None:
    path = steady()
    fit = fit_odometry(wheels(path, 0.5), path, OdometryFit(0.2))
    assert fit is not None
    assert fit.offset_s == 0.2
    assert fit.error == pytest.approx(LEAST_ERROR, abs=1e-3)


def test_too_little_shows_nothing() -> None:
    path = swerving(25)
    rest = Trajectory.of((S + 100 * MS * np.arange(300)).tolist(), 300 * [Pose()])
    assert fit_odometry(wheels(path), path, GOOD_ODOMETRY) is None
    assert fit_odometry(wheels(rest), rest, GOOD_ODOMETRY) is None
    assert fit_odometry(wheels(swerving()), Trajectory.of([], []), GOOD_ODOMETRY) is None
    assert with_noise(wheels(path), path, OdometryFit(0.1, 1.2, 0.9)) == OdometryFit(0.1, 1.2, 0.9, error=np.inf)


def test_noise_is_a_share_of_distance_and_turn() -> None:
    path = swerving()
    known = with_noise(wheels(path, scale=1.1, turn=1.2), path, GOOD_ODOMETRY)
    assert known.noise_m_per_m == pytest.approx(0.1, abs=0.03)
    assert known.noise_rad_per_rad == pytest.approx(0.2, abs=0.03)
    assert known[:3] == GOOD_ODOMETRY[:3]


@pytest.mark.parametrize(("scale", "unit"), [(1.0, 1.0), (0.01, 1.0), (3.0, 1.0), (100.0, 0.01), (1000.0, 0.001)])
def test_units_are_those_in_which_a_vehicle_is_possible(scale: float, unit: float) -> None:
    odometry = wheels(swerving(), scale=scale)
    assert in_meters(odometry, 3.0) == OdometryFit(distance_scale=unit)
    assert in_meters(wheels(swerving(5), scale=scale), 3.0) == GOOD_ODOMETRY


def test_corrected_odometry_leads_where_the_laser_was() -> None:
    path = swerving()
    pose_at = wheels(path, 0.3, 1.1, 0.9, mounting=MOUNTING).lookup(OdometryFit(0.3, 1 / 1.1, 1 / 0.9))
    for k in (0, 100, 290):
        now, later = (pose_at(int(path.stamps_ns[m])) for m in (k, k + 10))
        assert now is not None
        assert later is not None
        assert now.between(later).gap(path[k].between(path[k + 10]))[0] < 1e-6


@pytest.mark.parametrize("mean_stamps", [False, True])
def test_a_pose_of_odometry_is_interpolated_once(mean_stamps: bool) -> None:
    """Every scan asks several times for its own and the one before."""
    path = swerving()
    odometry = replace(wheels(path, 0.0), scans_ns=path.stamps_ns)
    pose_at = odometry.lookup(OdometryFit(mean_stamps=mean_stamps))
    assert pose_at(int(path.stamps_ns[50]) + MS) is pose_at(int(path.stamps_ns[50]) + MS)


def test_odometry_is_unknown_outside_and_in_a_gap() -> None:
    path = swerving()
    kept = np.r_[0:100, 107:301]
    pose_at = LogOdometry(Trajectory(path.stamps_ns[kept], path.xyyaw[kept])).lookup(GOOD_ODOMETRY)
    assert pose_at(int(path.stamps_ns[0]) - 1) is None
    assert pose_at(int(path.stamps_ns[103])) is None
    assert int(path.stamps_ns[107] - path.stamps_ns[99]) > GAP_S / NS
    assert pose_at(int(path.stamps_ns[50]) + 30 * MS) is not None


@pytest.mark.parametrize("mounting", [CENTRED, MOUNTING], ids=["centred", "mounted"])
@pytest.mark.parametrize("turn", [1.0, 0.8, 0.0, -1.0])
def test_the_share_of_the_turns_is_that_of_all_windows(turn: float, mounting: Pose) -> None:
    path = swerving()
    used = GOOD_ODOMETRY._replace(offset_s=0.2)
    assert share_of_turns(wheels(path, 0.2, turn=turn, mounting=mounting), path, used) == pytest.approx(turn, abs=0.01)
    assert share_of_turns(wheels(steady()), steady(), GOOD_ODOMETRY) == 0.0
