"""Damaged logs, made byte by byte: what is intact comes out, what is lost is told, and nothing ever crashes."""

from __future__ import annotations

import re
import struct
import zlib
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mavnav.errors import NoScansError
from mavnav.logs import Log, open_log, survey
from mavnav.logs.formats.decompress import DecompressError, decompress
from mavnav.logs.messages.decode import DECODERS, OTHER_TYPES, SINGLE_POSES
from mavnav.logs.read_report import KNOWN_ENCODINGS, KNOWN_TYPES, MAX_DAMAGE, ReadReport
from mavnav.logs.records import Channel
from support.effort import at_most_calls
from support.log_files import PERIOD_NS, START_NS, WRITERS, drive, laser, serialized, write_bag1, write_bag2, write_mcap

if TYPE_CHECKING:
    from pathlib import Path

FILES = [name for name in WRITERS if not name.startswith("bag2")]
CHECKED = {"mcap-none", "mcap-lz4", "mcap-zstd", "bag1-bz2"}
"""Formats whose chunks carry a checksum, so that no altered scan passes."""


def opened(path: Path) -> Log | None:
    try:
        return open_log(path)
    except NoScansError:
        return None


def ranges_by_stamp(log: Log) -> dict[int, bytes]:
    return {s.stamp_ns: s.ranges_m.tobytes() for s in log.scans()}


@pytest.mark.parametrize("name", FILES)
def test_cut_anywhere_gives_the_scans_before_the_cut(name: str, tmp_path: Path) -> None:
    whole = WRITERS[name][1](tmp_path / "whole", [laser(k) for k in range(60)])
    data, cut = whole.read_bytes(), tmp_path / "cut"
    sound = ranges_by_stamp(open_log(whole))
    usable = []
    for size in np.linspace(0, len(data) - 1, 12, dtype=int):
        cut.write_bytes(data[:size])
        log = opened(cut)
        usable.append(log.counts.usable if log else 0)
        if log is None:
            continue
        assert log.damage or log.counts.usable == len(sound)
        scans = ranges_by_stamp(log)
        assert len(scans) == log.counts.usable
        assert scans.items() <= sound.items()
    assert usable == sorted(usable)
    assert usable[-1] >= 0.6 * len(sound)


def test_bag_cut_between_two_records_is_told(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "a", [laser(k) for k in range(40)])
    data = path.read_bytes()
    second_chunk = data.index(b"compression=", data.index(b"compression=") + 1) - 8
    path.write_bytes(data[:second_chunk])
    log = open_log(path)
    assert 0 < log.counts.usable < 40
    assert any("ends before its index" in d.what for d in log.damage)


@pytest.mark.parametrize("name", FILES)
def test_flipped_bits_never_crash_and_pass_no_checksum(name: str, tmp_path: Path) -> None:
    whole = WRITERS[name][1](tmp_path / "whole", [laser(k) for k in range(30)])
    data, flipped = whole.read_bytes(), tmp_path / "flipped"
    sound = ranges_by_stamp(open_log(whole))
    rng = np.random.default_rng(7)
    for _ in range(10):
        damaged = bytearray(data)
        for at in rng.integers(0, len(data), 2):
            damaged[at] ^= 1 << int(rng.integers(8))
        flipped.write_bytes(damaged)
        log = opened(flipped)
        if log is not None:
            scans = ranges_by_stamp(log)
            assert len(scans) == log.counts.usable
            altered = len(scans.items() - sound.items())
            if name in CHECKED and log.stamp_source == "header":
                assert altered <= log.counts.suspect
                assert log.damage or not altered


@pytest.mark.parametrize("name", ["mcap-zstd", "bag1", "bag1-bz2", "db3"])
def test_rubbish_behind_the_magic_is_no_log(name: str, tmp_path: Path) -> None:
    magic = WRITERS[name][1](tmp_path / "whole", drive(1)).read_bytes()[:16]
    for seed in range(5):
        path = tmp_path / "rubbish"
        path.write_bytes(magic + np.random.default_rng(seed).bytes(5000))
        with pytest.raises(NoScansError):
            open_log(path)


def test_crc_of_the_data_section_is_checked(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "a", [laser(k) for k in range(5)], use_chunking=False, enable_data_crcs=True
    )  # no chunk, so no other checksum
    data = bytearray(path.read_bytes())
    at = data.rindex(laser(3).fields["ranges"].tobytes()) + 2
    data[at] ^= 1
    path.write_bytes(data)
    log = open_log(path)
    assert (log.counts.usable, log.counts.suspect) == (5, 5)
    assert ["CRC of the data section" in d.what for d in log.damage] == [True]
    with pytest.raises(NoScansError, match="5 suspect"):
        open_log(path, strict=True)


