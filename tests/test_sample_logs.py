"""The sample log is what its generator writes, and is as small as its README says."""

from __future__ import annotations

import hashlib
import runpy
from typing import TYPE_CHECKING

from mcap.reader import NonSeekingReader

if TYPE_CHECKING:
    from pathlib import Path


def messages(path: Path) -> list[tuple[str, int, bytes]]:
    with path.open("rb") as stream:
        reader = NonSeekingReader(stream)
        return [(channel.topic, m.log_time, m.data) for _, channel, m in reader.iter_messages(log_time_order=False)]


def test_made_again_it_holds_the_same_messages(repo_root: Path, tmp_path: Path) -> None:
    generator = runpy.run_path(str(repo_root / "sample_logs" / "make_sample.py"))
    generator["write_sample"](tmp_path / "room.mcap")
    kept = messages(repo_root / "sample_logs" / "room.mcap")
    assert len(kept) > 500
    assert messages(tmp_path / "room.mcap") == kept


def test_readme_names_its_digest_and_it_is_small(repo_root: Path) -> None:
    log = repo_root / "sample_logs" / "room.mcap"
    assert hashlib.sha256(log.read_bytes()).hexdigest() in (log.parent / "README.md").read_text()
    assert log.stat().st_size < 1_000_000
