"""Sensor health: what is reported of a laser, and that a healthy one is reported as healthy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mavnav.cli import run
from mavnav.logs import open_log
from mavnav.logs.health import SensorHealth, sensor_health
from support.log_files import PERIOD_NS, START_NS, Message, laser, write_mcap

BEAMS, STEP_RAD = 90, 2 * np.pi / 90


def scans(count: int = 40) -> list[Message]:
    """Return scans all round by a noisy laser."""
    rng = np.random.default_rng(0)
    ranges = rng.uniform(2.0, 3.0, (count, BEAMS))
    return [laser(k, ranges=ranges[k], angle_min=0.0, angle_increment=STEP_RAD) for k in range(count)]


def spoilt(messages: list[Message], numbers: range, beams: slice) -> list[Message]:
    for k in numbers:
        messages[k].fields["ranges"][beams] = 0.0
    return messages


def sparse() -> list[Message]:
    return spoilt(scans(), range(40), slice(0, None, 2))


def partial() -> list[Message]:
    return spoilt(scans(), range(1), slice(20, None))


def hidden() -> list[Message]:
    return spoilt(scans(), range(40), slice(10, 20))


def repeated() -> list[Message]:
    messages = scans()
    for k in range(1, 40, 2):
        messages[k].fields["ranges"] = messages[k - 1].fields["ranges"]
    return messages


def far() -> list[Message]:
    messages = scans()
    for message in messages:
        message.fields["ranges"][:9] = np.linspace(31.0, 45.5, 9)
        message.fields["range_max"] = 80.0
    return messages


def at(stamps_ns: list[int]) -> list[Message]:
    found = zip(scans(len(stamps_ns)), stamps_ns, strict=True)
    return [Message(m.topic, m.type, START_NS + ns, m.fields, m.time_ns) for m, ns in found]


def gap() -> list[Message]:
    return at([k * PERIOD_NS + (k > 20) * 10 * PERIOD_NS for k in range(40)])


def slow() -> list[Message]:
    return at([k * 10 * PERIOD_NS for k in range(40)])


def jitter() -> list[Message]:
    return at([k * PERIOD_NS + (k % 2) * 4 * PERIOD_NS // 10 for k in range(40)])


def backwards() -> list[Message]:
    return at([(k - 4 * (k == 20)) * PERIOD_NS + (k == 20) for k in range(40)])


def examined(messages: list[Message], path: Path) -> SensorHealth:
    return sensor_health(open_log(write_mcap(path, messages)), far_m=30.0)


@pytest.mark.parametrize(
    ("make", "kinds"),
    [
        (scans, []),
        (sparse, ["sparse"]),
        (partial, ["partial"]),
        (hidden, ["dead_sectors"]),
        (repeated, []),
        (far, ["far"]),
        (gap, ["gaps"]),
        (slow, ["slow"]),
        (jitter, ["jitter"]),
        (backwards, ["stamps"]),
    ],
)
def test_each_fault_is_found_alone(make: Callable[[], list[Message]], kinds: list[str], tmp_path: Path) -> None:
    found = examined(make(), tmp_path / "a")
    assert [finding.kind for finding in found.findings] == kinds
    assert found.healthy == (not kinds)


def test_a_sector_is_given_in_degrees(tmp_path: Path) -> None:
    ((low, high),) = examined(hidden(), tmp_path / "a").dead_sectors_deg
    assert abs(low - 40.0) <= 4.0
    assert abs(high - 80.0) <= 4.0


def test_a_sector_across_the_x_axis_is_named_within_a_turn(tmp_path: Path) -> None:
    messages = spoilt(spoilt(scans(), range(40), slice(0, 5)), range(40), slice(85, None))
    for message in messages:
        message.fields["angle_min"] = 0.01
    health = examined(messages, tmp_path / "a")
    assert health.dead_sectors_deg == [(340.0, 380.0)]
    assert [finding.what for finding in health.findings] == ["no valid return in any scan at 340 to 20 deg"]


def test_far_returns_are_counted_with_the_setting_that_uses_them(tmp_path: Path) -> None:
    (finding,) = examined(far(), tmp_path / "a").findings
    assert finding.what == "10 % of the returns are farther than 30 m, up to 46 m, and not used"
    assert "robust.far_mm" in finding.advice


def test_the_table_names_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(write_mcap(tmp_path / "a", scans()))]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split() == ["health", "healthy"] for line in lines)
    assert any(line.split() == ["state", "sound"] for line in lines)
    assert run(["info", str(write_mcap(tmp_path / "b", partial()))]) == 0
    out = capsys.readouterr().out
    assert "a replay begins its map after them" in out
    assert "sound; 1 finding of the sensor to check" in out


@pytest.mark.parametrize("step_rad", [3e38, -1e5])
def test_a_single_beam_of_an_impossible_step_is_left_out(step_rad: float, tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a.mcap", [*scans(5), laser(5, ranges=[2.0], angle_increment=step_rad)]))
    assert log.counts.skipped == {"impossible_geometry": 1}
    assert sensor_health(log).examined == 5
