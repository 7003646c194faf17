"""Writing MCAP: messages in chunks that are compressed with zstd, each with its index, and the summary at the end.

A result holds three messages a scan: a record is one call of ``struct`` (https://mcap.dev/spec). Nothing depends on the
clock: equal messages give equal bytes.
"""

from __future__ import annotations

import struct
import zlib
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any, Final

import zstandard

from mavnav import __version__
from mavnav.logs.definitions import definition
from mavnav.logs.mcap_records import HEAD, MAGIC, Op

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

CHUNK_BYTES: Final = 128 * 1024
"""A file that is cut keeps all chunks before the cut, some four seconds of scans each."""

_MESSAGE: Final = struct.Struct("<BQHIQQ")
_MESSAGE_BYTES: Final = _MESSAGE.size - HEAD.size
_QOS: Final = """\
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""


@dataclass(frozen=True, slots=True)
class Channel:
    """The type of a topic's messages, and whether a late subscriber gets the last one (latched, transient local)."""

    type: str
    latched: bool = False


def qos_text(channel: Channel) -> str:
    """Return the quality of service of a channel as rosbag2 writes it into the metadata."""
    return _QOS.format(
        depth=1 if channel.latched else 10, durability="transient_local" if channel.latched else "volatile"
    )


@contextmanager
def write_serialized(path: Path, channels: Mapping[str, Channel]) -> Iterator[Callable[[str, int, bytes], None]]:
    """Write an MCAP file of ROS 2 messages with their definitions; gives ``put(topic, stamp_ns, message)``.

    Messages are serialised as CDR already; their time of recording is the stamp that comes with them, in ns.
    """
    with path.open("wb") as file:
        writer = _Writer(file, channels)
        yield writer.put
        writer.finish()


def _record(opcode: int, *parts: bytes) -> bytes:
    return b"".join((HEAD.pack(opcode, sum(map(len, parts))), *parts))


def _block(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _text(text: str) -> bytes:
    return _block(text.encode())


@dataclass(slots=True)
class _Chunk:
    """Records that are compressed together; ``places`` has stamp and offset of each message by channel."""

    first_ns: int = 0
    last_ns: int = 0
    size: int = 0
    records: list[bytes] = field(default_factory=list)
    places: dict[int, list[int]] = field(default_factory=dict)

    def add(self, record: bytes) -> None:
        self.records.append(record)
        self.size += len(record)

    def add_message(self, number: int, stamp_ns: int, data: bytes) -> None:
        self.first_ns = min(stamp_ns, self.first_ns) if self.places else stamp_ns
        self.last_ns = max(stamp_ns, self.last_ns)
        self.places.setdefault(number, []).extend((stamp_ns, self.size))
        head = _MESSAGE.pack(Op.MESSAGE, _MESSAGE_BYTES + len(data), number, 0, stamp_ns, stamp_ns)
        self.records += (head, data)
        self.size += len(head) + len(data)


class _Writer:
    """A file that is being written: the chunk that is filled, and what the summary will tell."""

    def __init__(self, file: IO[Any], channels: Mapping[str, Channel]) -> None:
        self._file, self._chunk, self._compressor = file, _Chunk(), zstandard.ZstdCompressor()
        self._chunk_indexes: list[bytes] = []
        self._stamps_ns: tuple[int, int] | None = None
        self._counts: dict[int, int] = {}
        kinds = list(dict.fromkeys(channel.type for channel in channels.values()))
        self._schemas = [
            _record(Op.SCHEMA, struct.pack("<H", n), _text(kind), _text("ros2msg"), _text(definition(kind)))
            for n, kind in enumerate(kinds, 1)
        ]
        self._numbers = {topic: n for n, topic in enumerate(channels, 1)}
        self._channels = [
            _channel(self._numbers[topic], 1 + kinds.index(channel.type), topic, channel)
            for topic, channel in channels.items()
        ]
        file.write(MAGIC + _record(Op.HEADER, _text("ros2"), _text(f"mavnav {__version__}")))
        for record in (*self._schemas, *self._channels):
            self._chunk.add(record)

    def put(self, topic: str, stamp_ns: int, message: bytes) -> None:
        """Add a message."""
        number = self._numbers[topic]
        self._counts[number] = self._counts.get(number, 0) + 1
        first_ns, last_ns = self._stamps_ns or (stamp_ns, 0)
        self._stamps_ns = min(first_ns, stamp_ns), max(last_ns, stamp_ns)
        self._chunk.add_message(number, stamp_ns, message)
        if self._chunk.size > CHUNK_BYTES:
            self._finish_chunk()

    def finish(self) -> None:
        """Write what is left, and the summary."""
        if self._chunk.places:
            self._finish_chunk()
        self._file.write(_record(Op.DATA_END, bytes(4)))
        start, sections, offsets = self._file.tell(), b"", b""
        for opcode, records in (
            (Op.SCHEMA, self._schemas),
            (Op.CHANNEL, self._channels),
            (Op.STATISTICS, [self._statistics()]),
            (Op.CHUNK_INDEX, self._chunk_indexes),
            (Op.ATTACHMENT_INDEX, []),
            (Op.METADATA_INDEX, []),
        ):
            section = b"".join(records)
            offsets += _record(Op.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start + len(sections), len(section)))
            sections += section
        places = struct.pack("<QQ", start, start + len(sections))
        crc = zlib.crc32(sections + offsets + HEAD.pack(Op.FOOTER, len(places) + 4) + places)
        self._file.write(sections + offsets + _record(Op.FOOTER, places, struct.pack("<I", crc)) + MAGIC)

    def _finish_chunk(self) -> None:
        chunk, self._chunk = self._chunk, _Chunk()
        records, offset = b"".join(chunk.records), self._file.tell()
        stored, span = self._compressor.compress(records), struct.pack("<QQ", chunk.first_ns, chunk.last_ns)
        size = struct.pack("<QI", len(records), zlib.crc32(records))
        record = _record(Op.CHUNK, span, size, _text("zstd"), struct.pack("<Q", len(stored)), stored)
        self._file.write(record)
        indexes, places = b"", b""
        for number, pairs in chunk.places.items():
            places += struct.pack("<HQ", number, offset + len(record) + len(indexes))
            indexes += _record(
                Op.MESSAGE_INDEX, struct.pack("<H", number), _block(struct.pack(f"<{len(pairs)}Q", *pairs))
            )
        self._file.write(indexes)
        self._chunk_indexes.append(
            _record(
                Op.CHUNK_INDEX,
                span,
                struct.pack("<QQ", offset, len(record)),
                _block(places),
                struct.pack("<Q", len(indexes)),
                _text("zstd"),
                struct.pack("<QQ", len(stored), len(records)),
            )
        )

    def _statistics(self) -> bytes:
        first_ns, last_ns = self._stamps_ns or (0, 0)
        counts = b"".join(struct.pack("<HQ", *pair) for pair in self._counts.items())
        numbers = (sum(self._counts.values()), len(self._schemas), len(self._channels), 0, 0, len(self._chunk_indexes))
        return _record(Op.STATISTICS, struct.pack("<QHIIIIQQ", *numbers, first_ns, last_ns), _block(counts))


def _channel(number: int, schema: int, topic: str, channel: Channel) -> bytes:
    metadata = _block(_text("offered_qos_profiles") + _text(qos_text(channel)))
    return _record(Op.CHANNEL, struct.pack("<HH", number, schema), _text(topic), _text("cdr"), metadata)
