"""Damaged MCAP files: every sound chunk counts, no damage passes unmarked, no name is made up."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap.opcode import Opcode as Op

from mavnav.errors import NoScansError
from mavnav.logs import Log, open_log, survey
from mavnav.logs.formats.mcap_records import HEAD, MAGIC, chunk_head, plain_records
from support.effort import at_most_calls
from support.log_files import START_NS, WRITERS, foxglove_json, foxglove_protobuf, laser, serialized, write_mcap

if TYPE_CHECKING:
    from pathlib import Path

SCANS = 60


def heads(data: bytes, *opcodes: int) -> list[int]:
    """Return the offsets of the records of some kinds."""
    offset, found = len(MAGIC), []
    for opcode, content in plain_records(data[len(MAGIC) :]):
        found += [offset] if opcode in opcodes else []
        offset += HEAD.size + len(content)
    return found


def by_stamp(log: Log) -> dict[int, bytes]:
    return {scan.stamp_ns: scan.ranges_m.tobytes() for scan in log.scans()}


def foxglove_scan(k: int) -> dict[str, Any]:
    ranges = np.random.default_rng(k).uniform(0.5, 9.0, 64).tolist()
    stamp = {"sec": START_NS // 10**9 + k, "nsec": 5}
    return {"timestamp": stamp, "frame_id": "laser", "start_angle": -1.0, "end_angle": 1.0, "ranges": ranges}


@pytest.mark.parametrize("write", [foxglove_json, foxglove_protobuf])
@pytest.mark.parametrize("bytes_more", [-1, 1, -300])
def test_a_byte_lost_in_the_chunk_that_declares_the_channel_loses_no_other(
    write: Any, bytes_more: int, tmp_path: Path
) -> None:
    """The footer's offset of the summary is wrong by as much; only there is the channel declared besides."""
    path = write(tmp_path / "a.mcap", [foxglove_scan(k) for k in range(SCANS)], chunk_size=6000)
    sound, data = by_stamp(open_log(path)), path.read_bytes()
    first, second = heads(data, Op.CHUNK)[:2]
    at = first + 400
    path.write_bytes(data[:at] + data[at + max(-bytes_more, 0) :] if bytes_more < 0 else data[:at] + b"x" + data[at:])
    log = open_log(path, strict=True)
    assert log.topic == "/scan"
    kept = by_stamp(log)
    assert kept.items() <= sound.items()
    assert len(kept) >= SCANS - len(sound) * (second - first) // (len(data) // 2)
    assert log.damage


@pytest.mark.parametrize("name", ["mcap-none", "mcap-lz4", "mcap-zstd", "mcap-ros1"])
@pytest.mark.parametrize("lost", [1, 7, 500])
def test_a_chunk_that_lost_bytes_costs_itself_alone(name: str, lost: int, tmp_path: Path) -> None:
    path = WRITERS[name][1](tmp_path / "a.mcap", [laser(k, beams=64) for k in range(SCANS)])
    sound, data = by_stamp(open_log(path)), path.read_bytes()
    chunks = heads(data, Op.CHUNK)
    for chunk in (0, 4):
        at = chunks[chunk] + 700
        path.write_bytes(data[:at] + data[at + lost :])
        log = open_log(path, strict=True)
        assert log.topic == "/scan"
        assert by_stamp(log).items() <= sound.items()
        assert SCANS - 8 <= log.counts.usable < SCANS
        assert not any("channel" in d.what for d in log.damage)


@pytest.mark.parametrize("opcode", [2, 4, 7, 14, 38, 70, 0x86])
@pytest.mark.parametrize("name", ["mcap-lz4", "mcap-zstd"])
def test_a_chunk_under_another_kind_is_read(opcode: int, name: str, tmp_path: Path) -> None:
    path = WRITERS[name][1](tmp_path / "a.mcap", [laser(k) for k in range(SCANS)])
    data = bytearray(path.read_bytes())
    data[heads(data, Op.CHUNK)[1]] = opcode
    path.write_bytes(data)
    log = open_log(path, strict=True)
    assert log.counts.usable == SCANS
    assert any("kind" in d.what for d in log.damage)


def test_a_chunk_that_is_a_byte_short_does_not_make_the_next_a_private_record(tmp_path: Path) -> None:
    """A byte late, a record's length reads as its kind: any is legal from 128 on."""
    path = write_mcap(tmp_path / "a.mcap", [laser(k, beams=64) for k in range(SCANS)])
    data = path.read_bytes()
    chunks, lengths = heads(data, Op.CHUNK), []
    for at in chunks[:-1]:
        path.write_bytes(data[: at + 900] + data[at + 901 :])
        lengths.append(open_log(path, strict=True).counts.usable)
    assert min(lengths) >= SCANS - 8


