"""CARMEN logs: lines of text with scans and poses; which poses are odometry, and which are a SLAM's."""

from __future__ import annotations

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest

from mavnav.errors import NoScansError
from mavnav.logs import Log, open_log
from mavnav.logs.writing.convert import convert_log
from mavnav.pose import Pose

OFFSET, HERE = Pose(0.2, 0.0, 0.0), Pose()
PARAMETERS = (
    "# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp\n"
    "PARAM robot_frontlaser_offset 0.2 0.1 host 0.1\nPARAM robot_front_laser_max 50.0 0.1 host 0.1\n"
)


def pose(k: int) -> Pose:
    return Pose(0.05 * k, 0.01 * k, 0.02 * k)


def numbers(*poses: Pose) -> str:
    return " ".join(f"{value:.6f}" for p in poses for value in p)


def ranges(k: int, beams: int = 181) -> np.ndarray:
    return np.round(np.random.default_rng(k).uniform(1.0, 9.0, beams), 2)


def front(k: int, beams: int = 181, *, off: Pose = HERE, name: str = "FLASER") -> str:
    """Return scan k; ``off`` is where a SLAM put the laser, in its own frame."""
    values = " ".join(f"{r:.2f}" for r in ranges(k, beams))
    laser = pose(k) @ OFFSET @ off
    return f"{name} {beams} {values} {numbers(laser, pose(k))} {1000 + 0.2 * k:.6f} host {0.2 * k:.6f}\n"


def odom(k: int, moved: Pose = HERE) -> str:
    return f"ODOM {numbers(pose(k) @ moved)} 0 0 0 {1000 + 0.2 * k:.6f} host {0.2 * k:.6f}\n"


def written(path: Path, *lines: str) -> Path:
    path.write_text(PARAMETERS + "".join(lines))
    return path


def opened(path: Path, **options: object) -> Log:
    return open_log(path, **options)  # type: ignore[arg-type]


def test_a_front_laser_with_odometry(tmp_path: Path) -> None:
    log = opened(written(tmp_path / "a.clf", *(odom(k) + front(k) for k in range(9))))
    assert (log.format, log.topic, log.counts.usable, log.damage, log.warnings) == ("carmen", "/scan", 9, (), ())
    assert log.base_T_laser == pytest.approx(OFFSET, abs=2e-6)
    assert log.odometry
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw, [pose(k) for k in range(9)], atol=1e-6)
    scans = list(log.scans())
    assert [s.stamp_ns for s in scans] == [1_000_000_000_000 + 200_000_000 * k for k in range(9)]
    spec = scans[0].spec
    assert (spec.beams, spec.range_max_m) == (181, 50.0)
    assert np.degrees((spec.angle_min_rad, spec.angle_step_rad)) == pytest.approx((-90.0, 1.0), abs=1e-5)
    np.testing.assert_array_equal(scans[3].ranges_m, ranges(3).astype(np.float32))


def test_odometry_of_the_scans_where_it_has_no_lines_of_its_own(tmp_path: Path) -> None:
    log = opened(written(tmp_path / "a.log", *(front(k) for k in range(9))))
    assert log.odometry
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw, [pose(k) for k in range(9)], atol=1e-6)


def test_poses_of_a_slam_beside_odometry_are_truth(tmp_path: Path) -> None:
    lines = [front(k, off=Pose(0.01 * k, 0.02 * k, 0.0)) for k in range(9)]
    log = opened(written(tmp_path / "a.log", *lines), truth="auto")
    assert log.odometry
    assert log.truth
    truth = [pose(k) @ OFFSET @ Pose(0.01 * k, 0.02 * k) for k in range(9)]
    np.testing.assert_allclose(log.truth.world_T_laser.xyyaw, truth, atol=2e-6)
    assert log.base_T_laser == pytest.approx(OFFSET)


