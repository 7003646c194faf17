"""Hostile messages and definitions in valid containers: each function writes a log to a folder."""

from __future__ import annotations

import gzip
import json
import struct
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from attack_parts import COUNTS, DIGITS, NUMBERS, Random, carmen_line, channel_log, float32, pick, room, scan
from google.protobuf import descriptor_pb2 as pb
from mcap.reader import make_reader

from support.fuzz import mutated
from support.log_files import (
    LASER,
    ODOM,
    PERIOD_NS,
    START_NS,
    TF,
    Message,
    foxglove_protobuf,
    laser,
    serialized,
    store,
    write_mcap,
)  # fmt: skip

CLOUD, ECHOES = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/MultiEchoLaserScan"


def huge_strings(rng: Random, folder: Path) -> Path:
    """Write names of topics, types, frames and encodings of a megabyte or more."""
    text = "x" * int(pick(rng, 70_000, 1 << 20, 4 << 20))
    at = int(rng.integers(5))
    payloads = [serialized(laser(k, frame_id=text if at == 0 else "laser"), 2) for k in range(2)]
    kind, encoding, schema = (text if at == k else name for k, name in ((1, LASER), (2, "cdr"), (3, "ros2msg")))
    return channel_log(folder / "a.mcap", kind, (encoding, schema), b"", payloads, text if at == 4 else "/scan")


def definitions(rng: Random, folder: Path) -> Path:
    """Write message definitions that nest deeply, recurse, grow exponentially or declare arrays larger than memory."""
    depth, width = int(pick(rng, 30, 900, 9000)), int(pick(rng, 1, 2, 10))
    size = pick(rng, "", "[]", "[4294967295]", "[999999999999999999999]", "[<=4]", "[0]", "[-1]")
    fields = pick(rng, "float64", "string<=99999999999", "wstring", "uint8[4294967295]", "", "x/Gone")
    names = [f"a/T{k}" for k in range(depth)]
    last = pick(rng, f"{fields} x\n" if fields else "", f"a/T{int(rng.integers(depth))} x\n", "#" * 100_000)
    bodies = ["".join(f"{name}{size} f{k}\n" for k in range(width)) for name in names[1:]]
    line = "=" * 80
    text = pick(rng, "", "std_msgs/Header header\n") + bodies[0]
    text += "".join(f"{line}\nMSG: {name}\n{body}" for name, body in zip(names[1:], [*bodies[1:], last], strict=True))
    kind = pick(rng, LASER, ODOM, TF, "a/msg/T0", ECHOES, "tf2_msgs/TFMessage")
    payload = pick(rng, serialized(laser(0), 2), b"\0\1\0\0" + b"\xff" * 400, b"\0\1\0\0" + bytes(4000), b"")
    return channel_log(
        folder / "a.mcap", kind, ("cdr", pick(rng, "ros2msg", "ros1msg", "ros2idl")), text.encode(), [payload] * 3
    )


IDLS = (
    "module a { " * 3000,
    "module sensor_msgs { module msg { struct LaserScan { LaserScan x; }; }; };",
    f"module a {{ struct S {{ sequence<{'sequence<' * 500}octet{'>' * 500}> x; }}; }};",
    "module a { const long x = 1" + "0" * 5000 + "; };",
    "/*" * 100_000,
)


def idl(rng: Random, folder: Path) -> Path:
    """Write definitions in IDL that nest, recurse or do not end."""
    kind = pick(rng, LASER, "a/msg/S", "x", "/" * 300)
    payloads = [serialized(laser(k), 2) for k in range(3)]
    return channel_log(folder / "a.mcap", kind, ("cdr", "ros2idl"), pick(rng, *IDLS).encode(), payloads)


def odometry(rng: Random, folder: Path) -> Path:
    """Write poses and mountings of any magnitude with valid scans."""
    messages = []
    for k in range(12):
        x, y, yaw = (float(pick(rng, 0.1 * k, 0.0, *NUMBERS)) if rng.random() < 0.5 else 0.1 * k for _ in range(3))
        yaw = yaw if np.isfinite(yaw) else 0.0
        messages += [scan(k), Message("/odom", ODOM, START_NS + k * PERIOD_NS, {"x": x, "y": y, "yaw": yaw})]
    x, parent = float(pick(rng, *NUMBERS)), str(pick(rng, "base_link", "laser", "odom", ""))
    mounting = {"parent": parent, "child": "laser", "x": x, "y": 0.0, "q": dict.fromkeys("xyzw", pick(rng, *NUMBERS))}
    messages.append(Message("/tf_static", TF, START_NS, mounting))
    return write_mcap(folder / "a.mcap", messages)