def test_a_length_that_reaches_into_the_next_chunk_hides_no_flipped_bit(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k, beams=64) for k in range(SCANS)], compression="NONE")
    sound, data = by_stamp(open_log(path)), bytearray(path.read_bytes())
    first, second = heads(data, Op.CHUNK)[1:3]
    head = chunk_head(bytes(data[second + HEAD.size :]))
    records = second + HEAD.size + head.start
    (message_bytes,) = struct.unpack_from("<Q", data, records + 1)
    reach = records + HEAD.size + message_bytes - first - HEAD.size  # up to the second chunk's second message
    data[first + 1 : first + 9] = reach.to_bytes(8, "little")
    data[records + 2 * (HEAD.size + message_bytes) - 20] ^= 1  # in the ranges of that message
    path.write_bytes(data)
    log, strict = open_log(path), open_log(path, strict=True)
    altered = dict(by_stamp(log).items() - sound.items())
    assert len(altered) == 1
    assert log.counts.suspect >= 1
    assert log.damage
    assert by_stamp(strict).items() <= sound.items()
    assert len(by_stamp(strict)) >= SCANS - 8


def unchunked_records(path: Path, *numbers: int) -> bytes:
    """Return message records as they stand outside of chunks, on channel 1."""
    contents = [struct.pack("<HIQQ", 1, k, START_NS, START_NS) + serialized(laser(k, beams=64), 2) for k in numbers]
    return b"".join(HEAD.pack(Op.MESSAGE, len(content)) + content for content in contents)


@pytest.mark.parametrize("guarded", [False, True])
def test_messages_outside_of_chunks_are_suspect_unless_a_crc_covers_them(guarded: bool, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k, beams=64) for k in range(SCANS)])
    data = path.read_bytes()
    end = data.rindex(HEAD.pack(Op.DATA_END, 4))
    mixed = data[:end] + unchunked_records(path, SCANS, SCANS + 1)
    crc = zlib.crc32(mixed) if guarded else 0
    path.write_bytes(mixed + HEAD.pack(Op.DATA_END, 4) + crc.to_bytes(4, "little") + data[end + 13 :])
    log = open_log(path)
    assert (log.counts.usable, log.counts.suspect) == (SCANS + 2, 0 if guarded else 2)
    assert any("outside of the chunks" in d.what for d in log.damage) != guarded
    assert open_log(path, strict=True).counts.usable == SCANS + 2 * guarded


def test_a_chunk_within_a_chunk_is_reported(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(20)], compression="NONE", chunk_size=1 << 20)
    data = path.read_bytes()
    (at,) = heads(data, Op.CHUNK)
    (length,) = struct.unpack_from("<Q", data, at + 1)
    inner = data[at : at + HEAD.size + length]
    content = (
        struct.pack("<QQQI", 0, 0, len(inner), zlib.crc32(inner)) + bytes(4) + struct.pack("<Q", len(inner)) + inner
    )
    nested = HEAD.pack(Op.CHUNK, len(content)) + content
    path.write_bytes(data[:at] + nested + data[at + HEAD.size + length :])
    found = survey(path)
    assert any("a chunk lies within a chunk" in d.what for d in found.damage)
    with pytest.raises(NoScansError):
        open_log(path)


def test_no_sound_scan_makes_way_for_a_suspect_one_of_its_stamp(tmp_path: Path) -> None:
    """A copy of the file whose chunks are damaged stands before the sound one."""
    path = write_mcap(tmp_path / "a.mcap", [laser(k, beams=64) for k in range(SCANS)], compression="NONE")
    sound, data = by_stamp(open_log(path)), path.read_bytes()
    damaged = bytearray(data)
    for at in heads(data, Op.CHUNK):
        damaged[at + 900] ^= 1
    path.write_bytes(bytes(damaged) + data)
    log = open_log(path)
    assert log.counts.suspect == 0
    assert by_stamp(log) == sound
    assert log.counts.skipped == {"duplicate_stamp": SCANS}


@pytest.mark.slow
def test_losses_without_number_are_passed_in_one_pass(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(5)], use_chunking=False)
    data = path.read_bytes()
    at, end = heads(data, Op.MESSAGE)[0], heads(data, Op.DATA_END)[0]
    path.write_bytes(data[:at] + (data[at:end] + b"\0" * 5) * 800 + data[end:])
    with at_most_calls(2_500_000):
        assert survey(path).damage


@pytest.mark.slow
def test_chunks_that_all_claim_the_same_bytes_are_read_once(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(5)])
    size = 20_000_000
    count = size // 60
    head = b"".join(
        HEAD.pack(Op.CHUNK, size - 60 * k - 9)
        + struct.pack("<QQQI", 0, 0, size, 1) + bytes(4) + struct.pack("<Q", size - 60 * k - 49) + bytes(11)
        for k in range(count)
    )  # fmt: skip
    path.write_bytes(path.read_bytes()[:60] + head)
    with at_most_calls(2_000_000):
        assert survey(path).damage
