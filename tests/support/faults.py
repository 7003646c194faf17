"""A simulated disk that fails at its n-th operation, and loses unsynced data at a power failure, in this process.

Operations are those below one folder: opening for writing, writing, fsync, rename and mkdir, and writing to stdout.
"""

from __future__ import annotations

import builtins
import errno
import io
import json
import os
import pickle
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

from msgspec import Struct, field

from mavnav import atomic_files, cli
from mavnav.batch import runner
from mavnav.jobs.worker import Ended, Event, Job, Outcome, Started, attempt

STDOUT = "stdout"


class Disk(Struct):
    """Counter of the operations below ``root``; operation number ``fail_at`` fails.

    A full disk fails from there on, any other error occurs once. ``lost`` are the files that were renamed before their
    content was synced, ``unsynced`` the folders whose entries changed since they were synced.
    """

    root: Path
    fail_at: int = 0
    error: int = errno.ENOSPC
    count: int = 0
    failed: str = ""
    kinds: Counter[str] = field(default_factory=Counter)
    dirty: set[tuple[int, int]] = field(default_factory=set)
    lost: list[str] = field(default_factory=list)
    unsynced: set[str] = field(default_factory=set)

    def contains(self, path: object) -> bool:
        return isinstance(path, str | os.PathLike) and Path(os.fspath(path)).absolute().is_relative_to(self.root)

    def step(self, kind: str, path: object) -> None:
        if path != STDOUT and not self.contains(path):
            return
        self.count += 1
        self.kinds[kind] += 1
        full = self.error == errno.ENOSPC and self.failed and path != STDOUT
        if self.count == self.fail_at or full:
            self.failed = self.failed or f"{kind} {path}"
            raise OSError(self.error, os.strerror(self.error), *([] if path == STDOUT else [str(path)]))

    def renamed(self, place: object) -> None:
        """Record that a file or folder was renamed to ``place``."""
        if not self.contains(place):
            return
        path = Path(str(place))
        files = [path] if path.is_file() else [inner for inner in path.rglob("*") if inner.is_file()]
        self.lost += [str(file) for file in files if _key(file.stat()) in self.dirty]
        self.unsynced.add(str(path.parent))

    def unsynced_files(self) -> list[Path]:
        """Return the files whose content was not synced."""
        return [file for file in self.root.rglob("*") if file.is_file() and _key(file.stat()) in self.dirty]

    def lose_power(self) -> None:
        """Empty every file whose content was not synced."""
        for file in self.unsynced_files():
            os.truncate(file, 0)


