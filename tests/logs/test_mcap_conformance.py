"""MCAP files of every legal combination of parts, written byte by byte from the specification (https://mcap.dev/spec)."""

from __future__ import annotations

import struct
import zlib
from itertools import combinations
from typing import TYPE_CHECKING

import lz4.frame
import pytest
import zstandard

from mavnav.logs import survey
from mavnav.logs.formats.mcap_records import MAGIC
from support.log_files import LASER, laser, serialized

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PAD = b"\x01\x02\x03"
CODECS: dict[str, Callable[[bytes], bytes]] = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}
WAYS = (None, *CODECS)
BETWEEN = ("padding", "index", "metadata", "attachment", "private", "two chunks")
BEHIND = ("schemas", "channels", "statistics", "chunk index", "attachment index", "metadata index", "offsets")


def record(opcode: int, content: bytes, pad: bytes = b"") -> bytes:
    return struct.pack("<BQ", opcode, len(content) + len(pad)) + content + pad


def block(content: bytes | str) -> bytes:
    content = content.encode() if isinstance(content, str) else content
    return struct.pack("<I", len(content)) + content


def chunked(records: bytes, compression: str, crc: bool, pad: bytes = b"") -> bytes:
    packed = CODECS[compression](records)
    checksum = zlib.crc32(records) if crc else 0
    head = struct.pack("<QQQI", 0, 0, len(records), checksum) + block(compression)
    return record(6, head + struct.pack("<Q", len(packed)) + packed, pad)


def declarations(parts: set[str], schema_id: int, told: tuple[str, str]) -> tuple[bytes, bytes]:
    pad = PAD if "padding" in parts else b""
    schema = record(3, struct.pack("<H", 1) + block(told[0]) + block("ros2msg") + block(b"float32 x"), pad)
    channel = record(4, struct.pack("<HH", 1, schema_id) + block("/scan") + block(told[1]) + block(b""), pad)
    return schema if schema_id else b"", channel


def extras(parts: set[str]) -> bytes:
    pad = PAD if "padding" in parts else b""
    extra = b""
    if "attachment" in parts:
        content = struct.pack("<QQ", 1, 2) + block("name") + block("text/plain") + struct.pack("<Q", 3) + b"abc"
        extra += record(9, content + struct.pack("<I", zlib.crc32(content)), pad)
    extra += record(12, block("name") + block(block("key") + block("value")), pad) if "metadata" in parts else b""
    return extra + (record(0x90, b"anything") if "private" in parts else b"")


def summary_records(parts: set[str], count: int, chunk: str | None, declared: tuple[bytes, bytes]) -> bytes:
    pad = PAD if "padding" in parts else b""
    schema, channel = declared
    counts = struct.pack("<QHIIIIQQ", count, bool(schema), 1, 0, 0, chunk is not None, 0, 9) + block(b"")
    kinds = {
        "schemas": schema,
        "channels": channel,
        "statistics": record(11, counts, pad),
        "chunk index": record(8, bytes(32) + block(b"") + bytes(8) + block(chunk or "") + bytes(16), pad),
        "attachment index": record(10, bytes(40) + block("name") + block("text/plain"), pad),
        "metadata index": record(13, bytes(16) + block("name"), pad),
    }
    told = b"".join(kinds[part] for part in BEHIND if part in parts and part in kinds)
    return told + (record(14, struct.pack("<BQQ", 11, 0, 0), pad) if told and "offsets" in parts else b"")