def test_crc_of_the_data_section_doubts_chunks_only_that_have_none(tmp_path: Path) -> None:
    scans = [laser(k) for k in range(5)]
    for guarded, suspect in ((True, 0), (False, 5)):
        path = write_mcap(tmp_path / "a", scans, enable_data_crcs=True, enable_crcs=guarded)
        path.write_bytes(path.read_bytes().replace(b"ros2", b"ros3", 1))  # of the profile, that nobody reads
        log = open_log(path)
        assert (log.counts.usable, log.counts.suspect) == (5, suspect)
        assert log.damage


def test_the_end_of_the_data_is_found_behind_a_loss(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k) for k in range(5)], use_chunking=False, enable_data_crcs=True)
    data = path.read_bytes()
    at = data.index(serialized(laser(2), 2))
    path.write_bytes(data[: at + 40] + data[at + 60 :])
    log = open_log(path)
    assert log.counts.suspect == log.counts.usable >= 3


def test_a_small_file_whose_magic_is_broken_does_not_begin_at_its_end(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k) for k in range(5)])
    path.write_bytes(b"\x88" + path.read_bytes()[1:])
    log = open_log(path)
    assert log.counts.usable == 5
    assert log.damage[0].what == "the file does not begin with the magic of MCAP"


def test_chunk_whose_crc_does_not_match_is_suspect_and_left_out_if_strict(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k, beams=400) for k in range(5)], compression="NONE")
    sound = ranges_by_stamp(open_log(path))
    data = bytearray(path.read_bytes())
    data[data.index(laser(2, beams=400).fields["ranges"].tobytes()) + 2] ^= 1
    path.write_bytes(data)
    log, strict = open_log(path), open_log(path, strict=True)
    assert any("CRC does not match" in d.what for d in log.damage)
    assert log.counts.usable == 5
    assert 1 <= log.counts.suspect < 5
    assert [k for k, v in ranges_by_stamp(log).items() if sound[k] != v] == [laser(2).stamp_ns]
    assert strict.counts.skipped == {"suspect": log.counts.suspect}
    assert ranges_by_stamp(strict).items() < sound.items()


def test_bag_that_lost_bytes_drops_the_message_that_spans_the_loss(tmp_path: Path) -> None:
    """A message short of a byte would take one from the next record and decode to shifted values."""
    path = write_bag1(tmp_path / "a", [laser(k) for k in range(40)])
    sound = ranges_by_stamp(open_log(path))
    data = path.read_bytes()
    at = data.index(laser(20).fields["ranges"].tobytes()) + 9
    path.write_bytes(data[:at] + data[at + 1 :])
    log = open_log(path)
    assert log.damage
    assert ranges_by_stamp(log) == {k: v for k, v in sound.items() if k != laser(20).stamp_ns}


def test_bag_chunk_that_holds_more_than_it_declares_is_suspect(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "a", [laser(k) for k in range(40)], "BZ2")
    data = path.read_bytes()
    at = data.index(b"size=") + 5
    (size,) = struct.unpack_from("<I", data, at)
    path.write_bytes(data[:at] + struct.pack("<I", size - 1) + data[at + 4 :])
    log = open_log(path)
    assert log.counts.usable == 40
    assert 0 < log.counts.suspect < 40
    assert any("declares" in d.what for d in log.damage)


