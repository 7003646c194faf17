"""Small logs written for the tests of the command line, and the command itself."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from mavnav.cli import run

Mavnav = Callable[..., "tuple[int, str, str]"]


@pytest.fixture
def mavnav(capsys: pytest.CaptureFixture[str]) -> Mavnav:
    """Run a command line in this process; returns exit code, stdout, stderr."""

    def call(*args: object) -> tuple[int, str, str]:
        code = run([str(a) for a in args])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def spawn() -> Callable[..., subprocess.Popen[str]]:
    """Start a command line as a process of its own, with pipes."""

    def start(*args: object, **env: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "mavnav", *map(str, args)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | env,
        )

    return start


@pytest.fixture(scope="session")
def sample(repo_root: Path) -> Path:
    return repo_root / "sample_logs" / "corridor.mcap"


@pytest.fixture(scope="session")
def make_log(tmp_path_factory: pytest.TempPathFactory, sample: Path) -> Callable[..., Path]:
    """Copy messages of the sample log into new ones: topics renamed, left out, or repeated; in many chunks.

    After ``blind_after`` scans the ranges are random, as if the laser saw nothing it knows.
    """
    from mcap.reader import NonSeekingReader

    def blind(data: bytes, rng: np.random.Generator) -> bytes:
        """Replace the ranges of a LaserScan in CDR; they lie before its empty intensities."""
        beams = 681
        return data[: -4 * beams - 4] + rng.uniform(0.3, 5.0, beams).astype("<f4").tobytes() + data[-4:]

    def make(name: str, blind_after: int | None = None, **renamed: list[str]) -> Path:
        path = tmp_path_factory.mktemp("logs") / name
        with sample.open("rb") as source, path.open("wb") as sink:
            writer = Writer(sink, chunk_size=64 * 1024)
            writer.start(profile="ros2")
            channels: dict[str, int] = {}
            reader = NonSeekingReader(source)
            rng, scans = np.random.default_rng(1), 0
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                scans += channel.topic == "/scan"
                data = message.data
                if blind_after is not None and channel.topic == "/scan" and scans > blind_after:
                    data = blind(data, rng)
                for topic in renamed.get(channel.topic.strip("/"), [channel.topic]):
                    if topic not in channels:
                        schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                        channels[topic] = writer.register_channel(topic, channel.message_encoding, schema_id)
                    writer.add_message(channels[topic], message.log_time, data, message.publish_time)
            writer.finish()
        return path

    return make
