"""Several lasers of one base, merged into one virtual scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.cli import run
from mavnav.errors import TopicError
from mavnav.logs import open_log
from mavnav.logs.derived_scans import Mounted, partners, virtual_laser, virtual_scan
from mavnav.pose import Pose
from mavnav.scan import LaserSpec, Scan
from support.log_files import LASER, START_NS, TF, Message, write_mcap

SPEC = LaserSpec(-2.0, 4.0 / 320, 321, 0.1, 10.0, 1e-4)
MIDDLE = SPEC.beams // 2
TURN_RAD = 0.5


def room(spec: LaserSpec, laser: Pose) -> np.ndarray:
    """Return the ranges in a square room of 6 m, from a pose on the base, which is in its middle."""
    angles = spec.angles_rad + laser.yaw_rad
    with np.errstate(divide="ignore", invalid="ignore"):
        to_x = (3.0 * np.sign(np.cos(angles)) - laser.x_m) / np.cos(angles)
        to_y = (3.0 * np.sign(np.sin(angles)) - laser.y_m) / np.sin(angles)
    return np.fmin(to_x, to_y)


def half(topic: str, k: int, beams: slice, yaw_rad: float, late_s: float) -> Message:
    """Return some of the beams of scan k, as of a laser that is turned on the base."""
    ranges = np.random.default_rng(k).uniform(0.5, 9.0, SPEC.beams).astype(np.float32)
    ranges[k] = 0.0
    told = {"angle_min": float(SPEC.angles_rad[beams][0]) - yaw_rad, "angle_increment": SPEC.angle_step_rad}
    told |= {"ranges": ranges[beams], "frame_id": topic[1:], "time_increment": SPEC.time_increment_s}
    return Message(topic, LASER, START_NS + k * 100_000_000 + round(late_s * 1e9), told)


def split(tmp_path: Path, *, mounted: bool = True, missing: int = -1) -> Path:
    """Write scans whole on /whole, and split over /front and /back; of /back one may be missing."""
    edges = [("whole", 0.0), ("front", 0.0), ("back", TURN_RAD)] if mounted else []
    messages = [
        Message("/tf_static", TF, START_NS, {"parent": "base_link", "child": child, "x": 0.0, "y": 0.0, "yaw": yaw})
        for child, yaw in edges
    ]
    for k in range(5):
        messages.append(half("/whole", k, slice(None), 0.0, 0.0))
        messages.append(half("/front", k, slice(0, MIDDLE), 0.0, 0.0))
        if k != missing:
            messages.append(half("/back", k, slice(MIDDLE, None), TURN_RAD, MIDDLE * SPEC.time_increment_s))
    return write_mcap(tmp_path / "two.mcap", messages)


def test_a_scan_split_over_two_lasers_is_put_together_again(tmp_path: Path) -> None:
    path = split(tmp_path)
    whole, both = open_log(path, topic="/whole"), open_log(path, topic="/front,/back")
    assert both.topic == "/front,/back"
    assert both.base_T_laser == Pose()
    assert both.mounting_source == "tf_static"
    assert both.sensor.beams == whole.sensor.beams
    for a, b in zip(whole, both, strict=True):
        assert a.stamp_ns == b.stamp_ns
        assert b.times_s is None
        assert b.spec.time_increment_s == pytest.approx(SPEC.time_increment_s)
        np.testing.assert_allclose(a.ranges_m, b.ranges_m, rtol=1e-14)


def test_the_window_of_all_lasers_counts_from_the_first_scan_of_the_first(tmp_path: Path) -> None:
    """The second laser starts 2 scans later, and a little after the first in every pair."""
    edges = [
        Message("/tf_static", TF, START_NS, {"parent": "base_link", "child": child, "x": 0.0, "y": 0.0, "yaw": 0.0})
        for child in ("front", "back")
    ]
    front = [half("/front", k, slice(0, MIDDLE), 0.0, 0.0) for k in range(12)]
    back = [half("/back", k, slice(MIDDLE, None), 0.0, 0.03) for k in range(2, 12)]
    path = write_mcap(tmp_path / "late.mcap", [*edges, *front, *back])
    log = open_log(path, topic="/front,/back", start_s=0.4, end_s=0.8)
    assert log.warnings == ()
    assert [int(np.isfinite(scan.ranges_m).sum()) > MIDDLE for scan in log] == [True] * 5
    early = open_log(path, topic="/front,/back", end_s=0.3)
    assert early.warnings == ()
    assert [int(np.isfinite(scan.ranges_m).sum()) > MIDDLE for scan in early] == [False, False, True, True]


def test_a_scan_without_a_partner_stays_alone(tmp_path: Path) -> None:
    path = split(tmp_path, missing=2)
    scans = list(open_log(path, topic="/front,/back"))
    valid = [int(np.isfinite(scan.ranges_m).sum()) for scan in scans]
    assert valid == [320, 320, MIDDLE - 1, 320, 320]
    turned = open_log(path, topic="/back,/front")
    assert len(turned) == 4
    assert any("/front: 1 of 5 scans are not merged" in text for text in turned.warnings)


def test_lasers_without_a_mounting_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TopicError, match=r"/front is not known; record /tf_static"):
        open_log(split(tmp_path, mounted=False), topic="/front,/back")
    with pytest.raises(TopicError, match="--extrinsic"):
        open_log(split(tmp_path), topic="/front,/back", extrinsic=Pose())


def test_the_option_is_repeated_to_merge(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(split(tmp_path)), "--topic", "/front", "--topic", "/back"]) == 0
    assert "/front,/back" in capsys.readouterr().out


def test_lasers_apart_see_the_walls_where_they_are() -> None:
    mounts = [Pose(0.3, 0.1, 0.2), Pose(-0.4, -0.1, 3.0)]
    scans = [Scan(0, room(SPEC, mount), SPEC) for mount in mounts]
    lasers = [Mounted(SPEC, mount, np.zeros(1, np.int64)) for mount in mounts]
    scan = virtual_scan(list(zip(scans, mounts, strict=True)), virtual_laser(lasers))
    seen = np.isfinite(scan.ranges_m)
    expected = room(scan.spec, Pose())[seen]
    corner = np.abs(np.abs(scan.spec.angles_rad[seen]) % (np.pi / 2) - np.pi / 4) < 0.03
    assert seen.mean() > 0.8
    np.testing.assert_allclose(scan.ranges_m[seen][~corner], expected[~corner], atol=1e-6)


def test_beams_of_lasers_that_are_not_synchronous_keep_their_times() -> None:
    first, late_ns = Scan(0, room(SPEC, Pose()), SPEC), 30_000_000
    other = Scan(late_ns, room(SPEC, Pose(0.0, 0.0, np.pi)), SPEC)
    lasers = [Mounted(SPEC, Pose(0.0, 0.0, yaw), np.zeros(1, np.int64)) for yaw in (0.0, np.pi)]
    scan = virtual_scan([(first, Pose()), (other, lasers[1].base_T_laser)], virtual_laser(lasers))
    assert scan.times_s is not None
    assert scan.times_s[0] == 0.0
    assert scan.sweep_s == pytest.approx(0.03 + 320 * 1e-4)
    ranges_m, directions = scan.seen_at_mid_sweep(np.array([1.0, 0.0, 0.0]))
    seen = np.isfinite(ranges_m)
    moved = (ranges_m[:, None] * directions - scan.ranges_m[:, None] * scan.spec.directions)[seen]
    np.testing.assert_allclose(moved[:, 0], scan.times_s[seen] - scan.sweep_s / 2.0, atol=1e-9)
    np.testing.assert_allclose(moved[:, 1], 0.0, atol=1e-9)


def test_a_negative_step_is_kept() -> None:
    backwards = replace(SPEC, angle_min_rad=2.0, angle_step_rad=-SPEC.angle_step_rad)
    laser = virtual_laser([Mounted(backwards, Pose(), np.zeros(1, np.int64))])
    assert (laser.angle_min_rad, laser.angle_step_rad, laser.beams) == (2.0, backwards.angle_step_rad, 321)


def test_partners_are_nearest_to_each_other() -> None:
    stamps, others = np.array([0, 100, 200, 300]), np.array([40, 110, 120, 900])
    assert partners(stamps, others).tolist() == [0, 1, -1, -1]