def test_message_with_a_cut_array_is_undecodable(tmp_path: Path) -> None:
    import sqlite3

    path = next(write_bag2(tmp_path / "a", [laser(k) for k in range(5)]).glob("*.db3"))
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE messages SET data = substr(data, 1, 60) WHERE rowid = 3")
        connection.execute("UPDATE messages SET data = x'' WHERE rowid = 4")
    connection.close()
    log = open_log(path)
    assert (log.counts.usable, log.counts.skipped) == (3, {"undecodable": 2})
    assert len(log.damage) == 2


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_no_byte_before_a_break_is_lost(compression: str) -> None:
    """A break right behind a block, where a decompressor that is given both returns neither."""
    import lz4.frame
    import zstandard

    blocks = [np.random.default_rng(k).bytes(65536) for k in range(3)]
    if compression == "zstd":
        packer = zstandard.ZstdCompressor(write_content_size=False).compressobj()
        packed = [packer.compress(block) + packer.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK) for block in blocks]
    else:
        writer = lz4.frame.LZ4FrameCompressor(
            block_linked=False, auto_flush=True, block_size=lz4.frame.BLOCKSIZE_MAX64KB
        )
        packed = [writer.begin() + writer.compress(blocks[0]), *map(writer.compress, blocks[1:])]
    broken = packed[0] + packed[1] + b"\xff" * 20 + packed[2]
    part, problem = decompress(compression, broken)
    assert part == blocks[0] + blocks[1]
    assert problem is not None


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_what_comes_before_a_break_is_unpacked_and_bombs_are_refused(compression: str) -> None:
    import bz2

    import lz4.frame
    import zstandard

    small_blocks = partial(bz2.compress, compresslevel=1)
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "bz2": small_blocks}[compression]
    content = np.random.default_rng(1).bytes(400_000)
    packed = pack(content)
    assert decompress(compression, packed) == (content, None)
    part, problem = decompress(compression, packed[: len(packed) // 2])
    assert content.startswith(part)
    assert len(part) > 0.4 * len(content) or compression == "bz2"
    assert decompress(compression, packed + pack(b"more")) == (content + b"more", None)
    assert decompress(compression, packed + b"no frame") == (content, None)
    assert problem is not None or compression == "zstd"  # told by the size and the CRC of the container
    assert decompress(compression, b"rubbish" * 20)[1] is not None
    if compression != "lz4":  # whose ratio is never above 255
        with pytest.raises(DecompressError, match="decompress to more than"):
            decompress(compression, pack(bytes(20_000_000)))


def test_read_report_lists_a_hundred_and_counts_the_rest() -> None:
    report = ReadReport()
    for k in range(MAX_DAMAGE + 50):
        report.damage("broken", f"byte {k}")
    damages = report.damages()
    assert len(damages) == MAX_DAMAGE + 1
    assert damages[-1].what == "broken (50 more)"


def test_messages_missing_from_the_summary_count_are_told(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k) for k in range(5)], use_chunking=False)
    data = path.read_bytes()
    at = data.index(b"\x05" + struct.pack("<Q", len_of_message(data)))
    length = 9 + len_of_message(data)
    path.write_bytes(data[:at] + data[at + length :])
    log = open_log(path)
    assert log.counts.usable == 4
    assert any("1 of the 5 messages" in d.what for d in log.damage)


def len_of_message(data: bytes) -> int:
    """Return the length of the first Message record of an unchunked MCAP file, by walking its records."""
    offset = 8
    while data[offset] != 5:
        offset += 9 + struct.unpack_from("<Q", data, offset + 1)[0]
    return int(struct.unpack_from("<Q", data, offset + 1)[0])


def test_unchunked_crc_covers_what_the_format_says(tmp_path: Path) -> None:
    """The data section runs from the file's first byte to the DataEnd record (MCAP specification)."""
    data = write_mcap(tmp_path / "a", [laser(0)], use_chunking=False, enable_data_crcs=True).read_bytes()
    end = data.index(b"\x0f" + struct.pack("<Q", 4))
    assert zlib.crc32(data[:end]) == struct.unpack_from("<I", data, end + 9)[0]


@pytest.mark.parametrize("name", ["mcap-zstd", "bag1-bz2"])
def test_loss_of_the_chunk_that_declares_the_channels_loses_no_other(name: str, tmp_path: Path) -> None:
    """Summary and index repeat them."""
    path = WRITERS[name][1](tmp_path / "a", [laser(k) for k in range(40)])
    data = bytearray(path.read_bytes())
    at = data.index(b"\x28\xb5\x2f\xfd" if name == "mcap-zstd" else b"BZh")
    data[at : at + 100] = bytes(100)
    path.write_bytes(data)
    log = open_log(path)
    assert 20 < log.counts.usable < 40
    assert any("suspect" in d.what for d in log.damage)


def bag_of_chunks(tmp_path: Path, name: str) -> tuple[Path, bytes, int]:
    """Write a compressed bag of 30 scans; return it, its bytes, and where its second chunk tells its stored length."""
    path = WRITERS[name][1](tmp_path / "a.bag", [laser(k) for k in range(30)])
    data = path.read_bytes()
    second = data.index(b"compression=", data.index(b"compression=") + 1)
    return path, data, data.index(b"size=", second) + 9


@pytest.mark.parametrize("name", ["bag1-bz2", "bag1-lz4"])
@pytest.mark.parametrize("length", [0, 7, 1 << 20, 1 << 31])
def test_bag_chunk_whose_length_lies_costs_no_scan(name: str, length: int, tmp_path: Path) -> None:
    path, data, at = bag_of_chunks(tmp_path, name)
    path.write_bytes(data[:at] + length.to_bytes(4, "little") + data[at + 4 :])
    found = survey(path)
    assert found.scans["/scan"].total == 30
    assert found.damage
    assert not any(d.what.startswith("-") for d in found.damage)


