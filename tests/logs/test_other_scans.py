"""Scans in messages of other types: echoes, and points; beside the same scans as LaserScan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from mavnav.errors import NoScansError
from mavnav.logs import open_log, survey
from mavnav.logs.messages.decode import _picker
from mavnav.scan import LaserSpec
from support.log_files import store

START_NS, SCANS = 1_700_000_000_000_000_000, 5
SPEC = LaserSpec(-2.0, 4.0 / 360, 361, 0.1, 10.0)
MULTI_ECHO, CLOUD, LASER = (f"sensor_msgs/msg/{name}" for name in ("MultiEchoLaserScan", "PointCloud2", "LaserScan"))


def ranges(k: int) -> np.ndarray:
    found = np.random.default_rng(k).uniform(0.5, 9.0, SPEC.beams)
    found[:: 10 + k] = np.inf
    return found.astype(np.float32).astype(np.float64)


def header(k: int) -> Any:
    stamp = store(2).types["builtin_interfaces/msg/Time"](sec=1_700_000_000, nanosec=k * 100_000_000)
    return store(2).types["std_msgs/msg/Header"](stamp=stamp, frame_id="laser")


def echoes(k: int) -> Any:
    """Return a message whose first echo is scan k, the last one 0.5 m behind it; every other first one is stronger."""
    new = store(2).types["sensor_msgs/msg/LaserEcho"]
    beams = [np.array([r, r + 0.5] if np.isfinite(r) else [], np.float32) for r in ranges(k)]
    strong = [np.array(([2, 1], [1, 2])[i % 2] if len(b) else [], np.float32) for i, b in enumerate(beams)]
    last = SPEC.angle_min_rad + SPEC.angle_step_rad * (SPEC.beams - 1)
    return store(2).types[MULTI_ECHO](
        header(k), SPEC.angle_min_rad, last, SPEC.angle_step_rad, 0.0, 0.1, SPEC.range_min_m, SPEC.range_max_m,
        [new(b) for b in beams], [new(b) for b in strong],
    )  # fmt: skip


def cloud(k: int, *, rings: int = 0, big: bool = False, nan: bool = False, scan: int | None = None) -> Any:
    """Return a cloud of scan k at z = 0.02 m; with rings above and below it, ring 1 is the level one."""
    field = store(2).types["sensor_msgs/msg/PointField"]
    r, bearing = ranges(k if scan is None else scan), SPEC.angles_rad
    kept = np.isfinite(r) | nan
    r, bearing = np.where(np.isfinite(r), r, np.nan)[kept], bearing[kept]
    kind = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("t", "f8")])
    rows = np.zeros((max(rings, 1), len(r)), kind.newbyteorder(">" if big else "<"))
    for ring in range(max(rings, 1)):
        far = r * (1.0 if ring == min(1, rings) else 0.5)
        rows[ring]["x"], rows[ring]["y"] = far * np.cos(bearing), far * np.sin(bearing)
        rows[ring]["z"], rows[ring]["ring"] = 0.02 + (ring - min(1, rings)), ring
    numbers = {"f4": 7, "u2": 4, "f8": 8}
    fields = [
        field(name, offset, numbers[f"{d.kind}{d.itemsize}"], 1)
        for name, (d, offset) in kind.fields.items()  # type: ignore[union-attr, misc]
        if rings or name != "ring"
    ]
    data = np.frombuffer(rows.tobytes(), np.uint8)
    width, step = rows.size, kind.itemsize
    return store(2).types[CLOUD](header(k), 1, width, fields, big, step, width * step, data, not nan)


def laser(k: int) -> Any:
    last = SPEC.angle_min_rad + SPEC.angle_step_rad * (SPEC.beams - 1)
    return store(2).types[LASER](
        header(k), SPEC.angle_min_rad, last, SPEC.angle_step_rad, 0.0, 0.1, SPEC.range_min_m, SPEC.range_max_m,
        ranges(k).astype(np.float32), np.zeros(0, np.float32),
    )  # fmt: skip


def written(path: Path, **topics: Callable[[int], Any]) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        for name, make in topics.items():
            messages = [make(k) for k in range(SCANS)]
            schema = writer.register_schema(messages[0].__msgtype__, "ros2msg", b"")
            channel = writer.register_channel(f"/{name}", "cdr", schema)
            for k, message in enumerate(messages):
                data = bytes(store(2).serialize_cdr(message, message.__msgtype__))
                writer.add_message(channel, START_NS + k * 100_000_000, data, START_NS)
        writer.finish()
    return path


def seen(path: Path, topic: str | None = None) -> list[np.ndarray]:
    """Return the end points of every scan, sorted by bearing."""
    found = []
    for scan in open_log(path, topic=topic).scans():
        points = scan.points()
        found.append(points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))])
    return found


def truth(add_m: float | np.ndarray = 0.0) -> list[np.ndarray]:
    found = []
    for k in range(SCANS):
        r = ranges(k) + add_m
        use = np.isfinite(r) & (r <= SPEC.range_max_m)
        found.append(r[use, None] * SPEC.directions[use])
    return found


@pytest.mark.parametrize(
    ("part", "add_m"), [("", 0.0), ("/first", 0.0), ("/last", 0.5), ("/strongest", 0.5 * (np.arange(SPEC.beams) % 2))]
)
def test_echoes(part: str, add_m: float | np.ndarray, tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", echoes=echoes, scan=laser)
    for found, wanted in zip(seen(path, f"/echoes{part}"), truth(add_m), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert open_log(path).topic == "/scan"


@pytest.mark.parametrize(
    ("options", "topic"),
    [
        ({}, None),
        ({"nan": True}, None),
        ({"big": True}, None),
        ({"rings": 3}, None),
        ({"rings": 3}, "/points/ring_1"),
        ({"rings": 3}, "/points/z_-0.1_0.1"),
    ],
)
def test_points_of_a_layer(options: dict[str, Any], topic: str | None, tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", points=lambda k: cloud(k, **options))
    for found, wanted in zip(seen(path, topic), truth(), strict=True):
        np.testing.assert_allclose(found, wanted, atol=2e-3)
    log = open_log(path, topic=topic)
    assert log.counts.usable == SCANS
    assert log.sensor.angle_step_rad == pytest.approx(SPEC.angle_step_rad, rel=1e-3)
    assert bool(log.warnings) == (topic is None)


def test_another_ring(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", points=lambda k: cloud(k, rings=3))
    for found, wanted in zip(seen(path, "/points/ring_2"), truth(), strict=True):
        np.testing.assert_allclose(found, 0.5 * wanted, atol=2e-3)


def test_two_such_topics_need_a_choice(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", points=cloud, echoes=echoes)
    with pytest.raises(NoScansError, match=r"--topic: /echoes, /points"):
        open_log(path)
    assert not survey(path).scans
    assert [len(open_log(path, topic=topic)) for topic in ("/echoes", "/points")] == [SCANS, SCANS]


@pytest.mark.parametrize("topic", [None, "/points/ring_1"])
def test_empty_clouds_are_empty_scans(topic: str | None, tmp_path: Path) -> None:
    def late(k: int) -> Any:
        message = cloud(k, rings=3)
        if k in (0, 3):
            message.width, message.data = 0, message.data[:0]
        return message

    path = written(tmp_path / "a.mcap", points=late)
    log = open_log(path, topic=topic)
    assert log.damage == ()
    assert log.counts.skipped == {"empty": 1, "no_valid_beam": 1}
    for found, wanted in zip(seen(path, topic), [truth()[k] for k in range(SCANS) if k not in (0, 3)], strict=True):
        np.testing.assert_allclose(found, wanted, atol=2e-3)


def test_a_layer_without_points_has_no_scans(tmp_path: Path) -> None:
    with pytest.raises(NoScansError, match=rf"none of the {SCANS} scans on /points/z_5_6 is usable \({SCANS} empty\)"):
        open_log(written(tmp_path / "a.mcap", points=cloud), topic="/points/z_5_6")


def test_a_cloud_without_coordinates_is_damage(tmp_path: Path) -> None:
    def broken(k: int) -> Any:
        message = cloud(k)
        if k == 2:
            message.fields[0].name = "range"
        if k == 3:
            message.width = 1 << 30
        return message

    log = open_log(written(tmp_path / "a.mcap", points=broken))
    assert log.counts.usable == SCANS - 2
    assert "without the field 'x'" in log.damage[0].what
    assert all("PointCloud2" in damage.what for damage in log.damage)


@pytest.mark.parametrize("rings", [[np.nan] * 4, [np.nan, 3.0, 3.0, np.nan]])
def test_points_without_a_choice_of_rings_are_chosen_by_height(rings: list[float]) -> None:
    points = {"x": np.ones(4), "y": np.ones(4), "z": np.array((0.0, 0.05, 0.5, -2.0)), "ring": np.array(rings)}
    assert _picker(points, "")(points).tolist() == [True, True, False, False]
