"""Kinds of hostile logs, and the commands that read them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import container_attacks as container
import message_attacks as message
from attack_parts import Random, pick

KINDS: dict[str, Callable[[Random, Path], Path]] = {
    "many topics": container.many_topics, "tiny records": container.tiny_records,
    "huge strings": message.huge_strings, "definitions": message.definitions, "IDL": message.idl,
    "SQLite": container.sqlite, "odometry": message.odometry, "sparse 200 GB": container.sparse,
    "lengths": container.lengths, "CDR": message.cdr, "JSON": message.foxglove_json, "protobuf": message.protobuf,
    "PointCloud2": message.cloud, "MultiEcho": message.multi_echo, "CARMEN": message.carmen, "bombs": container.bomb,
    "special files": container.special, "metadata.yaml": container.metadata, "bag connections": container.connections,
    "scan geometry": message.geometry, "nested records": container.nested_records,
}  # fmt: skip
"""Name -> the function that writes a log of this kind to a folder and returns its path."""


def command(rng: Random, kind: str, path: Path) -> Sequence[str]:
    """Return one of three commands that read a log, often with a suffix that selects a scan of a topic."""
    name = path.name
    part = str(pick(rng, "ring_1", "z_-0.1_0.3")) if kind == "PointCloud2" else str(pick(rng, "last", "strongest"))
    topic = ("--topic", f"/scan/{part}") if kind in {"PointCloud2", "MultiEcho"} and rng.random() < 0.4 else ()
    replay = ("replay", name, "-o", "out/run", "--grid", "5x5", "--azimuth", "6", "-q", "--outputs", "trajectory,map")
    convert = ("convert", name, "out/x.mcap", "-q")
    return convert if rng.random() < 0.35 else (*pick(rng, ("info", name), replay), *topic)