def test_bag_of_nothing_but_op_fields_is_read_once(tmp_path: Path) -> None:
    path = WRITERS["bag1"][1](tmp_path / "a.bag", [laser(k) for k in range(30)])
    path.write_bytes(path.read_bytes()[:8000] + b"\x04\0\0\0op=" * 100_000)
    with at_most_calls(1_000_000):
        assert survey(path).damage


@pytest.mark.parametrize("name", ["mcap-unchunked", "bag1", "db3"])
@pytest.mark.parametrize("at", [0, 8, 20])
def test_a_type_with_a_flipped_bit_is_known_all_the_same(name: str, at: int, tmp_path: Path) -> None:
    path = WRITERS[name][1](tmp_path / "a.log", [laser(k) for k in range(10)])
    sound = re.search(rb"sensor_msgs/(msg/)?LaserScan", path.read_bytes())
    assert sound
    flipped = sound[0][:at] + bytes([sound[0][at] ^ 4]) + sound[0][at + 1 :]
    path.write_bytes(path.read_bytes().replace(sound[0], flipped))
    found = survey(path)
    assert found.scans["/scan"].total == 10
    assert any("is damaged, and taken for" in d.what for d in found.damage)


def test_types_of_others_are_left_alone() -> None:
    report = ReadReport()
    for kind, encoding in [("sensor_msgs/msg/LaserEcho", "cdr"), ("sensor_msgs/msg/LaserScan", "ros2")]:
        channel = Channel("/a", kind, encoding)
        assert report.declare(channel) == channel
    assert report.damages() == ()
    assert {encoding for encoding, _ in DECODERS} <= set(KNOWN_ENCODINGS)
    assert ({kind for _, kind in DECODERS} - SINGLE_POSES) | OTHER_TYPES == set(KNOWN_TYPES)


def test_a_message_that_runs_into_a_hole_of_zeros_is_suspect(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k, beams=300) for k in range(10)], use_chunking=False)
    data = bytearray(path.read_bytes())
    middle = data.index(serialized(laser(5, beams=300), 2)) + 600
    data[middle : middle + 1300] = bytes(1300)
    path.write_bytes(data)
    sound = {START_NS + k * PERIOD_NS for k in range(10)}
    log = open_log(path)
    assert {s.stamp_ns for s in log.scans()} < sound
    assert log.counts.suspect == 1


@pytest.mark.parametrize("name", ["mcap-unchunked", "mcap-zstd", "bag1"])
def test_what_lies_behind_a_hole_in_the_file_is_found(name: str, tmp_path: Path) -> None:
    """A hole takes no space on the disk; it is passed over, not read."""
    path = WRITERS[name][1](tmp_path / "a.log", [laser(k) for k in range(30)])
    data, hole_bytes = path.read_bytes(), 1 << 26
    with path.open("wb") as file:
        file.write(data[: len(data) // 2])
        file.seek(hole_bytes, 1)
        file.write(data[len(data) // 2 :])
    found = survey(path)
    assert 17 <= found.scans["/scan"].total < 31
    assert found.damage


def test_suspect_scans_whose_times_differ_as_those_of_all_scans_do_are_kept(tmp_path: Path) -> None:
    scans = [laser(k, beams=64, scan_time=0.1 + 1e-5 * k) for k in range(40)]
    path = write_mcap(tmp_path / "a.mcap", scans, compression="NONE")
    data = bytearray(path.read_bytes())
    data[data.index(serialized(scans[20], 2)) + 100] ^= 1  # in the ranges
    path.write_bytes(data)
    log = open_log(path)
    assert log.counts.usable == 40
    assert log.counts.suspect > 0


@pytest.mark.parametrize(
    ("name", "suffix"), [("mcap-zstd", ".mcap"), ("bag1", ".bag"), ("bag1-bz2", ".bag"), ("db3", ".db3")]
)
def test_a_log_whose_first_page_is_lost_is_known_by_what_follows(name: str, suffix: str, tmp_path: Path) -> None:
    scans = [laser(k, beams=300) for k in range(40)]
    data = WRITERS[name][1](tmp_path / "source", scans).read_bytes()
    path = tmp_path / f"a{suffix}"
    path.write_bytes(bytes(4096) + data[4096:-200])  # nor does the end tell
    log = open_log(path)
    assert log.counts.usable > 30
    assert log.damage
    told = {k: v for k, v in ranges_by_stamp(log).items() if k not in {s.stamp_ns for s in scans}}
    assert told == {}