def cdr(rng: Random, folder: Path) -> Path:
    """Write valid definitions, with messages that have wrong counts, another byte order or another type."""
    payloads = []
    for k in range(5):
        data = bytearray(serialized(laser(k), 2))
        for _ in range(int(rng.integers(1, 3))):
            at = 4 * int(rng.integers(len(data) // 4))
            data[at : at + 4] = struct.pack(str(pick(rng, "<", ">")) + "I", pick(rng, *COUNTS))
        payloads.append(bytes(data[: int(pick(rng, len(data), len(data) - 3, 8))]))
    kind = str(pick(rng, LASER, LASER, LASER, ODOM, TF, CLOUD, ECHOES, "geometry_msgs/msg/PoseStamped"))
    return channel_log(folder / "a.mcap", kind, ("cdr", "ros2msg"), b"", payloads)


def foxglove_json(rng: Random, folder: Path) -> Path:
    """Write JSON that nests deeply, has numbers with thousands of digits, or values of other types."""
    scan = {"timestamp": {"sec": 1, "nsec": 5}, "frame_id": "l", "start_angle": -1.0, "end_angle": 1.0, "pose": {}}
    deep = int(pick(rng, 500, 100_000))
    raw = pick(
        rng, "[" * deep + "]" * deep, '{"a":' * deep, "9" * int(pick(rng, *DIGITS)), "1e999", "NaN", "-Infinity", "{}",
        "null", '"1"', "true", "1" + "0" * 300, "-1e300", '"' + "9" * 5000 + '"', "[[1.0]]", '{"sec":1e300,"nsec":-1}',
        f"[{','.join(['1e300'] * 16)}]", f"[{','.join(['1'] * 200_000)}]",
    )  # fmt: skip
    payloads = []
    for k in range(3):
        key = str(pick(rng, *scan, "ranges"))
        text = json.dumps({**scan, "timestamp": {"sec": 1, "nsec": k}, "ranges": [2.0] * 16, key: "@"})
        payloads.append(text.replace('"@"', raw).encode())
    return channel_log(folder / "a.mcap", "foxglove.LaserScan", ("json", "jsonschema"), b"{}", payloads)


def protobuf(rng: Random, folder: Path) -> Path:
    """Write protobuf with wrong types, recursion or damage in the descriptor, and messages that do not fit it."""
    files = pb.FileDescriptorSet()
    for number in range(int(pick(rng, 1, 1, 2, 500))):
        file = files.file.add(
            name=f"f{number}", package="foxglove", dependency=[f"f{pick(rng, number, number - 1, 0)}"]
        )
        if rng.random() < 0.7:
            del file.dependency[:]
        for name in ("Pose", "LaserScan") if number == 0 else (f"M{number}",):
            message = file.message_type.add(name=name)
            for k, field in enumerate(("timestamp", "frame_id", "pose", "start_angle", "end_angle", "ranges"), 1):
                kind, label = int(rng.integers(1, 19)), int(rng.integers(1, 4))
                about = str(pick(rng, ".foxglove.Pose", ".foxglove.LaserScan", "x")) if kind in {10, 11, 14} else None
                message.field.add(name=field, number=int(pick(rng, k, k, 1, 0, 2**29)), type=kind, label=label)
                if about:
                    message.field[-1].type_name = about
    made = foxglove_bytes()
    schema = pick(rng, files.SerializeToString(), files.SerializeToString(), mutated(made[0], int(rng.integers(2**31))))
    body = pick(rng, mutated(made[1], int(rng.integers(2**31))), b"\x1a\xff\xff\xff\xff\x07", b"\x0b" * 50_000, made[1])
    schema = pick(rng, schema, made[0])
    return channel_log(folder / "a.mcap", "foxglove.LaserScan", ("protobuf", "protobuf"), schema, [body] * 3)


@cache
def foxglove_bytes() -> tuple[bytes, bytes]:
    """Return a valid descriptor and a valid message."""
    scan = {"timestamp": {"sec": 1, "nsec": 5}, "frame_id": "l", "start_angle": -1.0, "end_angle": 1.0, "ranges": [2.0]}
    with tempfile.TemporaryDirectory() as folder:
        path = foxglove_protobuf(Path(folder) / "a", [scan])
        with path.open("rb") as file:
            schema, _, message = next(make_reader(file).iter_messages())
    assert schema is not None
    return schema.data, message.data


def cloud(rng: Random, folder: Path) -> Path:
    """Write point clouds with wrong counts, offsets, steps, types and names."""
    types, payloads = store(2).types, []
    data = rng.uniform(-3, 3, (40, 4)).astype("<f4")
    for _ in range(4):
        numbers = {"height": 1, "width": 40, "point_step": 16, "row_step": 640}
        for name in rng.choice(list(numbers), int(rng.integers(3)), replace=False):
            numbers[str(name)] = int(pick(rng, *COUNTS))
        offsets = [int(pick(rng, 4 * k, 4 * k, 4 * k, *COUNTS)) for k in range(4)]
        kinds = [int(pick(rng, 7, 7, 7, 8, 0, 9, 255, 2)) for _ in range(4)]
        names = [str(name) for name in pick(rng, ("x", "y", "z", "ring"), ("x", "x", "y", "y"), ("", "y", "z", "x"))]
        fields = [
            types["sensor_msgs/msg/PointField"](name, offset, kind, int(pick(rng, 1, 1, *COUNTS)))
            for name, offset, kind in zip(names, offsets, kinds, strict=True)
        ]
        values = data.copy()
        values[int(rng.integers(40)), int(rng.integers(4))] = float32(float(pick(rng, *NUMBERS)))
        message = types[CLOUD](
            header(types), numbers["height"], numbers["width"], fields, bool(rng.integers(2)), numbers["point_step"],
            numbers["row_step"], np.frombuffer(values.tobytes(), np.uint8)[: int(pick(rng, 640, 640, 100, 0))], True,
        )  # fmt: skip
        payloads.append(bytes(store(2).serialize_cdr(message, CLOUD)))
    return channel_log(folder / "a.mcap", CLOUD, ("cdr", "ros2msg"), b"", payloads)


def header(types: dict[str, Any]) -> Any:
    """Return a header."""
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1_700_000_000, 0), "laser")