def _key(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


class _Raw(io.FileIO):
    """A file whose writes are operations of the disk."""

    def __init__(self, disk: Disk, path: Any, mode: str) -> None:
        super().__init__(path, mode)
        self.disk = disk
        disk.dirty.add(_key(os.fstat(self.fileno())))

    def write(self, data: Any, /) -> int:
        self.disk.step("write", self.name)
        return super().write(data)


class _Stdout(io.RawIOBase):
    """A stream that stores its output, and whose writes are operations of the disk."""

    def __init__(self, disk: Disk) -> None:
        self.disk, self.output = disk, bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:
        self.disk.step("write", STDOUT)
        self.output += data
        return len(data)


def _patches(disk: Disk) -> Iterator[Any]:
    real: dict[str, Callable[..., Any]] = {
        name: getattr(os, name) for name in ("fsync", "mkdir", "rename", "replace", "link", "open")
    }
    real_file, swapped = io.open, atomic_files._swap_names

    def open_file(file: Any, mode: str = "r", buffering: int = -1, *more: Any, **options: Any) -> Any:
        if not set(mode) & set("wax+") or not disk.contains(file):
            return real_file(file, mode, buffering, *more, **options)
        disk.step("open", file)
        raw = _Raw(disk, file, mode.replace("b", "").replace("t", ""))
        if buffering == 0:
            return raw
        buffered = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        if "b" in mode:
            return buffered
        names = ("encoding", "errors", "newline")
        return io.TextIOWrapper(buffered, **dict(zip(names, more, strict=False)) | options)

    def open_number(path: Any, flags: int, *more: Any, **options: Any) -> int:
        if flags & (os.O_CREAT | os.O_WRONLY | os.O_RDWR):
            disk.step("open", path)
        return int(real["open"](path, flags, *more, **options))

    def fsync(number: int) -> None:
        path = str(Path(f"/proc/self/fd/{number}").readlink())
        disk.step("fsync", path)
        disk.dirty.discard(_key(os.fstat(number)))
        disk.unsynced.discard(path)

    def mkdir(path: Any, *more: Any, **options: Any) -> None:
        if not Path(path).is_dir():
            disk.step("mkdir", path)
        real["mkdir"](path, *more, **options)

    def renamer(name: str) -> Callable[..., None]:
        def rename(source: Any, target: Any, **options: Any) -> None:
            disk.step("rename", target)
            real[name](source, target, **options)
            disk.renamed(target)

        return rename

    def swap(one: Path, other: Path) -> bool:
        try:
            disk.step("rename", other)
        except OSError:
            return False
        done = swapped(one, other)
        if done:
            disk.renamed(other)
        return done

    for module in (builtins, io):
        yield patch.object(module, "open", open_file)
    yield patch.object(atomic_files, "_swap_names", swap)
    yield patch.object(runner, "run_jobs", run_here)
    for name, made in {"fsync": fsync, "mkdir": mkdir, "open": open_number}.items():
        yield patch.object(os, name, made)
    for name in ("rename", "replace", "link"):
        yield patch.object(os, name, renamer(name))


def run_here(jobs: Sequence[Job], workers: int, on_event: Callable[[Event], None], *_: object) -> list[Outcome]:
    """Run jobs like `mavnav.jobs.pool.run_jobs`, but in this process."""
    outcomes = []
    for index, job in enumerate(jobs):
        on_event(Started(index, os.getpid()))
        outcomes.append(attempt(pickle.dumps(job), lambda phase, done, total: None))
        on_event(Ended(index, outcomes[-1]))
    return outcomes


@contextmanager
def failing(disk: Disk) -> Iterator[None]:
    """Redirect the file operations of this process to the disk."""
    entered: list[Any] = []
    try:
        for change in _patches(disk):
            change.__enter__()
            entered.append(change)
        yield
    finally:
        for change in reversed(entered):
            change.__exit__(None, None, None)


class End(Struct, frozen=True):
    """Result of a command: exit code, stdout and stderr."""

    code: int
    out: str
    err: str


def run_command(args: Sequence[object], disk: Disk) -> End:
    """Run one command line with the disk."""
    raw, err = _Stdout(disk), io.StringIO()
    out = io.TextIOWrapper(io.BufferedWriter(raw), "utf-8")
    with redirect_stdout(out), redirect_stderr(err), failing(disk):
        code = cli.run([str(arg) for arg in args])
        try:
            out.flush()
        except OSError:
            code = code or 6
    with suppress(OSError):
        out.detach().detach()
    return End(code, raw.output.decode(), err.getvalue())


def tree(folder: Path) -> dict[str, bytes]:
    """Return the content of all files below a folder by relative path."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


class Trial(Struct, frozen=True):
    """A command line, its output folder, and the content of that folder before and after a run without a fault."""

    name: str
    args: Sequence[object]
    folder: Path
    before: dict[str, bytes]
    after: dict[str, bytes]
    code: int
    steps: int

    def restore(self) -> None:
        """Restore the content from before the command."""
        for path in sorted(self.folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
        for name, content in self.before.items():
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / name).write_bytes(content)


def make_trial(name: str, args: Sequence[object], folder: Path) -> Trial:
    """Run a command without a fault, restore the folder, and return the trial."""
    before = tree(folder)
    disk = Disk(folder)
    end = run_command(args, disk)
    assert "a bug" not in end.err, end.err
    assert not disk.lost, f"{name}: not synced before the name: {disk.lost}"
    assert not disk.unsynced, f"{name}: not synced after the name: {disk.unsynced}"
    assert not disk.unsynced_files(), f"{name}: not synced: {disk.unsynced_files()}"
    after = tree(folder)
    trial = Trial(name, args, folder, before, after, end.code, disk.count)
    problems = list(_incomplete(trial, after))
    assert not problems, problems
    trial.restore()
    return trial


def faults_of(trial: Trial, fail_at: int, *, again: bool = True) -> list[str]:
    """Run a command with one fault, and again without it; return the problems found."""
    disk = Disk(trial.folder, fail_at, errno.EIO if fail_at % 2 else errno.ENOSPC)
    end = run_command(trial.args, disk)
    found = tree(trial.folder)
    problems = [*_end_problems(trial, end, disk, found), *_incomplete(trial, found)]
    if again:
        second = run_command(trial.args, Disk(trial.folder))
        if second.code == 6 and "exists" in second.err:
            second = run_command([*trial.args, "--force"], Disk(trial.folder))
        if second.code != trial.code:
            problems.append(f"the next run ends with {second.code}: {second.err}")
        if not trial.after.keys() <= tree(trial.folder).keys():
            problems.append("the next run is not complete")
    trial.restore()
    return [f"{trial.name}, fault {fail_at} ({disk.failed}): {problem}" for problem in problems]


def _end_problems(trial: Trial, end: End, disk: Disk, found: dict[str, bytes]) -> Iterator[str]:
    text = end.out + end.err
    if "Traceback" in text or "a bug" in text:
        yield f"a bug: {end.err}"
    if end.code not in (6, trial.code):
        yield f"exit code {end.code}: {end.err}"
    elif end.code != 6 and not trial.after.keys() <= found.keys():
        yield f"exit code {end.code}, but files are missing"
    if end.code == 6 and os.strerror(disk.error) not in text and "reads back differently" not in text:
        yield f"the reason is not named: {end.err}"
    if end.code == 6 and end.err.count("mavnav: error:") > 1:
        yield f"more than one line: {end.err}"


def _incomplete(trial: Trial, found: dict[str, bytes]) -> Iterator[str]:
    """Yield incomplete results: files that are neither the old ones nor complete, and incomplete runs."""
    for name, content in found.items():
        if any(part.startswith(".") for part in Path(name).parts):
            yield f"{name} is left over"
        elif content not in (trial.before.get(name), trial.after.get(name)) and not _is_whole(name, content):
            yield f"{name} is half-written"
    runs = {Path(name).parent for name in trial.after if name.endswith("run.json")}
    for run in runs:
        names = [{name for name in files if Path(name).parent == run} for files in (found, trial.before, trial.after)]
        if names[0] and names[0] not in names[1:]:
            yield f"{run} is incomplete"


def _is_whole(name: str, content: bytes) -> bool:
    """Return whether a file that contains times, and so differs between runs, is complete."""
    if name.endswith(".json"):
        try:
            json.loads(content)
        except ValueError:
            return False
        return True
    ends = {".html": b"</html>", ".csv": b"\n", ".md": b"\n", ".xml": b">", ".png": b"IEND\xaeB`\x82"}
    return content.rstrip(b"\n" if not name.endswith((".csv", ".md")) else b"").endswith(
        ends.get(Path(name).suffix, b"\0never")
    )


def spread(steps: int, count: int) -> list[int]:
    """Return ``count`` of the numbers 1 to ``steps``, evenly spaced, including the first and the last."""
    if count >= steps:
        return list(range(1, steps + 1))
    return sorted({1 + round(k * (steps - 1) / max(count - 1, 1)) for k in range(count)})


def trials(folder: Path, log: Path, names: Sequence[str] = ()) -> Iterator[Trial]:
    """Yield a trial of every command, or of those in ``names``, each in a folder of its own.

    `check` and `metrics` read the result of the trial "replay --force".
    """
    short = ("-q", "--end", "0.3", "--online", "--grid", "5x5", "--azimuth", "6")
    run, old, target, flight, cells, several = (
        folder / name for name in ("replay", "forced", "convert", "simulate", "batch", "compare")
    )
    files = ("--junit", cells / "b.xml", "--summary", cells / "b.md", "--baseline", cells / "b.json")
    record = ("--record", flight / "log.mcap", "--set", "max_steps=3")
    lines: dict[str, tuple[Path, Sequence[object]]] = {
        "config": (folder / "config", ["config", "show"]),
        "convert": (target, ["convert", log, target / "out.mcap", "-q"]),
        "replay": (run, ["replay", log, "-o", run / "out", *short]),
        "replay --force": (old, ["replay", log, "-o", old / "out", *short, "--force", "--report"]),
        "check": (old, ["check", old / "out", "--gate", "map.accepted_share>=0"]),
        "metrics": (old, ["metrics", old / "out"]),
        "simulate": (flight, ["simulate", "corner", "-o", flight / "out", "-q", *record]),
        "batch": (cells, ["batch", log, "-o", cells / "out", *short, *files, "--update-baseline"]),
        "compare": (several, ["compare", log, "-o", several / "out", *short, "--grid", "4x4"]),
    }
    old.mkdir()
    run_command(["replay", log, "-o", old / "out", *short, "--end", "0.2"], Disk(old))
    for name in names or lines:
        place, args = lines[name]
        place.mkdir(exist_ok=True)
        yield make_trial(name, args, place)
