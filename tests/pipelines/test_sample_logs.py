"""The sample logs are what the commands in their README record, and are as small as it says.

Remade logs are compared message by message, numbers to 1e-6 and everything else exactly: bytes would depend on the
versions of zstd and sqlite, and on the last bit of the processor's sines. ``make samples`` records them anew after a
wanted change.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from mavnav.cli import run
from support.marks import slow

SAMPLES = Path(__file__).parents[2] / "sample_logs"
README = SAMPLES / "README.md"
LOGS = ("corridor.mcap", "complex.bag", "corner")
TYPED = [line.split() for line in re.findall(r"^ {4}mavnav (.*)$", README.read_text(), re.MULTILINE)]
COMMANDS = {words[-1]: words for words in TYPED}
"""Sample log -> the command that records it, word by word."""

DIGEST_LINE = re.compile(r"^([0-9a-f]{64})  (\S+)$", re.MULTILINE)
UPDATE = os.environ.get("MAVNAV_UPDATE_SAMPLES") == "1"


def files(log: Path) -> list[Path]:
    return sorted(log.iterdir()) if log.is_dir() else [log]


def digests() -> dict[str, str]:
    return {
        str(path.relative_to(SAMPLES)): hashlib.sha256(path.read_bytes()).hexdigest()
        for name in LOGS
        for path in files(SAMPLES / name)
    }


def leaves(value: Any) -> Iterator[Any]:
    """Yield numbers, arrays and texts of a message in the order of its fields."""
    if is_dataclass(value):
        for field in fields(value):
            yield from leaves(getattr(value, field.name))
    elif isinstance(value, list):
        for item in value:
            yield from leaves(item)
    else:
        yield value


def messages(log: Path) -> list[tuple[str, str, int, list[str], np.ndarray]]:
    """Return topic, type, stamp, texts and numbers of every message."""
    with AnyReader([log]) as reader:
        found = []
        for connection, stamp_ns, data in reader.messages():
            parts = list(leaves(reader.deserialize(data, connection.msgtype)))
            texts = [part for part in parts if isinstance(part, str)]
            numbers = [np.ravel(part).astype(float) for part in parts if not isinstance(part, str)]
            found.append((connection.topic, connection.msgtype, stamp_ns, texts, np.concatenate(numbers)))
        return found


def replace_sample(made: Path) -> None:
    """Put a remade log in the place of the kept one, and its digests into the README."""
    kept = SAMPLES / made.name
    if kept.is_dir():
        shutil.rmtree(kept)
    shutil.move(made, kept)
    rows = {name: digest for name, digest in digests().items() if name.split("/")[0] == made.name}
    text = DIGEST_LINE.sub(lambda row: f"{rows.get(row[2], row[1])}  {row[2]}", README.read_text())
    README.write_text(text)


@pytest.mark.parametrize("name", [*(slow(name) for name in LOGS[:2]), LOGS[2]])
def test_the_command_in_the_readme_makes_it_again(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([*COMMANDS[name], "--quiet"]) == 0
    if UPDATE:
        replace_sample(tmp_path / name)
        pytest.skip("sample recorded anew")
    made, kept = messages(tmp_path / name), messages(SAMPLES / name)
    assert [message[:4] for message in made] == [message[:4] for message in kept]
    assert len(kept) > 200
    for new, old in zip(made, kept, strict=True):
        np.testing.assert_allclose(new[4], old[4], rtol=0, atol=1e-6, err_msg=f"{new[0]} at {new[2]} ns")


def test_the_readme_names_every_digest() -> None:
    assert {name: digest for digest, name in DIGEST_LINE.findall(README.read_text())} == digests()


@pytest.mark.parametrize("name", LOGS)
def test_it_is_small(name: str) -> None:
    assert sum(path.stat().st_size for path in files(SAMPLES / name)) < 1_000_000
