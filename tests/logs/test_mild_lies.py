"""Numbers and names of a log that are wrong, but not needed: every scan comes out, and a warning names each."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from mcap.writer import Writer

from mavnav.logs import Log, open_log
from mavnav.logs.messages.definitions import MD5, TF_ROS1
from support.log_files import (
    LASER,
    PERIOD_NS,
    START_NS,
    drive,
    laser,
    serialized,
    store,
    write_bag1,
    write_bag2,
    write_mcap,
)

SCANS = 12


def bag1(path: Path, old: bytes, new: bytes) -> Log:
    """Return a bag of ROS 1 in which bytes are replaced."""
    content = write_bag1(path, drive(SCANS)).read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new))
    return open_log(path)


def mcap_of(path: Path, *, topic: str = "/scan", encoding: str = "ros2msg") -> Path:
    """Return an MCAP without chunks, so that its bytes can be changed."""
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, enable_crcs=False, use_summary_offsets=False)
        writer.start()
        schema = writer.register_schema(LASER, encoding, b"" if encoding == "ros2msg" else b"x")
        channel = writer.register_channel(topic, "cdr", schema)
        for k in range(SCANS):
            stamp_ns = START_NS + k * PERIOD_NS
            writer.add_message(channel, stamp_ns, serialized(laser(k), 2), stamp_ns)
        writer.finish()
    return path


def warned(log: Log, part: str) -> None:
    """Check that every scan came out, without damage, and that one warning says so."""
    assert (len(log), log.damage) == (SCANS, ())
    assert len([text for text in log.warnings if part in text]) == 1, log.warnings


def test_a_bad_md5_sum_is_named(tmp_path: Path) -> None:
    warned(bag1(tmp_path / "a.bag", MD5[LASER].encode(), b"0" * 32), "the md5 sum of sensor_msgs/LaserScan is '0000")


def test_the_md5_sums_are_those_of_the_definitions() -> None:
    for name, md5 in MD5.items():
        if name != TF_ROS1:
            assert store(1).generate_msgdef(name)[1] == md5


@pytest.mark.parametrize("kind", ["chunk info", "index"])
def test_a_version_of_a_bag_that_is_none_is_named(kind: str, tmp_path: Path) -> None:
    old = b"\x08\x00\x00\x00ver=\x01\x00\x00\x00"
    warned(bag1(tmp_path / "a.bag", old, old[:8] + b"\x63\x00\x00\x00"), f"a record ({kind}) has the version 99, not 1")


def test_a_size_of_a_chunk_that_is_wrong_is_named(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "a.bag", drive(SCANS))
    content = path.read_bytes()
    at = content.index(b"size=", content.index(b"compression=none")) if b"size=" in content else -1
    path.write_bytes(content[: at + 5] + struct.pack("<I", 7) + content[at + 9 :])
    warned(open_log(path), "a chunk declares 7 bytes and has ")


def test_a_topic_that_is_not_utf_8_is_named(tmp_path: Path) -> None:
    path = mcap_of(tmp_path / "a.mcap", topic="/scan")
    path.write_bytes(path.read_bytes().replace(b"/scan", b"/sc\xffn"))
    warned(open_log(path), "the name of topic '/sc\ufffdn' is not UTF-8")


def test_an_unknown_encoding_of_a_schema_is_named(tmp_path: Path) -> None:
    warned(open_log(mcap_of(tmp_path / "a.mcap", encoding="ros9msg")), "has the unknown encoding 'ros9msg'")


def test_a_schema_with_the_number_of_none_is_named(tmp_path: Path) -> None:
    path = mcap_of(tmp_path / "a.mcap")
    content = path.read_bytes()
    name = struct.pack("<I", len(LASER)) + LASER.encode()
    content = content.replace(b"\x01\x00" + name, b"\x00\x00" + name)
    channel = struct.pack("<HH", 1, 1) + struct.pack("<I", 5) + b"/scan"
    path.write_bytes(content.replace(channel, struct.pack("<HH", 1, 0) + channel[4:]))
    warned(open_log(path), f"the schema of {LASER!r} has the number 0")


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("storage_identifier: sqlite3", "storage_identifier: mcap", "names the storage 'mcap'; the files are sqlite3"),
        ("version: 9", "version: 77", "metadata.yaml is of version '77'"),
    ],
)
def test_metadata_of_a_bag_that_is_wrong_is_named(old: str, new: str, part: str, tmp_path: Path) -> None:
    folder = write_bag2(tmp_path / "bag", drive(SCANS))
    file = folder / "metadata.yaml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    log = open_log(folder)
    assert (len(log), log.damage) == (SCANS, ())
    assert any(part in warning for warning in log.warnings), log.warnings


def test_sound_logs_are_not_warned_of(tmp_path: Path) -> None:
    for name, write in (("a", write_bag1), ("b", write_bag2), ("c", write_mcap)):
        path = write(tmp_path / name, drive(SCANS))
        log = open_log(path)
        assert (len(log), log.damage, log.warnings) == (SCANS, (), ())