def multi_echo(rng: Random, folder: Path) -> Path:
    """Write multi-echo scans with beams of no or many echoes, other numbers of intensities, and wrong counts."""
    types, payloads = store(2).types, []
    echo = types["sensor_msgs/msg/LaserEcho"]
    for _ in range(4):
        ranges, strong = ([echo(np.full(int(rng.integers(4)), 2, np.float32)) for _ in range(16)] for _ in range(2))
        angles = [float32(float(pick(rng, v, v, v, *NUMBERS))) for v in (-1.0, 1.0, 0.125, 0.0, 0.1, 0.1, 9.0)]
        message = types[ECHOES](header(types), *angles, ranges, strong[: int(pick(rng, 16, 16, 3, 0))])
        data = bytearray(store(2).serialize_cdr(message, ECHOES))
        if rng.random() < 0.5:
            at = 4 * int(rng.integers(5, len(data) // 4))
            data[at : at + 4] = struct.pack("<I", pick(rng, *COUNTS))
        payloads.append(bytes(data))
    return channel_log(folder / "a.mcap", ECHOES, ("cdr", "ros2msg"), b"", payloads)


def carmen(rng: Random, folder: Path) -> Path:
    """Write CARMEN lines with wrong counts, huge numbers, or without an end."""
    digits = "9" * int(pick(rng, *DIGITS))
    odd = (digits, "-1", "1e5", "0x10", "1_0", "nan", "-inf", "1e999", "1e300", "4294967296", "\u0661", "", "\0", "x")
    lines = [carmen_line(k) for k in range(6)]
    for _ in range(int(rng.integers(1, 4))):
        value = str(pick(rng, *odd))
        lines.insert(
            int(rng.integers(len(lines))),
            pick(
                rng, carmen_line(7, count=value), carmen_line(7, value=value), carmen_line(7, pose=f"{value} " * 6),
                f"ODOM {value} 0 {value} 0 0 0 {value} host {value}\n".encode(),
                f"PARAM robot_front_laser_max {value} 0 h 0\n".encode(),
                f"PARAM laser_front_laser_resolution {value} 0 h 0\n".encode(),
                f"PARAM robot_frontlaser_offset {value} 0 h 0\n".encode(), b"FLASER " + b"1 " * (2 << 20),
                b"FLASER 181" * 100_000, f"RAWLASER1 0 {value} {value} 1 {value} 0 0 181 {value}\n".encode(),
                f"ROBOTLASER1 0 -1 2 {value} 9 0 0 16 {'1 ' * 16}0 {'0 ' * 9}1 h {value}\n".encode(), b"\n" * 200_000,
                b"FLASER 1 2.0 0 0 0 0 0 0 1 h 1\n" * 10_000,
            ),
        )  # fmt: skip
    path, data = folder / "a.log", b"".join(lines)
    path.write_bytes(gzip.compress(data, 1) if rng.random() < 0.3 else data)
    return path


def geometry(rng: Random, folder: Path) -> Path:
    """Write scans with angles, steps, limits, ranges, counts and stamps of any magnitude."""
    names = ("angle_min", "angle_increment", "angle_max", "time_increment", "scan_time", "range_min", "range_max")
    odd = {str(name): float32(float(pick(rng, *NUMBERS))) for name in rng.choice(names, int(rng.integers(3)))}
    messages = []
    for k in range(8):
        fields = dict(odd) if rng.random() < 0.7 else {}
        beams = int(pick(rng, 180, 180, 180, 180, 180, 0, 1, 181, 20_000))
        ranges = room(max(beams, 1))[:beams]
        ranges[: beams // 3 * int(rng.integers(2))] = float32(float(pick(rng, 2.0, *NUMBERS)))
        stamp_ns = int(pick(rng, START_NS + k * PERIOD_NS, START_NS, 0, -(2**31) * 10**9, (2**31 - 1) * 10**9))
        stamp_ns = stamp_ns if rng.random() < 0.4 else START_NS + k * PERIOD_NS
        laser_fields = scan(k, **fields, ranges=ranges).fields
        log_ns = int(pick(rng, START_NS + k, 0, 2**63 - 1, 2**64 - 1)) if rng.random() < 0.3 else START_NS + k
        messages.append(Message("/scan", LASER, stamp_ns, laser_fields, log_ns))
    return write_mcap(folder / "a.mcap", messages, compression=str(pick(rng, "NONE", "LZ4", "ZSTD")))
