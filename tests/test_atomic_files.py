"""What is written appears whole or not at all, whatever happens: the faults are provoked, not imagined."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Barrier
from typing import TYPE_CHECKING

import pytest

from mavnav import atomic_files
from mavnav.atomic_files import beside

if TYPE_CHECKING:
    from collections.abc import Iterator

WRITE = """
import sys, time
from pathlib import Path
from mavnav.atomic_files import beside
with beside(Path(sys.argv[1])) as partial:
    partial.mkdir()
    (partial / "new").write_bytes(b"x" * int(sys.argv[2]))
    print("writing", flush=True)
    time.sleep(float(sys.argv[3]))
"""


def writer(target: Path, size: int = 10, sleep_s: float = 60.0, **options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", WRITE, str(target), str(size), str(sleep_s)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)  # type: ignore[call-overload,no-any-return]


@pytest.fixture
def old(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "old").write_text("old")
    return folder


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_kill_9_leaves_the_old_output_and_the_next_run_clears_up(old: Path) -> None:
    with writer(old) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.kill()
    assert names(old) == {"old"}
    leftovers = names(old.parent) - {"run"}
    assert len(leftovers) == 1
    assert all(name.startswith(".") for name in leftovers)
    with beside(old) as partial:
        partial.mkdir()
        (partial / "new").touch()
    assert (names(old.parent), names(old)) == ({"run"}, {"new"})


def test_two_processes_that_write_the_same_do_not_touch_each_other(old: Path) -> None:
    with writer(old, sleep_s=0.5) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with beside(old) as partial:
            partial.mkdir()
        assert process.wait() == 0
    assert (names(old.parent), names(old)) == ({"run"}, {"new"})


@pytest.mark.parametrize("exchange", [True, False])
def test_a_folder_takes_the_place_of_another(old: Path, exchange: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not exchange:
        monkeypatch.setattr(atomic_files, "_swap_names", lambda one, other: False)
    with beside(old) as partial:
        partial.mkdir()
        (partial / "new").touch()
        assert names(old) == {"old"}
    assert (names(old.parent), names(old)) == ({"run"}, {"new"})


@pytest.mark.skipif(sys.platform != "linux", reason="renameat2 is Linux's")
def test_two_folders_swap_their_names_at_once(old: Path) -> None:
    new = old.with_name("new")
    new.mkdir()
    assert atomic_files._swap_names(new, old)
    assert (names(new), names(old)) == ({"old"}, set())


def test_a_target_that_a_killed_process_had_set_aside_comes_back(old: Path) -> None:
    old.rename(old.with_name(f".run.replaced-{atomic_files.machine()}-{2**22 + 1}"))
    with pytest.raises(KeyError), beside(old):
        raise KeyError
    assert (names(old.parent), names(old)) == ({"run"}, {"old"})


def test_what_a_killed_process_had_half_done_never_comes_to_life(tmp_path: Path) -> None:
    half = tmp_path / f".run.partial-{atomic_files.machine()}-{2**22 + 1}"
    (half / "run").mkdir(parents=True)
    with pytest.raises(KeyError), beside(tmp_path / "run"):
        raise KeyError
    assert names(tmp_path) == set()


def test_a_full_disk_leaves_the_old_output(old: Path) -> None:
    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    with writer(old, size=100_000, preexec_fn=small) as process:
        _, err = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "File too large" in err
    assert (names(old.parent), names(old)) == ({"run"}, {"old"})


@contextmanager
def unprivileged() -> Iterator[None]:
    """Be nobody for a while: root may write anywhere."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)


