"""Hostile log containers: each function writes one to a folder and returns its path."""

from __future__ import annotations

import bz2
import gzip
import os
import socket
import sqlite3
import struct
from functools import cache, partial
from pathlib import Path

import lz4.frame
import zstandard
from attack_parts import COUNTS, DIGITS, SIZES, Random, any_sound, pick, scans, sound
from mcap.writer import Writer as McapWriter

from mavnav.logs.formats.mcap_records import HEAD, MAGIC
from support.log_files import LASER, ODOM, START_NS, TF, laser, serialized, write_bag2

SPARSE_BYTES = 200 * 10**9
NAMES = ("../../out_of_bounds", "/\x1b[2J", "/a\n::error::b", "", "/" * 5000, "/%s{0}", "\u202e/scan", "/scan/ring_7")


def many_topics(rng: Random, folder: Path) -> Path:
    """Write thousands of topics with hostile names, a fifth of them with messages."""
    path, count = folder / "a.mcap", int(pick(rng, 100, 1000, 4000))
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=int(pick(rng, 500, 100_000)))
        writer.start()
        kind = pick(rng, LASER, TF, ODOM, "std_msgs/msg/Empty", "")
        schema = writer.register_schema(kind, "ros2msg", b"")
        payload = serialized(laser(0), 2)
        for k in range(count):
            channel = writer.register_channel(f"{pick(rng, *NAMES)}{k if k % 7 else ''}", "cdr", schema)
            if k % 5 == 0:
                writer.add_message(channel, START_NS + k, payload, START_NS)
        writer.finish()
    return path


def tiny_records(rng: Random, folder: Path) -> Path:
    """Write tens of thousands of records of few or no bytes."""
    path, count = folder / "a.mcap", int(pick(rng, 5000, 40_000))
    opcode, size = int(pick(rng, 0, 1, 3, 4, 5, 6, 7, 8, 9, 11, 12, 14, 128, 255)), int(pick(rng, 0, 0, 1, 2, 22, 30))
    record = HEAD.pack(opcode, size) + bytes(size)
    data = sound("mcap")
    at = pick(rng, len(MAGIC), len(data) - len(MAGIC))
    path.write_bytes(data[:at] + record * count + data[at:])
    return path


SQL = (
    "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
    "data BLOB AS (zeroblob(900000000)) VIRTUAL); INSERT INTO messages(topic_id, timestamp) VALUES (1, 5), (1, 6)",
    "ALTER TABLE messages ADD COLUMN extra BLOB AS (randomblob(900000000)) VIRTUAL",
    "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT * FROM m a, m b, m c, m d, m e, m f, m g",
    "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL SELECT "
    "id + 1 FROM r) SELECT id, 1 topic_id, id timestamp, zeroblob(100000) data FROM r",
    "ALTER TABLE topics RENAME TO t; CREATE VIEW topics AS SELECT * FROM t a, t b, t c, t d, messages e, messages f",
    "CREATE TRIGGER boom AFTER INSERT ON topics BEGIN DELETE FROM messages; END",
    "UPDATE messages SET data = zeroblob(30000000) WHERE id < 3", "UPDATE messages SET data = NULL",
    "UPDATE messages SET data = 'x', timestamp = 'y', topic_id = 1.5", "UPDATE messages SET timestamp = 1e300",
    "UPDATE messages SET timestamp = -9223372036854775808 WHERE id % 2", "UPDATE topics SET name = NULL",
    "UPDATE topics SET type = x'ff00', name = x'fffe'", "UPDATE topics SET name = zeroblob(9000000)",
    "UPDATE topics SET id = 99", "DROP TABLE topics", "DROP TABLE messages; CREATE TABLE messages(a, b, c)",
    "UPDATE topics SET serialization_format = 'json', offered_qos_profiles = hex(zeroblob(4000000))",
    "CREATE INDEX slow ON messages(length(data)); PRAGMA user_version = 7",
    "PRAGMA writable_schema = 1; UPDATE sqlite_master SET rootpage = 1 WHERE name = 'messages'",
    "PRAGMA writable_schema = 1; UPDATE sqlite_master SET sql = "
    "'CREATE TABLE messages(' || hex(zeroblob(50000)) || ')'",
    "PRAGMA writable_schema = 1; UPDATE sqlite_master SET sql = 'CREATE VIRTUAL TABLE messages USING fts5(x)'",
    "PRAGMA auto_vacuum = 1; VACUUM; PRAGMA application_id = -1",
    "INSERT INTO topics SELECT 10 + a.id * 1000 + b.id, t.name, t.type, t.serialization_format, "
    "t.offered_qos_profiles, '' FROM topics t, messages a, messages b",
)  # fmt: skip


