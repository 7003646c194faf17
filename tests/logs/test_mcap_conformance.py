"""MCAP files of every legal combination of parts, written byte by byte from the specification (https://mcap.dev/spec)."""

from __future__ import annotations

import struct
import zlib
from itertools import product
from typing import TYPE_CHECKING

import lz4.frame
import pytest
import zstandard
from log_files import LASER, laser, serialized

from mavnav.logs import survey
from mavnav.logs.mcap_records import MAGIC

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PAD = b"\x01\x02\x03"
CODECS: dict[str, Callable[[bytes], bytes]] = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}
PARTS = ("padding", "index", "metadata", "attachment", "repeat", "summary", "private")


def record(opcode: int, content: bytes, pad: bytes = b"") -> bytes:
    return struct.pack("<BQ", opcode, len(content) + len(pad)) + content + pad


def block(content: bytes | str) -> bytes:
    content = content.encode() if isinstance(content, str) else content
    return struct.pack("<I", len(content)) + content


def chunked(records: bytes, compression: str, crc: bool) -> bytes:
    packed = CODECS[compression](records)
    checksum = zlib.crc32(records) if crc else 0
    head = struct.pack("<QQQI", 0, 0, len(records), checksum) + block(compression)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def mcap(messages: list[bytes], chunk: str | None, crc: bool, parts: set[str], schema_id: int = 1) -> bytes:
    """Write a file of one channel; ``chunk`` is the compression, None for none at all."""
    pad = PAD if "padding" in parts else b""
    schema = record(3, struct.pack("<H", 1) + block(LASER) + block("ros2msg") + block(b"float32 x"), pad)
    channel = record(4, struct.pack("<HH", 1, schema_id) + block("/scan") + block("cdr") + block(b""), pad)
    declared = (schema if schema_id else b"") + channel
    told = [record(5, struct.pack("<HIQQ", 1, k, k, k) + data) for k, data in enumerate(messages)]
    index = record(7, struct.pack("<H", 1) + block(struct.pack("<QQ", 0, 0)), pad) if "index" in parts else b""
    body = declared + b"".join(told) if chunk is None else chunked(declared + b"".join(told), chunk, crc) + index
    extra = b""
    if "attachment" in parts:
        content = struct.pack("<QQ", 1, 2) + block("name") + block("text/plain") + struct.pack("<Q", 3) + b"abc"
        extra += record(9, content + struct.pack("<I", zlib.crc32(content)), b"")
    extra += record(12, block("name") + block(block("key") + block("value")), pad) if "metadata" in parts else b""
    extra += record(0x90, b"anything") if "private" in parts else b""
    data = MAGIC + record(1, block("ros2") + block("writer"), pad) + body + extra
    data += record(15, struct.pack("<I", zlib.crc32(data) if crc else 0), pad)
    summary = b""
    if "summary" in parts:
        summary += declared if "repeat" in parts else b""
        counts = struct.pack("<QHIIIIQQ", len(messages), bool(schema_id), 1, 0, 0, chunk is not None, 0, 9)
        summary += record(11, counts + block(b""), pad)
    footer = struct.pack("<BQQQ", 2, 20, len(data) if summary else 0, 0)
    checksum = zlib.crc32(summary + footer) if crc else 0
    return data + summary + footer + struct.pack("<I", checksum) + MAGIC


@pytest.mark.parametrize("chunk", [None, "", "lz4", "zstd"])
@pytest.mark.parametrize("crc", [True, False])
def test_every_combination_of_parts_is_read_whole(chunk: str | None, crc: bool, tmp_path: Path) -> None:
    messages = [serialized(laser(k), 2) for k in range(3)]
    path = tmp_path / "a.mcap"
    for chosen in product([True, False], repeat=len(PARTS)):
        parts = {part for part, wanted in zip(PARTS, chosen, strict=True) if wanted}
        for count in (0, 3):
            path.write_bytes(mcap(messages[:count], chunk, crc, parts))
            found = survey(path)
            assert (found.damage, found.warnings) == ((), ()), parts
            assert [(t.name, t.type, t.encoding, t.count) for t in found.topics] == [("/scan", LASER, "cdr", count)]
            assert sum(scans.total for scans in found.scans.values()) == count


def test_a_channel_without_a_schema_is_told_by_its_messages(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap([serialized(laser(k), 2) for k in range(3)], "zstd", True, {"summary"}, schema_id=0))
    found = survey(path)
    assert found.scans["/scan"].total == 3
    assert any("told nowhere" in d.what for d in found.damage)


def test_two_files_one_behind_the_other_are_both_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    halves = [[serialized(laser(k), 2) for k in range(n, n + 3)] for n in (0, 3)]
    path.write_bytes(b"".join(mcap(half, "zstd", True, {"summary"}) for half in halves))
    found = survey(path)
    assert found.scans["/scan"].total == 6
    assert any("one behind the other" in w for w in found.warnings)
    assert found.damage == ()


@pytest.mark.parametrize("at", ["kind", "length"])
def test_a_chunk_whose_head_lies_is_read_by_its_own_fields(at: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = bytearray(mcap([serialized(laser(k), 2) for k in range(3)], "zstd", True, {"summary", "index"}))
    head = data.index(struct.pack("<QQ", 0, 0)) - 9
    data[head + (0 if at == "kind" else 7)] ^= 0x40
    path.write_bytes(data)
    found = survey(path)
    assert found.scans["/scan"].total == 3
    assert found.damage