def mcap(
    messages: list[bytes],
    chunk: str | None,
    crc: bool,
    parts: set[str],
    schema_id: int = 1,
    told: tuple[str, str] = (LASER, "cdr"),
) -> bytes:
    """Write a file of one channel; ``chunk`` is the compression, None for none at all; ``told`` type and encoding."""
    declared = declarations(parts, schema_id, told)
    pad = PAD if "padding" in parts else b""
    stored = [record(5, struct.pack("<HIQQ", 1, k, k, k) + data) for k, data in enumerate(messages)]
    runs = [b"".join(stored[:1]), b"".join(stored[1:])] if "two chunks" in parts else [b"".join(stored)]
    runs[0] = b"".join(declared) + runs[0]
    index = record(7, struct.pack("<H", 1) + block(struct.pack("<QQ", 0, 0)), pad) if "index" in parts else b""
    body = b"".join(runs) if chunk is None else b"".join(chunked(run, chunk, crc, pad) + index for run in runs)
    data = MAGIC + record(1, block("ros2") + block("writer"), pad) + body + extras(parts)
    data += record(15, struct.pack("<I", zlib.crc32(data) if crc else 0), pad)
    summary = summary_records(parts, len(messages), chunk, declared)
    footer = struct.pack("<BQQQ", 2, 20, len(data) if summary else 0, 0)
    checksum = zlib.crc32(summary + footer) if crc else 0
    return data + summary + footer + struct.pack("<I", checksum) + MAGIC


@pytest.mark.parametrize("chunk", WAYS)
def test_every_combination_of_parts_is_read_whole(chunk: str | None, tmp_path: Path) -> None:
    """What stands between the messages, and what stands behind them; each alone, and with all of the other.

    The ways to store chunks take turns.
    """
    messages = [serialized(laser(k), 2) for k in range(3)]
    path = tmp_path / "a.mcap"
    chosen = [(set(p), set(q)) for p in subsets(BETWEEN) for q in ((), BEHIND)]
    chosen += [(set(p), set(q)) for p in subsets(BEHIND) for q in ((), BETWEEN)]
    for number, (parts, more) in list(enumerate(chosen))[WAYS.index(chunk) :: len(WAYS)]:
        count = 0 if number % 7 == 0 else 3
        path.write_bytes(mcap(messages[:count], chunk, number % 3 > 0, parts | more))
        found = survey(path)
        assert (found.damage, found.warnings) == ((), ()), parts | more
        assert [(t.name, t.type, t.encoding, t.count) for t in found.topics] == [("/scan", LASER, "cdr", count)]
        assert sum(scans.total for scans in found.scans.values()) == count


def subsets(parts: tuple[str, ...]) -> list[tuple[str, ...]]:
    return [chosen for size in range(len(parts) + 1) for chosen in combinations(parts, size)]


def test_a_channel_without_a_schema_is_told_by_its_messages(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap([serialized(laser(k), 2) for k in range(3)], "zstd", True, {"statistics"}, schema_id=0))
    found = survey(path)
    assert found.scans["/scan"].total == 3
    assert any("no stated type" in d.what for d in found.damage)


@pytest.mark.parametrize(
    ("name", "encoding", "damaged"),
    [(LASER, "ros2", True), (LASER, "CDR", True), ("sensor_msgs::msg::dds_::LaserScan_", "cdr", False)],
)
def test_types_and_encodings_by_other_names_are_scans(name: str, encoding: str, damaged: bool, tmp_path: Path) -> None:
    messages = [serialized(laser(k), 2) for k in range(3)]
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap(messages, None, False, set(), told=(name, encoding)))
    found = survey(path)
    assert found.scans["/scan"].total == 3
    assert bool(found.damage) == damaged


def test_two_files_one_behind_the_other_are_both_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    halves = [[serialized(laser(k), 2) for k in range(n, n + 3)] for n in (0, 3)]
    path.write_bytes(b"".join(mcap(half, "zstd", True, {"statistics"}) for half in halves))
    found = survey(path)
    assert found.scans["/scan"].total == 6
    assert any("one behind the other" in w for w in found.warnings)
    assert found.damage == ()


@pytest.mark.parametrize("at", ["kind", "length"])
def test_a_chunk_whose_head_lies_is_read_by_its_own_fields(at: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = bytearray(mcap([serialized(laser(k), 2) for k in range(3)], "zstd", True, {"statistics", "index"}))
    head = data.index(struct.pack("<QQ", 0, 0)) - 9
    data[head + (0 if at == "kind" else 7)] ^= 0x40
    path.write_bytes(data)
    found = survey(path)
    assert found.scans["/scan"].total == 3
    assert found.damage
