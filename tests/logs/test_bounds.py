"""Hostile logs: bounded in time and memory, and refused with a line that names what is wrong."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import zlib
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode as Op
from mcap.writer import Writer

from mavnav.errors import NoScansError
from mavnav.logs import choose, open_log, survey
from mavnav.logs.formats import decompress
from mavnav.logs.formats.mcap_records import HEAD
from mavnav.logs.read_report import MAX_DAMAGE, MAX_TEXT, MAX_WARNINGS, ReadReport
from mavnav.logs.writing.convert import convert_log
from mavnav.pipelines.info import info_document
from support.effort import at_most_calls
from support.log_files import (
    ODOM,
    PERIOD_NS,
    START_NS,
    TF,
    Message,
    drive,
    foxglove_json,
    laser,
    serialized,
    write_bag1,
    write_bag2,
    write_mcap,
)

FIELDS = {
    "timestamp": (1, 11, 1), "frame_id": (2, 9, 1), "pose": (3, 11, 1), "start_angle": (4, 1, 1),
    "end_angle": (5, 1, 1), "ranges": (6, 1, 3),
}  # fmt: skip
"""Field of foxglove.LaserScan -> number, type, label."""


def write_protobuf(path: Path, changed: dict[str, tuple[int, int, int] | None], nanos_type: int = 5) -> Path:
    """Write a scan without content whose descriptor has other field types; None leaves a field out."""
    from google.protobuf import descriptor_pb2

    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="foxglove.proto", package="foxglove", syntax="proto3")
    for name, fields in (
        ("Time", (("seconds", 3), ("nanos", nanos_type))),
        ("Vector3", tuple((axis, 1) for axis in "xyz")),
        ("Quaternion", tuple((axis, 1) for axis in "xyzw")),
    ):
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields, 1):
            message.field.add(name=field, number=number, type=kind, label=1)
    pose = file.message_type.add(name="Pose")
    pose.field.add(name="position", number=1, type=11, label=1, type_name=".foxglove.Vector3")
    pose.field.add(name="orientation", number=2, type=11, label=1, type_name=".foxglove.Quaternion")
    scan = file.message_type.add(name="LaserScan")
    for field, told in (FIELDS | changed).items():
        if told is not None:
            number, kind, label = told
            type_name = {"timestamp": ".foxglove.Time", "pose": ".foxglove.Pose"}.get(field, ".foxglove.Vector3")
            scan.field.add(
                name=field, number=number, type=kind, label=label, **({"type_name": type_name} if kind == 11 else {})
            )
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("foxglove.LaserScan", "protobuf", files.SerializeToString())
        channel = writer.register_channel("/scan", "protobuf", schema)
        writer.add_message(channel, START_NS, b"", START_NS)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("field", "told", "text"),
    [
        ("frame_id", (2, 9, 3), "field frame_id is repeated string, it should be string"),
        ("ranges", (6, 1, 1), "field ranges is double, it should be repeated double"),
        ("ranges", (6, 9, 3), "field ranges is repeated string, it should be repeated double"),
        ("start_angle", (4, 11, 1), "field start_angle is message, it should be double"),
        ("timestamp", (1, 9, 1), "field timestamp is string, it should be a message"),
        ("pose", (3, 1, 1), "field pose is double, it should be a message"),
        ("end_angle", None, "field end_angle is missing, it should be double"),
    ],
)
def test_a_protobuf_field_of_another_type_is_named(
    field: str, told: tuple[int, int, int] | None, text: str, tmp_path: Path
) -> None:
    with pytest.raises(NoScansError, match=text):
        open_log(write_protobuf(tmp_path / "a.mcap", {field: told}))


def test_a_time_of_strings_takes_no_memory(tmp_path: Path) -> None:
    with pytest.raises(NoScansError, match=r"field timestamp\.nanos is string, it should be int32"):
        open_log(write_protobuf(tmp_path / "a.mcap", {}, nanos_type=9))


def test_a_descriptor_of_megabytes_is_not_parsed(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start()
        schema = writer.register_schema("foxglove.LaserScan", "protobuf", b"\x0a\0" * (1 << 20))
        writer.add_message(writer.register_channel("/scan", "protobuf", schema), START_NS, b"", START_NS)
        writer.finish()
    with pytest.raises(NoScansError, match="has more than 1048576 bytes"):
        open_log(path)


@pytest.mark.parametrize(
    "text",
    [
        b"[" * 1_000_000,
        b'{"a":' * 500_000,
        b'{"timestamp": {"sec": ' + b"9" * 5000 + b', "nsec": 0}}',
        b'{"timestamp": {"sec": 1, "nsec": 0}, "start_angle": 0, "end_angle": 1, "ranges": ['
        + b"0," * 5_000_000
        + b"0]}",
    ],
)
def test_json_that_is_deep_or_large_or_of_many_digits_is_no_scan(text: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start()
        schema = writer.register_schema("foxglove.LaserScan", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/scan", "json", schema), START_NS, text, START_NS)
        writer.finish()
    with at_most_calls(20_000), pytest.raises(NoScansError, match="1 undecodable"):
        open_log(path)


def test_json_numbers_beyond_all_bounds_do_no_harm(tmp_path: Path) -> None:
    sound: dict[str, Any] = {"timestamp": {"sec": 1, "nsec": 0}, "frame_id": "l", "start_angle": -1.0, "end_angle": 1.0}
    sound["ranges"] = [1.0] * 20
    odd = [{"timestamp": {"sec": 1e300, "nsec": 0}}, {"start_angle": 1e308, "end_angle": -1e308}, {"ranges": [1e308]}]
    log = open_log(foxglove_json(tmp_path / "a.mcap", [sound, *(sound | other for other in odd)]))
    assert (log.counts.usable, log.stamp_source) == (2, "log")


def altered_database(path: Path, *statements: str) -> Path:
    file = next(write_bag2(path, [laser(k) for k in range(5)]).glob("*.db3"))
    with closing(sqlite3.connect(file)) as connection:
        for statement in statements:
            connection.execute(statement)
        connection.commit()
    return file


def test_a_computed_column_is_refused(tmp_path: Path) -> None:
    path = altered_database(
        tmp_path / "a",
        "DROP TABLE messages",
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,"
        " data BLOB GENERATED ALWAYS AS (hex(zeroblob(10000000))))",
        "INSERT INTO messages (topic_id, timestamp) WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n"
        " WHERE k < 2000) SELECT 1, k FROM n",
    )
    with pytest.raises(NoScansError, match="the column data of messages is computed"):
        open_log(path)


def test_a_topic_without_a_name_is_the_logs_fault(tmp_path: Path) -> None:
    path = altered_database(
        tmp_path / "a",
        "ALTER TABLE topics RENAME TO old",
        "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)",
        "INSERT INTO topics SELECT id, NULL, type, serialization_format FROM old",
    )
    found = survey(path)
    assert any("has no name" in d.what for d in found.damage)
    assert open_log(path).counts.suspect == 5
    done = convert_log(path, tmp_path / "b.mcap")
    assert done.damage


def test_warnings_are_capped_and_short() -> None:
    report = ReadReport()
    for k in range(MAX_WARNINGS + 900):
        report.warn(f"odd {k}" + "x" * 1000)
        report.damage(f"broken {k}" + "y" * 1000, "z" * 1000)
    assert len(report.warnings) == MAX_WARNINGS + 1
    assert report.warnings[-1].startswith("900 more warnings")
    assert len(report.damages()) < MAX_DAMAGE + 30
    assert max(len(d.what) for d in report.damages()) <= MAX_TEXT + len(" (900 more)")
    assert max(map(len, report.warnings)) <= MAX_TEXT


def test_of_hundreds_of_topics_the_first_hundred_are_read(tmp_path: Path) -> None:
    scans = [laser(k % 50, topic=f"/scan{k}", angle_max=3.0) for k in range(400)]
    path = write_mcap(tmp_path / "a.mcap", scans, chunk_size=1 << 20)
    with at_most_calls(1_500_000):
        found = survey(path)
        logs = [choose(found, topic=topic) for topic in found.scans]
        assert len(logs) == 100
        assert "more than 100 topics have scans; others are left out, name one by --topic" in found.warnings
        assert sum(len(log.warnings) for log in logs) <= (MAX_WARNINGS + 3) * len(logs)
        assert list(survey(path, topic="/scan399").scans) == ["/scan399"]


@pytest.mark.slow
def test_of_thirty_thousand_scan_topics_a_hundred_are_examined(tmp_path: Path) -> None:
    """They cost 46 CPU-s: every topic that was examined went through all others."""
    scans = [laser(k, topic=f"/scan{k}", angle_max=3.0) for k in range(30_000)]
    path = write_mcap(tmp_path / "a.mcap", scans, chunk_size=1 << 20)
    document, error = info_document(path, None)
    assert error is None
    assert (len(document["scan_topics"]), len(document["topics"])) == (100, 30_000)


@pytest.mark.parametrize("kind", ["reset", "one wrong pose"])
def test_odometry_goes_on_after_a_reset(kind: str, tmp_path: Path) -> None:
    def x_m(k: int) -> float:
        wrong = k > 20 if kind == "reset" else k == 21
        return 0.3 * k - 6.0 * wrong

    odometry = [
        Message("/odom", ODOM, START_NS + k * PERIOD_NS, {"x": x_m(k), "y": 0.0, "yaw": 0.0}) for k in range(40)
    ]
    log = open_log(write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(40)] + odometry))
    assert log.odometry is not None
    kept = np.delete(np.arange(40), 21) if kind == "one wrong pose" else np.arange(40)
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw[:, 0], 0.3 * kept, atol=1e-9)
    what = "1 jump" if kind == "reset" else "1 pose"
    assert any(f"/odom: the odometry jumps, as after a reset or with two publishers ({what}, the first 2.1 s" in text
               for text in log.warnings)  # fmt: skip


@pytest.mark.parametrize("step_m", [1e6, 1e290])
def test_odometry_that_jumps_far_goes_on(step_m: float, tmp_path: Path) -> None:
    odometry = [
        Message("/odom", ODOM, START_NS + k * PERIOD_NS, {"x": 0.1 * k + step_m * (k > 10), "y": 0.0, "yaw": 0.0})
        for k in range(20)
    ]
    log = open_log(write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(20)] + odometry))
    assert log.odometry is not None
    if step_m == 1e6:
        assert any("/odom: the odometry jumps" in w and "1 jump, the first 1.1 s" in w for w in log.warnings)
        np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw[:, 0], 0.1 * np.arange(20), atol=1e-6)
    else:
        assert len(log.odometry.odom_T_base) == 11  # what is beyond the earth is dropped


def test_a_mounting_beyond_the_earth_is_not_used(tmp_path: Path) -> None:
    mounting = Message(
        "/tf_static", TF, START_NS, {"parent": "base_link", "child": "laser", "x": 1e300, "y": 0, "yaw": 0}
    )
    log = open_log(write_mcap(tmp_path / "a.mcap", [mounting, *drive(5)[1:]]))
    assert log.base_T_laser is None


@pytest.mark.parametrize("suffix", [".mcap", ".bag", ".db3"])
def test_a_file_of_holes_is_refused_at_once(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(write_mcap(tmp_path / "b.mcap", [laser(k) for k in range(5)]).read_bytes())
    with path.open("r+b") as file:
        file.truncate(20 << 30)
    if path.stat().st_blocks * 512 > 1 << 30:
        pytest.skip("this file system keeps no holes")
    with at_most_calls(5_000):
        with pytest.raises(NoScansError, match="of the file are holes"):
            survey(path)
        with pytest.raises(NoScansError, match="of the file are holes"):
            convert_log(path, tmp_path / "c.mcap")


def test_many_tiny_records_are_passed_in_one_pass(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(5)])
    data = path.read_bytes()
    end = data.rindex(b"\x0f" + (4).to_bytes(8, "little"))
    path.write_bytes(data[:end] + (b"\x90" + bytes(8)) * 10_000 + data[end:])
    with at_most_calls(2_000_000):
        assert survey(path).scans["/scan"].total == 5


def with_chunks(log: bytes, content: bytes, count: int) -> bytes:
    """Return an MCAP file with some chunks of a content before its others."""
    packed = zstandard.compress(content)
    body = struct.pack("<QQQII", 0, 9, len(content), zlib.crc32(content), 4) + b"zstd"
    chunk = HEAD.pack(Op.CHUNK, len(body) + 8 + len(packed)) + body + struct.pack("<Q", len(packed)) + packed
    return log[:8] + chunk * count + log[8:]


def test_blank_pictures_compress_ten_thousandfold_and_are_no_damage(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(5)])
    picture = HEAD.pack(Op.ATTACHMENT, 6 << 20) + bytes(6 << 20)
    path.write_bytes(with_chunks(path.read_bytes(), picture, 9))
    log = open_log(path)
    assert log.counts.usable == 5
    assert not log.damage


@pytest.mark.slow
def test_bombs_cost_no_scan_and_little_work(tmp_path: Path) -> None:
    """A MB of 200 bombs took `info` 31 CPU-s and 0.94 GB: what was left was decompressed again for each."""
    path = write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(5)])
    path.write_bytes(with_chunks(path.read_bytes(), bytes(100 << 20), 60))
    with at_most_calls(15_000_000):
        found = survey(path)
    assert found.scans["/scan"].total == 5
    assert "decompress to more than" in found.damage[-1].what


@pytest.mark.parametrize("record", [b"", HEAD.pack(200, 0), HEAD.pack(Op.CHANNEL, 30) + bytes(30)])
def test_chunks_of_too_many_records_cost_no_other_scan(
    record: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decompress, "_FREE_RECORDS", 30_000)
    path = write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(5)])
    path.write_bytes(with_chunks(path.read_bytes(), record * 40_000 or bytes(1 << 20), 8))
    log = open_log(path)
    assert log.counts.usable == 5
    assert "more records" in log.damage[0].what


def test_chunks_of_too_many_headers_cost_no_other_scan_of_a_bag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decompress, "_FREE_RECORDS", 30_000)
    path = write_bag1(tmp_path / "a.bag", [laser(k) for k in range(5)])
    bag, field = path.read_bytes(), b"\x04\0\0\0op=\x09"
    record = struct.pack("<I", len(field)) + field + bytes(4)
    packed = bz2.compress(record * 9000)
    fields = (b"op=\x05", b"compression=bz2", b"size=" + struct.pack("<I", 9000 * len(record)))
    header = b"".join(struct.pack("<I", len(one)) + one for one in fields)
    chunk = struct.pack("<I", len(header)) + header + struct.pack("<I", len(packed)) + packed
    path.write_bytes(bag[:13] + chunk * 9 + bag[13:])
    log = open_log(path)
    assert log.counts.usable == 5
    assert any("no record" in damage.what for damage in log.damage)


def test_serialized_scans_are_those_that_are_read(tmp_path: Path) -> None:
    """The writer here and the reader agree, so that refusals above are none of a broken writer."""
    assert serialized(laser(1), 2)[:4] == b"\0\1\0\0"
    log = open_log(write_mcap(tmp_path / "a.mcap", drive(5)))
    assert log.odometry is not None
    with pytest.raises(NoScansError, match="1 empty"):  # the descriptor is right, and the message has no ranges
        open_log(write_protobuf(tmp_path / "b.mcap", {}))
