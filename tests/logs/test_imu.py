"""Inertial sensors: yaw rate and tilt, of both ROS, whatever way up they are mounted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavnav.logs import Log, open_log
from mavnav.logs.messages.decode import decoder
from mavnav.logs.messages.definitions import ImuMessage
from mavnav.logs.messages.fast_cdr import exactly, read_imu
from mavnav.logs.records import Channel
from mavnav.logs.writing.convert import convert_log
from support.log_files import IMU, PERIOD_NS, START_NS, Message, laser, serialized, write_mcap

RATE, STEP_NS = 0.5, 20_000_000


def imu(k: int, topic: str = "/imu", **fields: object) -> Message:
    return Message(topic, IMU, START_NS + k * STEP_NS, {"rates": (0.0, 0.0, RATE)} | fields)


def log_of(tmp_path: Path, *extra: Message, odom: str = "auto", **fields: object) -> Log:
    """Open a log of 10 scans with 50 messages of a sensor that turns steadily."""
    messages = [laser(k) for k in range(10)] + [imu(k, **fields) for k in range(50)] + list(extra)
    return open_log(write_mcap(tmp_path / "turning.mcap", messages), odom=odom)


@pytest.mark.parametrize("ros", [1, 2])
def test_a_message_is_read_by_layout_and_by_definition(ros: int) -> None:
    message = imu(3, xyzw=(0.1, 0.2, 0.3, 0.9), up=(1.0, 2.0, 9.0))
    encoding = "cdr" if ros == 2 else "ros1"
    expected = ImuMessage(START_NS + 3 * STEP_NS, (0.1, 0.2, 0.3, 0.9), (0.0, 0.0, RATE), (1.0, 2.0, 9.0), "imu")
    data = serialized(message, ros)
    assert exactly(read_imu)(data, encoding) == expected
    assert exactly(read_imu)(data[:-8], encoding) is None
    decode = decoder(Channel("/imu", IMU, encoding))
    assert decode is not None
    assert decode(data) == expected


def test_a_message_says_that_it_has_no_orientation() -> None:
    found = exactly(read_imu)(serialized(imu(0), 2), "cdr")
    assert found is not None
    assert found.xyzw is None


MOUNTED = [
    ((0.0, 0.0, RATE), (0.0, 0.0, 9.81)),
    ((RATE, 0.0, 0.0), (1.0, 0.0, 0.0)),
    ((0.0, 0.0, -RATE), (0.0, 0.0, -9.8)),
]


@pytest.mark.parametrize(("rates", "up"), MOUNTED)
def test_the_yaw_rate_is_about_the_vertical(tmp_path: Path, rates: tuple[float, ...], up: tuple[float, ...]) -> None:
    log = log_of(tmp_path, rates=rates, up=up)
    assert log.imu is not None
    assert log.imu.topic == "/imu"
    turned = log.imu.rotation.turned_rad(START_NS + PERIOD_NS + 5_000_000, START_NS + 3 * PERIOD_NS, STEP_NS)
    assert turned == pytest.approx(RATE * 0.195, abs=1e-6)
    np.testing.assert_allclose(log.imu.rotation.tilt_rad, 0.0, atol=1e-3)


def test_there_is_no_turn_outside_of_the_messages_and_in_gaps(tmp_path: Path) -> None:
    log = log_of(tmp_path)
    assert log.imu is not None
    turned = log.imu.rotation.turned_rad
    assert turned(START_NS - 1, START_NS + PERIOD_NS, STEP_NS) is None
    assert turned(START_NS + 1, START_NS + 2 * 10**9, STEP_NS) is None
    assert turned(START_NS + 1, START_NS + PERIOD_NS, STEP_NS - 1) is None


def test_tilt_is_that_of_the_orientation_or_of_gravity(tmp_path: Path) -> None:
    tilted = [imu(k, up=(0.0, 9.81 * np.sin(0.3), 9.81 * np.cos(0.3))) for k in range(50, 200)]
    upright = [imu(k) for k in range(200, 500)]
    log = log_of(tmp_path, *tilted, *upright)
    assert log.imu is not None
    found = log.imu.rotation.tilts_rad(START_NS + np.array([-1, 100, 450]) * STEP_NS)
    np.testing.assert_allclose(found, (0.0, 0.3, 0.0), atol=1e-3)
    leaning = [imu(k, xyzw=(np.sin(0.1), 0.0, 0.0, np.cos(0.1))) for k in range(50, 60)]
    log = log_of(tmp_path, *leaning, xyzw=(0.0, 0.0, 0.0, 1.0))
    assert log.imu is not None
    assert log.imu.rotation.tilt_rad[55] == pytest.approx(0.2, abs=1e-3)


def test_of_several_sensors_the_usual_name_is_used_and_off_uses_none(tmp_path: Path) -> None:
    other = [imu(k, "/imu/data") for k in range(20)]
    log = log_of(tmp_path, *other)
    assert log.imu is not None
    assert log.imu.topic == "/imu/data"
    assert log_of(tmp_path, odom="off").imu is None
    strange = [imu(k, topic) for k in range(20) for topic in ("/a", "/b")]
    log = open_log(write_mcap(tmp_path / "two.mcap", [laser(k) for k in range(10)] + strange))
    assert log.imu is None
    assert any("several Imu topics" in text for text in log.warnings)


def test_impossible_messages_are_dropped(tmp_path: Path) -> None:
    odd = [imu(k, **{name: (np.nan, 0.0, 1e9)}) for k, name in ((50, "rates"), (51, "up"))]
    log = log_of(tmp_path, *odd, imu(52))
    assert log.imu is not None
    assert len(log.imu.rotation.stamps_ns) == 51


def test_a_stamp_from_the_future_costs_one_message(tmp_path: Path) -> None:
    late = Message("/imu", IMU, START_NS + 10**15, {"rates": (0.0, 0.0, RATE)}, START_NS)
    messages = [*(laser(k) for k in range(10)), late, *(imu(k) for k in range(50))]
    log, sound = open_log(write_mcap(tmp_path / "late.mcap", messages)), log_of(tmp_path)
    assert log.imu is not None and sound.imu is not None
    np.testing.assert_array_equal(log.imu.rotation.stamps_ns, sound.imu.rotation.stamps_ns)
    assert any("/imu: 1 of 51 messages are left out" in w for w in log.warnings)


def test_a_sensor_of_another_clock_is_not_used(tmp_path: Path) -> None:
    late = [Message("/imu", IMU, START_NS + 10**12 + k * STEP_NS, {"rates": (0.0, 0.0, RATE)}) for k in range(20)]
    log = open_log(write_mcap(tmp_path / "late.mcap", [laser(k) for k in range(10)] + late))
    assert log.imu is None
    assert any("share no time" in text for text in log.warnings)


def test_a_sensor_whose_clock_stands_still_is_not_used(tmp_path: Path) -> None:
    still = [Message("/imu", IMU, 0, {"rates": (0.0, 0.0, RATE)}, START_NS + k) for k in range(20)]
    log = open_log(write_mcap(tmp_path / "still.mcap", [laser(k) for k in range(10)] + still))
    assert log.imu is None
    assert [text for text in log.warnings if "imu" in text] == [
        "/imu: the stamps of the inertial sensor ascend in 1 of 20 messages; it is not used, check its clock"
    ]


def test_a_rosbag_is_converted_with_its_sensor(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "one.mcap", [laser(0), *[imu(k) for k in range(12)]], ros=1)
    convert_log(source, tmp_path / "two.mcap")
    log = open_log(tmp_path / "two.mcap")
    assert log.imu is not None
    assert len(log.imu.rotation.stamps_ns) == 12


@pytest.mark.parametrize("increment_s", [1e12, 3e38])
def test_an_impossible_time_between_two_beams_is_not_used(tmp_path: Path, increment_s: float) -> None:
    messages = [laser(k, time_increment=increment_s) for k in range(10)] + [imu(k) for k in range(50)]
    log = open_log(write_mcap(tmp_path / "slow.mcap", messages))
    assert log.sensor.time_increment_s == 0.0
    assert log.imu is not None
    assert any("the time between two beams" in warning for warning in log.warnings)
