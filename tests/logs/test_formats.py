"""The same scans come out of every container, compression and encoding."""

from __future__ import annotations

import shutil
import struct
import tracemalloc
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mavnav.logs import open_log, survey
from mavnav.logs.formats.rosbag1 import _parse_fields
from mavnav.pose import Pose
from support import log_files
from support.log_files import (
    START_NS,
    WRITERS,
    Message,
    drive,
    foxglove_json,
    foxglove_protobuf,
    laser,
    serialized,
    write_bag2,
    write_mcap,
)
from support.marks import slow

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_back_what_was_written(name: str, tmp_path: Path) -> None:
    messages = drive()
    told, write = WRITERS[name]
    log = open_log(write(tmp_path / "a", messages))
    assert (log.format, log.topic, log.frame_id) == (told, "/scan", "laser")
    assert (log.counts.total, log.counts.usable, log.damage, log.warnings) == (25, 25, (), ())
    written = [m for m in messages if m.topic == "/scan"]
    for scan, message in zip(log.scans(), written, strict=True):
        ranges = message.fields["ranges"].astype(np.float64)
        np.testing.assert_array_equal(scan.ranges_m, np.where(ranges == 0.0, np.nan, ranges))
        assert scan.stamp_ns == message.stamp_ns
        assert scan.spec == log.sensor
    assert log.sensor.beams == 16
    assert log.sensor.angle_min_rad == -1.0
    assert log.sensor.angle_step_rad == np.float32(2.0 / 16)
    assert log.cleaning == {"valid": 25 * 15, "zero": 25} | dict.fromkeys(
        ("below_min", "above_max", "nan", "plus_inf", "minus_inf", "negative"), 0
    )
    assert log.odometry is not None
    assert (log.odometry.topic, log.mounting_source, log.base_frame) == ("/odom", "tf_static", "base_link")
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw[:, 0], 0.1 * np.arange(25))
    np.testing.assert_allclose(log.odometry.odom_T_laser.xyyaw[3], (0.5, 0.1, 0.5))


def test_scans_can_be_read_twice_and_share_their_geometry(tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", drive()))
    first, second = list(log.scans()), list(log.scans())
    assert [s.ranges_m.tobytes() for s in first] == [s.ranges_m.tobytes() for s in second]
    assert len({id(s.spec) for s in first}) == 1


def test_split_bag_is_read_in_the_order_of_the_metadata(tmp_path: Path) -> None:
    bag = write_bag2(tmp_path / "bag", [laser(k) for k in range(5)])
    second = write_bag2(tmp_path / "other", [laser(k) for k in range(5, 9)])
    shutil.copy(next(second.glob("*.db3")), bag / "a_second.db3")  # sorts before bag.db3
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("  - bag.db3\n", "  - bag.db3\n  - a_second.db3\n"))
    log = open_log(bag)
    assert [s.stamp_ns for s in log.scans()] == [laser(k).stamp_ns for k in range(9)]
    assert not log.damage


def test_folder_without_metadata_is_read_by_the_numbers_in_the_names(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    for k in (1, 2, 10):
        write_mcap(folder / f"bag_{k}.mcap", [laser(k)])
    log = open_log(folder)
    assert [s.stamp_ns for s in log.scans()] == [laser(k).stamp_ns for k in (1, 2, 10)]
    assert any("no metadata.yaml" in w for w in log.warnings)


def test_old_metadata_lists_names_with_the_folder_before_them(tmp_path: Path) -> None:
    bag = write_bag2(tmp_path / "bag", [laser(k) for k in range(5)])
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("  - bag.db3\n", "  - bag/bag.db3\n"))
    log = open_log(bag)
    assert (log.counts.usable, log.damage) == (5, ())


def test_missing_listed_file_is_damage_and_unlisted_one_a_warning(tmp_path: Path) -> None:
    bag = write_bag2(tmp_path / "bag", [laser(k) for k in range(5)])
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("  - bag.db3\n", "  - bag.db3\n  - gone.db3\n"))
    write_mcap(bag / "extra.mcap", [laser(7)])
    log = open_log(bag)
    assert log.counts.usable == 5
    assert ["gone.db3" in d.what for d in log.damage] == [True]
    assert any("extra.mcap" in w for w in log.warnings)


