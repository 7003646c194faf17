"""Building blocks of the attacks on logs: wrong values, and small valid logs to damage."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from functools import cache
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from support.log_files import PERIOD_NS, START_NS, Message, laser, write_bag1, write_bag2, write_mcap

Random = np.random.Generator
COUNTS = (0, 1, 2, 0x7F, 0xFFFF, 1 << 20, 1 << 24, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
SIZES = (*COUNTS, 1 << 33, 1 << 40, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)
NUMBERS = (0.0, -0.0, 1e-300, 1e-30, -1.0, 1e9, 1e18, 1e30, 1e300, -1e300, inf, -inf, nan)
DIGITS = (400, 5000, 100_000)


def pick(rng: Random, *values: Any) -> Any:
    """Return a random one of the values, which may have any types."""
    return values[int(rng.integers(len(values)))]


def float32(value: float) -> float:
    """Return a number clipped to the range of float32, which the writer accepts without a warning."""
    return float(np.clip(value, -3e38, 3e38)) if np.isfinite(value) else value


def channel_log(
    path: Path, kind: str, encodings: tuple[str, str], schema: bytes, payloads: Iterable[bytes], topic: str = "/scan"
) -> Path:
    """Write a valid MCAP container of one channel with any schema and any messages."""
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel(topic, encodings[0], writer.register_schema(kind, encodings[1], schema))
        for k, payload in enumerate(payloads):
            writer.add_message(channel, START_NS + k * PERIOD_NS, payload, START_NS)
        writer.finish()
    return path


def room(beams: int = 180) -> np.ndarray:
    """Return the ranges of a full turn in a room of 4 by 6 m, (beams,), float32."""
    angle_rad = np.linspace(-np.pi, np.pi, beams, endpoint=False) + 1e-3
    return np.minimum(2.0 / np.abs(np.cos(angle_rad)), 3.0 / np.abs(np.sin(angle_rad))).astype(np.float32)


def scan(k: int, **fields: Any) -> Message:
    """Return scan k of the room, with some fields replaced."""
    step_rad = 2 * np.pi / 180
    return laser(
        k, **{"angle_min": -np.pi, "angle_increment": step_rad, "angle_max": np.pi, "ranges": room(), **fields}
    )


def scans(count: int = 6) -> list[Message]:
    """Return some valid scans."""
    return [scan(k) for k in range(count)]


@cache
def sound(name: str) -> bytes:
    """Return the bytes of a valid log of a format, to be damaged."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        if name == "carmen":
            return b"".join(carmen_line(k) for k in range(9))
        if name == "db3":
            return next(write_bag2(path, scans(20)).glob("*.db3")).read_bytes()
        write = write_bag1 if name == "bag1" else write_mcap
        return write(path, scans(20)).read_bytes()


def any_sound(rng: Random) -> bytes:
    """Return the bytes of a valid log of a random format."""
    return sound(pick(rng, "mcap", "bag1", "db3", "carmen"))


def carmen_line(k: int, count: object = 181, value: str = "2.5", pose: str = "0 0 0 0 0 0") -> bytes:
    """Return a CARMEN laser line with 181 ranges and any declared count."""
    return f"FLASER {count} {' '.join([value] * 181)} {pose} {1000 + 0.2 * k} host {0.2 * k}\n".encode()
