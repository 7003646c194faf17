"""The digest of mavnav's own files: it decides which cached runs and which workers of a cluster are used."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavnav.jobs import run_cache


def digest_of(package: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(run_cache, "__file__", str(package / "jobs" / "run_cache.py"))
    return run_cache.source_sha256.__wrapped__()


def test_a_wheel_and_a_checkout_have_one_digest_and_other_data_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "log.py").write_text("A = 1\n")
    (tmp_path / "logs" / "definitions.msg").write_text("float32 x\n")
    checkout = digest_of(tmp_path, monkeypatch)
    for name in ("docs/cli.md", "configs/paper.yaml", "logs/__pycache__/log.pyc"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    assert digest_of(tmp_path, monkeypatch) == checkout
    (tmp_path / "logs" / "definitions.msg").write_text("float64 x\n")
    assert digest_of(tmp_path, monkeypatch) != checkout