@pytest.mark.parametrize(
    "line", [lambda k: front(k) + "NEFF 9.9\n", lambda k: odom(k, Pose(0.1 * k)) + front(k)], ids=["filter", "odometry"]
)
def test_corrected_poses_are_truth_and_no_odometry(line, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    log = opened(written(tmp_path / "a.log", *(line(k) for k in range(9))), truth="auto")
    assert log.odometry is None
    assert log.truth
    np.testing.assert_allclose(log.truth.world_T_laser.xyyaw, [pose(k) @ OFFSET for k in range(9)], atol=2e-6)
    assert log.warnings[0].endswith("no odometry; --truth auto compares with them")


@pytest.mark.parametrize(("beams", "step_deg"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5), (541, 1 / 3)])
def test_a_front_laser_covers_half_a_turn(beams: int, step_deg: float, tmp_path: Path) -> None:
    log = opened(written(tmp_path / "a.log", front(0, beams), front(1, beams)))
    assert np.degrees(log.sensor.angle_step_rad) == pytest.approx(step_deg, abs=1e-5)
    assert np.degrees(log.sensor.angle_min_rad) == pytest.approx(-90.0, abs=1e-5)


@pytest.mark.parametrize("kind", ["RAWLASER1", "ROBOTLASER1"])
def test_lasers_that_name_their_geometry(kind: str, tmp_path: Path) -> None:
    def line(k: int) -> str:
        values = " ".join(f"{r:.2f}" for r in ranges(k, 5))
        poses = f"{numbers(pose(k) @ OFFSET, pose(k))} 0 0 0 0 0 " if kind == "ROBOTLASER1" else ""
        return f"{kind} 0 -1.5 3.0 0.75 20.0 0.01 0 5 {values} 2 7 8 {poses}{1000 + 0.2 * k} host {0.2 * k}\n"

    log = opened(written(tmp_path / "a.log", *(line(k) for k in range(3))))
    spec = log.sensor
    assert (spec.beams, spec.angle_min_rad, spec.angle_step_rad, spec.range_max_m) == (5, -1.5, 0.75, 20.0)
    np.testing.assert_array_equal(next(log.scans()).ranges_m, ranges(0, 5).astype(np.float32))
    assert (log.odometry is not None) == (kind == "ROBOTLASER1")


def test_front_and_rear_laser_are_two_topics(tmp_path: Path) -> None:
    path = written(tmp_path / "a.log", *(front(k) + front(k, name="RLASER") for k in range(3)))
    log = opened(path, topic="/rear_scan")
    assert (log.frame_id, log.counts.usable) == ("rear_laser", 3)


