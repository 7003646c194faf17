"""A small batch over good and bad logs, made once; the tests copy it."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from support.small_batch import batch


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory, sample: Path) -> Path:
    """Return a folder with logs (good, cut, empty) and the batch over them in ``runs/batch``."""
    home = tmp_path_factory.mktemp("batches")
    logs = home / "logs"
    logs.mkdir()
    shutil.copy(sample, logs / "good.mcap")
    content = sample.read_bytes()
    (logs / "cut.mcap").write_bytes(content[: len(content) // 2])
    (logs / "empty.mcap").write_bytes(b"")
    before = Path.cwd()
    os.chdir(home)
    try:
        batch()
    finally:
        os.chdir(before)
    return home


@pytest.fixture
def home(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Be in a copy of it."""
    copy = Path(shutil.copytree(finished, tmp_path / "home"))
    monkeypatch.chdir(copy)
    return copy


@pytest.fixture
def document(home: Path) -> dict[str, Any]:
    """Return batch.json of the batch there."""
    loaded: dict[str, Any] = json.loads(Path("runs/batch/batch.json").read_text())
    return loaded
