"""Devices, FIFOs and the streams of the process are written into; they are never replaced by files."""

from __future__ import annotations

import json
import os
import socket
import stat
import subprocess
import sys
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, BinaryIO

import pytest

from mavnav.atomic_files import beside
from mavnav.cli import run
from mavnav.errors import ExitCode
from support.changed_rooms import mapped, rooms, saved

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

NULL, FULL = os.makedev(1, 3), os.makedev(1, 7)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    Path("logs/a.mcap").touch()
    return tmp_path


@pytest.fixture
def device(here: Path) -> Callable[[str, int], Path]:
    """Make private nodes of devices; skip where this process may not."""

    def made(name: str, number: int) -> Path:
        try:
            os.mknod(name, stat.S_IFCHR | 0o666, number)
            Path(name).open("wb").close()
        except PermissionError:
            pytest.skip("no node of a device can be made or opened")
        return Path(name)

    return made


class Reader(Thread):
    """Reads a new FIFO to its end."""

    def __init__(self, path: Path) -> None:
        super().__init__(daemon=True)
        self.path, self.read = path, b""
        os.mkfifo(path)
        self.start()

    def run(self) -> None:
        self.read = self.path.read_bytes()

    def end(self) -> bytes:
        self.join(10)
        assert not self.is_alive()
        assert stat.S_ISFIFO(self.path.stat().st_mode)
        return self.read


def test_files_of_a_batch(mavnav: Callable, here: Path) -> None:
    junit, summary = Reader(here / "junit"), Reader(here / "summary")
    assert mavnav("batch", "logs", "--junit", "junit", "--summary", "summary", "-q")[0] == ExitCode.NO_SCANS
    assert b"<testsuite" in junit.end()
    assert b"mavnav" in summary.end()


def test_a_device_stays_a_device(mavnav: Callable, device: Callable) -> None:
    nowhere = device("null", NULL)
    for _ in range(2):
        assert mavnav("batch", "logs", "--junit", nowhere, "--summary", nowhere, "-q")[0] == ExitCode.NO_SCANS
    assert nowhere.is_char_device()


def test_a_device_that_is_full(mavnav: Callable, device: Callable) -> None:
    full = device("full", FULL)
    code, _, err = mavnav("batch", "logs", "--summary", full, "-q")
    assert code == ExitCode.OUTPUT
    assert err.startswith(f"mavnav: error: {full} cannot be written: No space left on device")
    assert full.is_char_device()


def test_pictures_and_pages_need_neither_force_nor_a_suffix(mavnav: Callable, here: Path) -> None:
    run = saved(mapped(rooms()), here / "a")
    picture, page = Reader(here / "picture"), Reader(here / "page")
    assert mavnav("diff", run, run, "-o", "picture", "--report", "page", "-q")[0] == 0
    assert picture.end().startswith(b"\x89PNG")
    assert page.end().startswith(b"<!doctype html>")


def test_recordings_and_animations(mavnav: Callable, here: Path) -> None:
    log, film = Reader(here / "a.mcap"), Reader(here / "a.gif")
    words = ("--set", "max_steps=8", "--outputs", "trajectory", "-o", "run", "-q")
    assert mavnav("simulate", "corner", "--record", "a.mcap", "--animate", "a.gif", *words)[0] == ExitCode.GATE_FAILED
    assert log.end().startswith(b"\x89MCAP")
    assert film.end().startswith(b"GIF")


@contextmanager
def stdout_into(out: BinaryIO) -> Iterator[None]:
    """Let descriptor 1 of this process be a file, and print into it, as for a process that a shell starts."""
    before = os.dup(1)
    os.dup2(out.fileno(), 1)
    try:
        with open(1, "w", closefd=False) as stream, redirect_stdout(stream):
            yield
    finally:
        os.dup2(before, 1)
        os.close(before)


@pytest.mark.parametrize("append", [False, True])
@pytest.mark.parametrize("name", ["/dev/stdout", "/proc/self/fd/1", "out.txt"])
def test_stdout_of_the_process_is_continued(here: Path, name: str, append: bool) -> None:
    """Also where it is a file: the verdict, which comes later, is not lost."""
    Path("out.txt").write_text("before\n")
    with Path("out.txt").open("ab" if append else "wb") as out, stdout_into(out):
        assert run(["batch", "logs", "--summary", name, "-q"]) == ExitCode.NO_SCANS
    text = Path("out.txt").read_text()
    assert text.startswith("before\n") == append
    assert text.splitlines()[-1] == "0 of 1 runs passed, 1 could not be made; runs/batch/batch.html"
    assert "mavnav batch\n" in text


def test_stdout_may_be_a_pipe(here: Path) -> None:
    command = [sys.executable, "-m", "mavnav", "batch", "logs", "--summary", "/dev/stdout", "-q"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "1 could not be made" in done.stdout


@pytest.mark.parametrize(
    "option", [("batch", "logs", "--junit"), ("batch", "logs", "--summary"), ("diff", "a", "a", "-o")]
)
def test_a_socket_is_refused(mavnav: Callable, here: Path, option: tuple[str, ...]) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("s.png")
        code, out, err = mavnav(*option, "s.png", "-q")
    assert (code, out) == (ExitCode.OUTPUT, "")
    assert err == "mavnav: error: s.png is a socket or a block device; name a file\n"
    assert Path("s.png").is_socket()


def test_what_fails_writes_nothing_into_a_fifo(here: Path) -> None:
    reader = Reader(here / "fifo")

    def fail() -> None:
        with beside(Path("fifo")) as partial:
            partial.write_text("half")
            raise ValueError

    with pytest.raises(ValueError, match=r"^$"):
        fail()
    Path("fifo").write_bytes(b"end")  # so that the reader ends
    assert reader.end() == b"end"
    assert {path.name for path in here.iterdir()} == {"fifo", "logs"}


def test_the_document_of_a_calibration(mavnav: Callable, here: Path, sample: Path) -> None:
    found = Reader(here / "found")
    code, _, _ = mavnav("calibrate", sample, "-o", "found", "-q")
    assert json.loads(found.end())["exit_code"] == code


def test_nothing_is_sent_and_no_port_is_opened(mavnav, sample, tmp_path, monkeypatch) -> None:
    """Not one socket is made, whatever it would be for: no telemetry, no check for updates."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a socket is made")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr("_socket.socket", refuse)
    run_directory = tmp_path / "run"
    assert mavnav("info", sample)[0] == 0
    assert mavnav("replay", sample, "-o", run_directory, "--end", "1", "-q")[0] == 0
    for words in (("metrics", run_directory), ("check", run_directory), ("diff", run_directory, run_directory)):
        assert mavnav(*words)[0] == 0