def sqlite(rng: Random, folder: Path) -> Path:
    """Write a database with generated columns, views, triggers, or values of other types."""
    path = folder / "a.db3"
    path.write_bytes(sound("db3"))
    live = sqlite3.connect(path)
    for script in rng.choice(SQL, int(rng.integers(1, 3)), replace=False):
        live.set_progress_handler(partial(next, iter([0] * 20), 1), 1_000_000)  # two combined scripts may never end
        try:
            live.executescript(str(script))
        except sqlite3.Error:
            continue
    live.commit()
    live.close()
    return path


def sparse(rng: Random, folder: Path) -> Path:
    """Write a sparse file of 200 GB with a hole after, before or within its data."""
    path, data = folder / "a.log", any_sound(rng)
    data = pick(rng, data, gzip.compress(data), zstandard.compress(data), b"")
    at = int(pick(rng, len(data), len(data) // 2, 0))
    with path.open("wb") as file:
        file.write(data[:at])
        if rng.random() < 0.5:
            file.seek(SPARSE_BYTES - len(data))
            file.write(data[at:])
        file.truncate(SPARSE_BYTES)
    return path


def lengths(rng: Random, folder: Path) -> Path:
    """Write records, chunks, strings and arrays with wrong lengths."""
    path = folder / "a.log"
    data = bytearray(any_sound(rng))
    for _ in range(int(rng.integers(1, 4))):
        width = int(pick(rng, 2, 4, 8))
        at = int(rng.integers(min(len(data), pick(rng, 100, 1000, len(data)))))
        data[at : at + width] = (int(pick(rng, *SIZES)) % (1 << 8 * width)).to_bytes(width, "little")
    path.write_bytes(data)
    return path


@cache
def bombs() -> tuple[bytes, ...]:
    """Return compressed files whose content is many times larger."""
    inner = sound("carmen") + b"FLASER " + bytes(60_000_000)
    lines = sound("mcap")[:-8] + HEAD.pack(9, 1 << 40) + bytes(40_000_000)
    packed = [gzip.compress(inner), bz2.compress(inner), zstandard.compress(lines), gzip.compress(gzip.compress(inner))]
    head = sound("carmen")
    return (*packed, gzip.compress(head) * 2000, bz2.compress(head) * 500, zstandard.compress(head) * 2000)


def bomb(rng: Random, folder: Path) -> Path:
    """Write a file or a chunk that decompresses to many times its size."""
    path = folder / "a.mcap"
    if rng.random() < 0.5:
        path.write_bytes(pick(rng, *bombs())[: int(pick(rng, 10**9, 10**9, 5000))])
        return path
    packers = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress, "none": bytes, "": bytes}
    name = str(pick(rng, *packers))
    size = int(pick(rng, 1 << 16, 1 << 22, 1 << 25))
    record = pick(rng, b"", HEAD.pack(200, 0), HEAD.pack(5, 22) + bytes(22), HEAD.pack(4, 30) + bytes(30))
    content = record * (size // len(record)) if record else bytes(size)
    packed = packers[name](content) if name else b"abc"
    declared = pick(rng, len(content), len(content), *SIZES)
    body = struct.pack("<QQQII", 0, 9, declared, 0, len(name)) + name.encode()
    body += struct.pack("<Q", len(packed)) + packed
    data = sound("mcap")
    count = int(pick(rng, 1, 5, 40)) if len(packed) < 100_000 else 1
    path.write_bytes(data[:8] + (HEAD.pack(6, len(body)) + body) * count + data[8:])
    return path


def special(rng: Random, folder: Path) -> Path:
    """Create a pipe, device, socket, folder or link loop in place of a log, or of a file of a bag folder."""
    inside = rng.random() < 0.4
    path = next(write_bag2(folder / "bag", scans()).glob("*.db3")) if inside else folder / "a.mcap"
    path = pick(rng, path, path.with_name("metadata.yaml"), path.with_name(path.name + "-wal")) if inside else path
    path.unlink(missing_ok=True)
    kind = int(rng.integers(5))
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.symlink_to(
            str(
                pick(
                    rng, "/dev/zero", "/dev/full", "/dev/tty", "/proc/self/mem", "/dev/stdin", path.name, "/dev/urandom"
                )
            )
        )
    elif kind == 2:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(str(path))
    elif kind == 3:
        path.mkdir()
    else:
        (folder / "far").mkdir()
        path.symlink_to(folder / "far")
    return folder / "bag" if inside else path


METADATA = ("duration", "version", "message_count", "relative_file_paths", "topics_with_message_count", "type", "files")


def metadata(rng: Random, folder: Path) -> Path:
    """Write a rosbag2 folder whose metadata.yaml has invalid values, or lists files outside of the folder."""
    bag = write_bag2(folder / "bag", scans(), str(pick(rng, "SQLITE3", "MCAP")))
    path = bag / "metadata.yaml"
    value = pick(
        rng, "9" * int(pick(rng, *DIGITS)), "[" * 5000, "&a [*a]", "!!python/object/apply:os.system [touch x]", "null",
        "{a: &b [1, 1], c: [*b, *b]}", '["../../etc/passwd"]', '["/dev/zero"]', '["../log.mcap", ""]', "1e300", ".nan",
        '["' + "x" * 500_000 + '"]', '["a\\0b"]', "-1", "[[], {}]", "2020-99-99", "0x" + "f" * 5000,
    )  # fmt: skip
    lines = path.read_text().splitlines()
    key = str(pick(rng, *METADATA))
    at = [k for k, line in enumerate(lines) if f"{key}:" in line]
    if at:
        lines[at[0]] = f"{lines[at[0]].partition(':')[0]}: {value}"
    path.write_text("\n".join(lines) if at and rng.random() < 0.8 else str(value))
    return bag


def connections(rng: Random, folder: Path) -> Path:
    """Write a ROS 1 bag with wrong connection ids, field names, indices, definitions or compressions."""
    path = folder / "a.bag"
    data = sound("bag1")
    for _ in range(int(rng.integers(1, 4))):
        old, new = pick(
            rng, (b"conn=\0\0\0\0", b"conn=" + struct.pack("<I", pick(rng, *COUNTS))), (b"conn=", b"cono="),
            (b"op=\x07", b"op=\x02"), (b"op=\x02", b"op=\x05"), (b"op=\x05", b"op=\x07"), (b"op=\x04", b"op=\x06"),
            (b"topic=/scan", b"topic=\xff\xfe\0\x1b["), (b"type=sensor_msgs/LaserScan", b"type=sensor_msgs/LaserScam"),
            (b"compression=none", b"compression=bz2 "), (b"compression=none", b"compression=\xff\xff\xff\xff"),
            (b"float32[] ranges", b"float64[] ranges"), (b"Header header", b"LaserScan hea"), (b"=", b":"),
            (b"size=", b"size=" + struct.pack("<I", pick(rng, *COUNTS))), (b"time=", b"tame="), (b"op=", b"op=="),
            (b"index_pos=", b"index_pos=" + struct.pack("<Q", pick(rng, *SIZES))), (b"count=", b"count=\xff"),
        )  # fmt: skip
        size = len(old) if len(new) > len(old) and new.startswith(old) else 0
        at = [k for k in range(len(data)) if data.startswith(old, k)] if size or rng.random() < 0.5 else []
        if at:
            place = int(pick(rng, *at))
            data = data[:place] + new + data[place + len(new) :]
        else:
            data = data.replace(old, new)
    path.write_bytes(data)
    return path


def nested_records(rng: Random, folder: Path) -> Path:
    """Write MCAP with nested chunks, a summary with wrong offsets, and repeated records."""
    data = sound("mcap")
    body = data[8:-8]
    for _ in range(int(pick(rng, 0, 0, 1, 40))):
        chunk = struct.pack("<QQQII", 0, 2**64 - 1, len(body), 0, 0) + struct.pack("<Q", len(body)) + body
        body = HEAD.pack(6, len(chunk)) + chunk
    foot = HEAD.pack(2, 20) + struct.pack("<QQI", pick(rng, 8, 0, *SIZES[-6:]), pick(rng, 8, *SIZES[-6:]), 0)
    index = struct.pack("<QQQQ", 0, 2**64 - 1, pick(rng, 8, *SIZES), pick(rng, 100, *SIZES))
    index += struct.pack("<IQ", pick(rng, *COUNTS), 0) + struct.pack("<IQQ", 0, 0, 0)
    records = HEAD.pack(8, len(index)) + index
    statistics = HEAD.pack(11, 46) + rng.bytes(46)
    path = folder / "a.mcap"
    path.write_bytes(data[:8] + body + (records + statistics) * int(pick(rng, 1, 2000)) + foot + data[-8:])
    return path
