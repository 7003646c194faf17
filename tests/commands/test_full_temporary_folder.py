"""A full temporary folder is named as that, and no log or output is blamed."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from errno import EDQUOT, EIO, ENOSPC
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import mavnav as api
from mavnav.atomic_files import beside, temporary_folder
from mavnav.errors import ExitCode, OutputError
from support.log_files import drive, write_bag2, write_mcap, write_zstd

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@pytest.fixture
def full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Have a temporary folder of 12 kB; skip where this process may not mount one."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=12k", "none", str(folder)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("no file system can be mounted")
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def run_full(mavnav: Callable, full: Path, *args: object) -> None:
    code, out, err = mavnav(*args, "-q")
    assert (code, out) == (ExitCode.OUTPUT, "")
    assert err == f"mavnav: error: the temporary folder {full} is full; set TMPDIR to another\n"
    assert list(full.iterdir()) == []


@pytest.mark.slow
def test_of_merge_and_simulate(mavnav: Callable, sample: Path, tmp_path: Path, full: Path) -> None:
    run_full(mavnav, full, "merge", sample, sample, "-o", tmp_path / "m")
    run_full(mavnav, full, "simulate", "corner", "--set", "max_steps=12", "-o", tmp_path / "s")
    assert [path.name for path in tmp_path.iterdir()] == ["tmp"]


@pytest.mark.parametrize("command", ["info", "replay", "convert"])
def test_of_logs_that_are_decompressed(
    mavnav: Callable, sample: Path, tmp_path: Path, full: Path, command: str
) -> None:
    log = write_zstd(tmp_path / "a.mcap.zst", sample)
    run_full(mavnav, full, command, log, *([tmp_path / "b.mcap"] if command == "convert" else []))


def test_of_a_cut_database(mavnav: Callable, tmp_path: Path, full: Path) -> None:
    (database,) = write_bag2(tmp_path / "bag", drive(200)).glob("*.db3")
    (tmp_path / "cut.db3").write_bytes(database.read_bytes()[:40_000])
    run_full(mavnav, full, "info", tmp_path / "cut.db3")


def test_of_the_python_interface(sample: Path, full: Path) -> None:
    with pytest.raises(OutputError, match=f"the temporary folder {full} is full"):
        api.replay(sample, end_s=1)


@pytest.mark.parametrize("number", [ENOSPC, EDQUOT])
def test_an_error_without_a_file_is_of_the_temporary_folder(number: int) -> None:
    with pytest.raises(OutputError, match=f"the temporary folder {tempfile.gettempdir()} is full"), temporary_folder():
        raise OSError(number, os.strerror(number))


def test_another_full_disk_is_another(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No space left") as raised, temporary_folder(), beside(tmp_path / "a"):
        raise OSError(ENOSPC, os.strerror(ENOSPC))
    assert raised.value.filename == str(tmp_path.resolve() / "a")


def test_other_errors_stay_what_they_are() -> None:
    with pytest.raises(OSError, match="output error"), temporary_folder() as folder, beside(folder / "a"):
        raise OSError(EIO, os.strerror(EIO))


def test_without_a_temporary_folder(mavnav: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    log = write_zstd(tmp_path / "a.mcap.zst", write_mcap(tmp_path / "a.mcap", drive(3)))
    code, _, err = mavnav("info", log)
    assert code == ExitCode.OUTPUT
    assert err == (
        "mavnav: error: no temporary folder can be made: No such file or directory; set TMPDIR to one with room\n"
    )