def test_rows_in_a_write_ahead_log_are_read_and_the_input_is_left_alone(tmp_path: Path) -> None:
    import sqlite3

    source = next(write_bag2(tmp_path / "bag", [laser(k) for k in range(6)]).glob("*.db3"))
    live = sqlite3.connect(source)
    live.execute("PRAGMA journal_mode=WAL")
    row = live.execute("SELECT topic_id, data FROM messages LIMIT 1").fetchone()
    live.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, 1, ?)", row)
    live.commit()
    try:
        before = {p.name: p.read_bytes() for p in source.parent.iterdir()}
        log = open_log(source)
        assert {p.name: p.read_bytes() for p in source.parent.iterdir()} == before
    finally:
        live.close()
    assert log.counts.total == 7
    assert log.counts.skipped == {"duplicate_stamp": 1}


SCANS = [
    {
        "timestamp": {"sec": START_NS // 10**9, "nsec": 100 * k},
        "frame_id": "laser",
        "start_angle": 1.0,
        "end_angle": -1.0,
        "ranges": [1.0 + k, 0.0, 3.0, 4.0, 90.0],
    }
    for k in range(3)
]


@pytest.mark.parametrize("write", [foxglove_json, foxglove_protobuf])
def test_foxglove_scans_end_at_their_last_beam_and_have_no_limits(write, tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "a", SCANS))
    assert (log.counts.usable, log.warnings, log.damage) == (3, (), ())
    assert (log.sensor.angle_min_rad, log.sensor.angle_step_rad, log.sensor.beams) == (1.0, -0.5, 5)
    assert (log.sensor.range_min_m, log.sensor.range_max_m) == (0.0, np.inf)
    scans = list(log.scans())
    np.testing.assert_array_equal(scans[2].ranges_m, [3.0, np.nan, 3.0, 4.0, 90.0])
    assert scans[2].stamp_ns == START_NS // 10**9 * 10**9 + 200


def test_json_spells_what_it_lacks_as_null_or_text(tmp_path: Path) -> None:
    odd = SCANS[0] | {"ranges": [1.0, None, "NaN", "Infinity", "-Infinity"]}
    log = open_log(foxglove_json(tmp_path / "a", [odd]))
    kinds = {kind: n for kind, n in log.cleaning.items() if n}
    assert kinds == {"valid": 1, "nan": 2, "plus_inf": 1, "minus_inf": 1}


def test_broken_json_message_is_told_and_the_others_are_used(tmp_path: Path) -> None:
    log = open_log(foxglove_json(tmp_path / "a", [SCANS[0], {"ranges": 5}, SCANS[1]]))
    assert (log.counts.usable, log.counts.skipped) == (2, {"undecodable": 1})
    assert "does not decode" in log.damage[0].what


@pytest.mark.parametrize("name", ["mcap-zstd", *(slow(n) for n in ("bag1", "db3"))])
def test_memory_does_not_grow_with_the_file(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("log", "topic_scans"):  # shorter logs are kept
        monkeypatch.setattr(f"mavnav.logs.{module}.KEPT_BYTES", 0)

    def peak_bytes(scans: int) -> int:
        path = WRITERS[name][1](tmp_path / f"{scans}", [laser(k, beams=500) for k in range(scans)])
        tracemalloc.start()
        try:
            log = open_log(path)
            assert sum(1 for _ in log.scans()) == scans
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    open_log(write_mcap(tmp_path / "warm", drive()))  # imports and caches
    open_log(WRITERS["bag1"][1](tmp_path / "warm1", drive()))
    small, large = peak_bytes(100), peak_bytes(400)  # 0.2 and 0.8 MB of ranges
    assert large < small + 300_000


def test_extrinsic_takes_the_place_of_the_transforms(tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", drive()), extrinsic=Pose(1.0, 0.0, 0.0))
    assert (log.base_T_laser, log.mounting_source) == (Pose(1.0, 0.0, 0.0), "option")
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.odom_T_laser.xyyaw[0], (1.0, 0.0, 0.0))


def test_a_file_that_metadata_lists_a_thousand_times_is_read_once(tmp_path: Path) -> None:
    folder = write_bag2(tmp_path / "bag", [laser(k) for k in range(3)])
    (name,) = (file.name for file in folder.glob("*.db3"))
    names = ", ".join([name, f"./{name}"] * 500)
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {{relative_file_paths: [{names}]}}")
    found = survey(folder)
    assert found.scans["/scan"].total == 3
    assert any("more than once" in w for w in found.warnings)


def test_a_name_that_no_file_can_have_is_told(tmp_path: Path) -> None:
    folder = write_bag2(tmp_path / "bag", [laser(k) for k in range(3)])
    for name in ("x" * 5000, "a\\0b"):
        (folder / "metadata.yaml").write_text(f'rosbag2_bagfile_information: {{relative_file_paths: ["{name}"]}}')
        found = survey(folder)
        assert found.scans["/scan"].total == 3
        assert any("cannot be a file's name" in d.what for d in found.damage)


def test_a_listed_link_to_itself_is_missing(tmp_path: Path) -> None:
    folder = write_bag2(tmp_path / "bag", [laser(k) for k in range(3)])
    (folder / "loop.db3").symlink_to("loop.db3")
    (folder / "metadata.yaml").write_text('rosbag2_bagfile_information: {relative_file_paths: ["loop.db3"]}')
    assert [d.what for d in survey(folder).damage] == ["listed file 'loop.db3' is missing"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "it is empty"),
        ("a: b", "it is not that of a bag"),
        ("[a]", "it is not that of a bag"),
        ("rosbag2_bagfile_information:", "it is not that of a bag"),
        ("rosbag2_bagfile_information: {version: 5}", "relative_file_paths is no list of names"),
    ],
)
def test_metadata_without_what_it_needs_says_so(tmp_path: Path, text: str, why: str) -> None:
    folder = write_bag2(tmp_path / "bag", [laser(k) for k in range(3)])
    (folder / "metadata.yaml").write_text(text)
    report = survey(folder)
    assert report.scans["/scan"].total == 3
    assert [d.what for d in report.damage] == [f"content cannot be read ({why}); the storage files found were read"]


