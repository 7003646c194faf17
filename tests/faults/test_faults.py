"""A disk that fails or loses power leaves whole results, the right exit code and one line."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

import pytest

from mavnav import atomic_files
from mavnav.atomic_files import beside
from support.faults import Disk, failing, faults_of, make_trial, spread, tree, trials

FAULTS = {"config": 1, "convert": 9, "replay --force": 2, "check": 1, "metrics": 1, "simulate": 1, "batch": 2}
"""How many operations fail per command; benchmarks/fuzz_faults.py lets all of them fail."""


@pytest.mark.slow
def test_a_failing_disk_leaves_whole_results(repo_root: Path, tmp_path: Path) -> None:
    log = repo_root / "sample_logs" / "corridor.mcap"
    for trial in trials(tmp_path, log, list(FAULTS)):
        again = trial.name == "convert"
        faults = spread(trial.steps - 1, FAULTS[trial.name]) if trial.steps > 1 else [1]
        assert [text for fail_at in faults for text in faults_of(trial, fail_at, again=again)] == []


def write(folder: Path, text: str) -> None:
    with beside(folder / "run") as partial:
        partial.mkdir()
        (partial / "run.json").write_text(text)


@pytest.mark.parametrize("full", [errno.ENOSPC, errno.EIO])
def test_every_operation_of_a_folder_may_fail(full: int, tmp_path: Path) -> None:
    write(tmp_path, "old")
    disk = Disk(tmp_path)
    with failing(disk):
        write(tmp_path, "old")
    assert set(disk.kinds) == {"mkdir", "open", "write", "fsync", "rename"}
    for fail_at in range(1, disk.count + 1):
        disk = Disk(tmp_path, fail_at, full)
        with failing(disk):
            try:
                write(tmp_path, "new")
            except OSError:
                expected = {b"old", b"new"} if disk.failed.startswith("fsync") else {b"old"}
            else:
                expected = {b"new"}
        assert set(tree(tmp_path)) == {"run/run.json"}, disk.failed
        assert tree(tmp_path)["run/run.json"] in expected, disk.failed
        write(tmp_path, "old")


def test_no_empty_folder_is_left(tmp_path: Path) -> None:
    """A folder of several runs exists once one of them does."""
    target = tmp_path / "runs" / "score"
    disk = Disk(target.parent)
    with failing(disk):
        write(target, "")
    left = []
    for fail_at in range(1, disk.count + 1):
        shutil.rmtree(target.parent)
        disk = Disk(target.parent, fail_at)
        with failing(disk), pytest.raises(OSError, match="No space left"):
            write(target, "")
        left += [disk.failed.split()[0]] * any(tmp_path.iterdir())
        write(target, "")
    assert left == ["fsync"]  # of the folder that has the whole run already


def test_a_loss_of_power_keeps_the_old_or_the_new(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(tmp_path)
    with failing(disk):
        write(tmp_path, "new")
    assert (disk.lost, disk.unsynced) == ([], set())
    disk.lose_power()
    assert tree(tmp_path) == {"run/run.json": b"new"}
    monkeypatch.setattr(atomic_files, "sync_all", lambda path: None)
    with failing(disk):
        write(tmp_path, "newer")
    assert disk.lost == [str(tmp_path / "run" / "run.json")]
    disk.lose_power()
    assert tree(tmp_path) == {"run/run.json": b""}


def test_machine_code_that_is_lost_with_the_power_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mavnav.kernels.machine import cache as _cache

    monkeypatch.setenv("MAVNAV_CACHE_DIR", str(tmp_path))
    _cache.write_code("kernel-1", b"code")
    assert _cache.read_code("kernel-1") == b"code"
    (tmp_path / _cache.cache_key() / "kernel-1").write_bytes(b"")
    assert _cache.read_code("kernel-1") is None


def test_a_write_in_place_would_be_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test of the test: a command that writes to the place itself."""
    target = tmp_path / "x.json"

    def careless(args: object, **_: object) -> int:
        target.write_text("[1, 2, 3]")
        return 0

    monkeypatch.setattr("mavnav.cli.run", careless)
    with pytest.raises(AssertionError, match="not synced"):
        make_trial("careless", [], tmp_path)
