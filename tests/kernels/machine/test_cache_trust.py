"""Machine code is run only if nobody but this user and root could have written it."""

from __future__ import annotations

import os
import pwd
import subprocess
import sys
from pathlib import Path

import pytest

from mavnav.kernels.machine import cache

NAME, CODE = "trial.f-0", b"code"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder with one sound entry."""
    monkeypatch.setenv("MAVNAV_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv(cache.PRIVATE, str(tmp_path / "private"))
    cache.write_code(NAME, CODE)
    return tmp_path / "cache" / cache.cache_key()


def test_a_sound_entry_is_read(folder: Path) -> None:
    assert cache.read_code(NAME) == CODE
    assert [path.name for path in folder.iterdir()] == [NAME]


@pytest.mark.parametrize("mode", [0o666, 0o664, 0o646], ids=oct)
def test_an_entry_that_others_may_write_is_not_run(folder: Path, mode: int) -> None:
    (folder / NAME).chmod(mode)
    assert cache.read_code(NAME) is None


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o1777], ids=oct)
def test_a_folder_that_others_may_write_is_not_used_until_it_is_mended(folder: Path, mode: int) -> None:
    folder.chmod(mode)
    assert cache.read_code(NAME) is None
    assert cache.is_kept()
    assert cache.read_code(NAME) == CODE


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root gives files away")
def test_what_another_user_owns_is_not_run_nor_written(folder: Path, tmp_path: Path) -> None:
    for path in (folder / NAME, folder):
        os.chown(path, 1234, 1234)
        assert cache.read_code(NAME) is None
        os.chown(path, 0, 0)
    os.chown(folder, 1234, 1234)
    assert not cache.is_kept()
    cache.write_code(NAME, b"new")
    assert (tmp_path / "private" / cache.cache_key() / NAME).exists()
    assert cache.read_code(NAME) == b"new"


def test_links_pipes_and_folders_are_no_entries(folder: Path, tmp_path: Path) -> None:
    """A pipe did not end the process before: it waited for a writer."""
    (folder / NAME).rename(tmp_path / "elsewhere")
    for make in (lambda p: p.symlink_to(tmp_path / "elsewhere"), os.mkfifo, Path.mkdir):
        make(folder / NAME)
        assert cache.read_code(NAME) is None
        (folder / NAME).rmdir() if (folder / NAME).is_dir() else (folder / NAME).unlink()


def test_entries_are_written_for_this_user_alone_to_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAVNAV_CACHE_DIR", str(tmp_path / "other"))
    before = os.umask(0)
    try:
        cache.write_code(NAME, CODE)
    finally:
        os.umask(before)
    assert cache.read_code(NAME) == CODE
    assert not any(path.stat().st_mode & 0o022 for path in (tmp_path / "other").glob("*/**/*"))


@pytest.mark.parametrize(
    "names",
    [{"MAVNAV_CACHE_DIR": "kernels"}, {"XDG_CACHE_HOME": ".cache"}, {"XDG_CACHE_HOME": "~nobody_here/x"}],
    ids=str,
)
@pytest.mark.skipif(sys.platform != "linux", reason="variables of Linux")
def test_no_relative_path_is_used(names: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MAVNAV_CACHE_DIR")
    for name, value in names.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(tmp_path)
    assert cache.user_directory() is None
    assert not cache.is_kept()
    assert cache.read_code(NAME) is None


@pytest.mark.skipif(sys.platform != "linux", reason="the folders of Linux")
def test_without_a_home_nothing_of_the_working_directory_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, kernels were loaded from ``./~/.cache/mavnav``."""
    monkeypatch.delenv("MAVNAV_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("HOME")
    monkeypatch.setattr(pwd, "getpwuid", lambda _: {}[0])
    monkeypatch.chdir(tmp_path)
    assert cache.user_directory() is None
    cache.write_code(NAME, b"new")
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("~")] == []


def test_the_folder_of_numba_is_not_taken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("MAVNAV_CACHE_DIR")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert cache.user_directory() != tmp_path


@pytest.mark.skipif(sys.platform != "linux", reason="prctl")
def test_memory_that_cannot_be_made_executable_is_named(repo_root: Path, tmp_path: Path) -> None:
    """It ended with exit code 70, or a segmentation fault."""
    code = (
        "import ctypes, sys\nif ctypes.CDLL(None).prctl(65, 1, 0, 0, 0): sys.exit(77)\n"
        "from mavnav import cli\ncli.main(sys.argv[1:])"
    )
    args = ["replay", repo_root / "sample_logs" / "corridor.mcap", "-o", tmp_path / "run", "--end", "1", "-q"]
    environment = {name: value for name, value in os.environ.items() if name != "MAVNAV_CACHE_DIR"}
    made = subprocess.run(
        [sys.executable, "-c", code, *args], capture_output=True, text=True, env=environment, check=False
    )
    if made.returncode == 77:
        pytest.skip("this kernel cannot deny it")
    assert (made.returncode, made.stderr.count("\n")) == (2, 1), made.stderr
    assert "executable memory" in made.stderr