def test_damage_of_metadata_names_its_file_once(tmp_path: Path) -> None:
    folder = write_bag2(tmp_path / "bag", [laser(k) for k in range(3)])
    (name,) = (file.name for file in folder.glob("*.db3"))
    listed = 'rosbag2_bagfile_information: {relative_file_paths: ["%s"], message_count: 100}'
    for text in (listed % name, listed % "none.db3", listed % "../out.db3", listed % "a\\0b", "rosbag2: ["):
        (folder / "metadata.yaml").write_text(text)
        damage = [d for d in survey(folder).damage if d.where == "metadata.yaml"]
        assert damage and not any("metadata.yaml" in d.what for d in damage)
    (folder / "metadata.yaml").write_text(listed % name)
    assert [d.what for d in survey(folder).damage] == ["3 of the 100 listed messages were read"]


STRINGS = {b"laser": "laser", b"": "", b"l\xff\0": "l\N{REPLACEMENT CHARACTER}", b"laser\0": "laser"}


@pytest.mark.parametrize("frame", STRINGS)
@pytest.mark.parametrize("head", [b"\0\1\0\0", b"\0\7\0\0", b"\0\x09\0\0\0\0\0\0"])
def test_strings_and_encapsulations_that_no_library_takes_cost_no_scan(
    frame: bytes, head: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def odd(message: Message, _ros: int) -> bytes:
        whole = serialized(message, 2)
        text = struct.pack("<I", len(frame)) + frame
        return head + whole[4:12] + text + bytes(-len(text) % 4) + whole[24:]

    scans = [laser(k) for k in range(3)]
    monkeypatch.setattr(log_files, "serialized", odd)
    log = open_log(log_files.write_mcap(tmp_path / "a.mcap", scans))
    monkeypatch.undo()
    assert (log.counts.usable, log.frame_id, log.damage) == (3, STRINGS[frame], ())
    sound = open_log(log_files.write_mcap(tmp_path / "b.mcap", scans))
    assert [(s.stamp_ns, s.ranges_m.tobytes()) for s in log.scans()] == [
        (s.stamp_ns, s.ranges_m.tobytes()) for s in sound.scans()
    ]


def test_headers_of_a_bag_are_split_alike_by_the_quick_and_the_full_reading() -> None:
    values = {b"op": b"\x02", b"conn": b"\n\0=\0", b"time": b"12345\n\0\x0d"}
    for names in product(values, repeat=3):  # in any order, and twice
        fields = [name + b"=" + values[name] for name in names]
        header = b"".join(struct.pack("<I", len(each)) + each for each in fields)
        assert _parse_fields(header) == {name: values[name] for name in names}
        assert _parse_fields(header + b"\0") is None
        another = _parse_fields(header + b"\x02\0\0\0x=")
        assert another is not None and another.pop(b"x") == b"" and another == _parse_fields(header)