def test_a_folder_without_permission_is_an_oserror(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with unprivileged(), pytest.raises(OSError, match="Permission"), beside(tmp_path / "run"):
            pass
    finally:
        tmp_path.chmod(0o700)
    assert names(tmp_path) == set()


def test_every_file_is_brought_to_the_disk_before_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    monkeypatch.setattr(atomic_files, "sync", lambda path: synced.append(Path(path).name))
    with beside(tmp_path / "run") as partial:
        (partial / "sub").mkdir(parents=True)
        (partial / "sub" / "file").touch()
    assert synced == ["file", "sub", "run", tmp_path.name]


@pytest.mark.parametrize("command", ["replay", "convert"])
def test_the_commands_say_in_one_line_that_the_disk_is_full(command: str, repo_root: Path, tmp_path: Path) -> None:
    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    log, target = repo_root / "sample_logs" / "corridor.mcap", tmp_path / "out.mcap"
    options = {"replay": [log, "-o", target, "-q", "--end", "1"], "convert": [log, target, "-q"]}[command]
    line = [sys.executable, "-m", "mavnav", command, *map(str, options)]
    environment = {**os.environ, "PYTHONPATH": str(repo_root), "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", "")}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # else bytecode is cut at the limit
    done = subprocess.run(line, capture_output=True, text=True, preexec_fn=small, env=environment, check=False)
    assert done.returncode == 6, done.stderr
    assert done.stderr.count("\n") == 1
    assert "cannot be written" in done.stderr
    assert names(tmp_path) == set()


def test_a_stale_pid_of_a_living_process_is_left_alone(tmp_path: Path) -> None:
    alive = tmp_path / f".run.partial-{atomic_files.machine()}-{os.getppid()}"
    alive.mkdir()
    with beside(tmp_path / "run") as partial:
        partial.touch()
    assert names(tmp_path) == {"run", alive.name}
    assert time.time() - (tmp_path / "run").stat().st_mtime < 60


def test_a_file_never_takes_the_place_of_a_folder(old: Path) -> None:
    with pytest.raises(IsADirectoryError), beside(old) as partial:
        partial.write_text("a report")
    assert names(old) == {"old"}
    assert names(old.parent) == {"run"}


@pytest.mark.parametrize("pid", [os.getpid(), 2**22 + 1], ids=["ours", "nobody"])
def test_what_another_machine_is_writing_is_left_alone(pid: int, tmp_path: Path) -> None:
    theirs = tmp_path / f".run.partial-0123456789ab-{pid}"
    theirs.mkdir()
    with beside(tmp_path / "run") as partial:
        partial.touch()
    assert names(tmp_path) == {"run", theirs.name}


def test_what_another_machine_left_long_ago_is_removed(tmp_path: Path) -> None:
    theirs = tmp_path / ".run.partial-0123456789ab-7"
    theirs.mkdir()
    os.utime(theirs, (1, 1))
    (tmp_path / ".run.partial-0123456789ac-7").mkdir()
    with beside(tmp_path / "run") as partial:
        partial.touch()
    assert names(tmp_path) == {"run", ".run.partial-0123456789ac-7"}


@pytest.mark.parametrize("folder", [True, False])
def test_two_machines_on_one_target(folder: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both have the same process number; the second to finish fails and leaves the result of the first."""

    def write(text: str) -> None:
        with beside(tmp_path / "run", exclusive=True) as partial:
            file = partial / "file" if folder else partial
            file.parent.mkdir(exist_ok=True)
            file.write_text(text)
            if text == "second":
                with monkeypatch.context() as other:
                    other.setattr(atomic_files, "machine", lambda: "0123456789ab")
                    write("first")

    with pytest.raises(FileExistsError, match="another process has written it"):
        write("second")
    assert names(tmp_path) == {"run"}
    assert (tmp_path / "run" / "file" if folder else tmp_path / "run").read_text() == "first"


def test_ctrl_c_during_the_tidying_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, interrupts = atomic_files.shutil.rmtree, iter([KeyboardInterrupt(), KeyboardInterrupt()])

    def interrupted(*words: object, **options: object) -> None:
        for error in interrupts:
            raise error
        real(*words, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(atomic_files.shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt), beside(tmp_path / "run") as partial:
        partial.mkdir()
        raise KeyboardInterrupt
    assert names(tmp_path) == set()


def test_threads_that_write_one_folder_do_not_remove_each_others_files(tmp_path: Path) -> None:
    """Each took the unfinished folder of the other for one of a dead process of its number."""
    together = Barrier(3)

    def write(number: int) -> None:
        with beside(tmp_path / "run") as partial:
            partial.mkdir()
            (partial / "a").write_text(str(number))
            together.wait(20)
            (partial / "b").write_text(str(number))

    with ThreadPoolExecutor(3) as threads:
        list(threads.map(write, range(3)))
    assert (tmp_path / "run" / "a").read_text() == (tmp_path / "run" / "b").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
