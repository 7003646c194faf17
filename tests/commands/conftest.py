"""Small logs written for the tests of the command line, and the command itself."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mavnav.cli import run
from support.log_files import copy_messages

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
def make_log(tmp_path_factory: pytest.TempPathFactory, repo_root: Path) -> Callable[..., Path]:
    """Copy messages of the sample log, up to a last scan, into new ones: topics renamed, left out, or repeated.

    After ``blind_after`` scans the ranges are random, as if the laser saw nothing it knows.
    """

    def blind(data: bytes, rng: np.random.Generator) -> bytes:
        """Replace the ranges of a LaserScan in CDR; they lie before its empty intensities."""
        beams = 681
        return data[: -4 * beams - 4] + rng.uniform(0.3, 5.0, beams).astype("<f4").tobytes() + data[-4:]

    def make(name: str, blind_after: int | None = None, last: int = 42, **renamed: list[str]) -> Path:
        path, rng = tmp_path_factory.mktemp("logs") / name, np.random.default_rng(1)

        def change(topic: str, scans: int, data: bytes) -> bytes:
            seen = blind_after is None or topic != "/scan" or scans <= blind_after
            return data if seen else blind(data, rng)

        def topics(topic: str, scans: int) -> list[str]:
            return renamed.get(topic.strip("/"), [topic]) if scans <= last else []

        copy_messages(repo_root / "sample_logs" / "corridor.mcap", path, topics, change)
        return path

    return make