@pytest.mark.parametrize(("suffix", "pack"), [(".gz", gzip.compress), (".bz2", bz2.compress)])
def test_compressed_logs(suffix: str, pack, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    plain = written(tmp_path / "a.log", *(front(k) for k in range(9)))
    packed = tmp_path / f"a.log{suffix}"
    packed.write_bytes(pack(plain.read_bytes()))
    assert opened(packed).counts == opened(plain).counts


def test_a_log_that_is_cut_in_its_compressed_file(tmp_path: Path) -> None:
    packed = tmp_path / "a.log.gz"
    packed.write_bytes(gzip.compress(written(tmp_path / "a.log", *(front(k) for k in range(99))).read_bytes())[:-999])
    cut = opened(packed)
    assert cut.damage
    assert 50 < cut.counts.usable < 99


@pytest.mark.parametrize("suffix", [".gz", ".bz2"])
def test_what_comes_before_other_bytes_in_a_compressed_file_is_read(suffix: str, tmp_path: Path) -> None:
    text = written(tmp_path / "a.log", *(front(k) for k in range(9))).read_bytes()
    packed = tmp_path / f"a.log{suffix}"
    packed.write_bytes(gzip.compress(text) + b"rubbish" if suffix == ".gz" else bz2.compress(text)[:-4])
    log = opened(packed)
    assert log.damage
    assert log.counts.usable == 9


def test_lines_that_are_no_messages_are_damage_and_cost_only_themselves(tmp_path: Path) -> None:
    broken = "FLASER 181 1.0 2.0\nODOM x y z 0 0 0 1 host 1\nFLASER 1e9 3\nPARAM alone\nFLASER -3 4 5 6 7 8 9 0 1 2\n"
    path = written(tmp_path / "a.log", front(0), broken, front(1), front(2)[:300])
    log = opened(path)
    assert log.counts.usable == 2
    assert [d.where for d in log.damage] == [f"a.log, line {k}" for k in (5, 6, 7, 8, 9, 11)]
    assert "within it" in log.damage[-1].what


def test_parameters_in_other_encodings_are_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_bytes("PARAM robot_name M\u00fcller 0.1 host 0.1\n".encode("latin-1") + front(0).encode())
    assert opened(path).damage == ()


def test_zeros_of_a_crash_are_damage(tmp_path: Path) -> None:
    path = written(tmp_path / "a.log", *(front(k) for k in range(9)))
    lines = path.read_bytes().splitlines(keepends=True)
    lines[6:8] = [bytes(len(lines[6])) + lines[7]]
    path.write_bytes(b"".join(lines))
    log = opened(path)
    assert log.counts.usable == 7
    assert [d.where for d in log.damage] == ["a.log, line 7"]


@pytest.mark.parametrize("yaw", ["inf", "-1e999", "nan", "1e300"])
def test_a_pose_without_a_finite_yaw_is_the_logs_fault(yaw: str, tmp_path: Path) -> None:
    pose_without = f"ODOM 0 0 {yaw} 0 0 0 1000.1 host 0.1\n"
    log = opened(written(tmp_path / "a.log", *(odom(k) + front(k) for k in range(9)), pose_without))
    assert log.counts.usable == 9
    assert len(log.damage) == (yaw in {"inf", "-1e999"})


@pytest.mark.parametrize("name", ["robot_front_laser_max", "laser_front_laser_resolution", "robot_frontlaser_offset"])
def test_a_parameter_that_is_no_number_costs_only_itself(name: str, tmp_path: Path) -> None:
    path = written(tmp_path / "a.log", f"PARAM {name} 0x10 0.1 host 0.1\n", *(odom(k) + front(k) for k in range(9)))
    assert [d.where for d in opened(path).damage] == ["a.log, line 4"]
    assert convert_log(path, tmp_path / "a.mcap").messages == 19


def test_what_is_no_carmen_log_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "notes.log"
    text.write_text("the FLASER lines were lost\n" * 9)
    with pytest.raises(NoScansError, match="CARMEN"):
        opened(text)


@pytest.mark.parametrize("corrected", [False, True])
def test_converted_to_ros_it_is_the_same_log(tmp_path: Path, *, corrected: bool) -> None:
    lines = [odom(k) + front(k) + ("NEFF 9\n" if corrected else "") for k in range(9)]
    source, truth = written(tmp_path / "a.log", *lines), "auto" if corrected else None
    convert_log(source, tmp_path / "a.mcap")
    before, after = (opened(path, truth=truth) for path in (source, tmp_path / "a.mcap"))
    assert after.format == "mcap"
    assert (after.sensor, after.base_T_laser) == (before.sensor, pytest.approx(before.base_T_laser))
    for a, b in zip(before.scans(), after.scans(), strict=True):
        assert a.stamp_ns == b.stamp_ns
        np.testing.assert_array_equal(a.ranges_m, b.ranges_m)
    for a, b in ((before.odometry, after.odometry), (before.truth, after.truth)):
        assert (a is None) == (b is None)
    if before.truth and after.truth:
        np.testing.assert_allclose(after.truth.world_T_laser.xyyaw, before.truth.world_T_laser.xyyaw, atol=1e-12)
    if before.odometry and after.odometry:
        np.testing.assert_allclose(after.odometry.odom_T_base.xyyaw, before.odometry.odom_T_base.xyyaw, atol=1e-12)


@pytest.mark.parametrize("stamp", ["99999999999999999999.0", "-99999999999999999999.0"])
def test_an_impossible_stamp_of_the_odometry_costs_one_pose(tmp_path: Path, stamp: str) -> None:
    path = tmp_path / "a.log"
    lines = [front(k) + f"ODOM {numbers(pose(k))} 0 0 0 {1000 + 0.2 * k:.6f} host {0.2 * k:.6f}\n" for k in range(12)]
    path.write_text(PARAMETERS + "".join(lines) + f"ODOM {numbers(pose(12))} 0 0 0 {stamp} host 2.4\n")
    log = open_log(path)
    assert len(log) == 12
    assert log.odometry is not None
    assert 12 <= len(log.odometry.odom_T_base) <= 13
