"""Execution of a command line in a forked child with limits of time and memory, and checks of the result."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256
from pathlib import Path

from msgspec import Struct

from mavnav import cli

MAX_CPU_S = 20
MAX_WALL_S = 300.0  # high, because a busy machine must not count as a hang
MAX_MEMORY_BYTES = 1 << 30
GUARD_BYTES = 4 << 30
CODES = {0, 1, 2, 3, 4, 5, 6}
COUNTED = ("traceback", "exit 70", "crash", "hang", "slow", "memory", "altered inputs", "files outside")


class End(Struct, frozen=True):
    """Result of a child: exit code, or minus the signal; stderr; CPU time, s; memory in addition to its parent's."""

    code: int
    err: str
    cpu_s: float
    memory_bytes: int
    timed_out: bool


def run_forked(work: Callable[[], int], folder: Path) -> End:
    """Run ``work`` in a child whose current folder is ``folder``; its streams are files next to that folder."""
    before = _private_bytes()
    streams = [folder.with_name(f"{folder.name}.{name}") for name in ("out", "err")]
    child = os.fork()
    if child == 0:
        _be_child(work, folder, streams)
    deadline_s, timed_out = time.monotonic() + MAX_WALL_S, False
    while True:
        ended, status, usage = os.wait4(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() > deadline_s and not timed_out:
            timed_out = True
            os.kill(child, signal.SIGKILL)
        time.sleep(0.001)
    err = streams[1].read_text(errors="replace")
    more = max(usage.ru_maxrss * 1024 - before, 0)
    return End(os.waitstatus_to_exitcode(status), err, usage.ru_utime + usage.ru_stime, more, timed_out)


def _private_bytes() -> int:
    """Return the private resident memory, which a forked child has from the start, without file pages."""
    resident, shared = (int(pages) for pages in Path("/proc/self/statm").read_text().split()[1:3])
    return (resident - shared) * resource.getpagesize()


def _be_child(work: Callable[[], int], folder: Path, streams: Sequence[Path]) -> None:
    code = 99
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S + 1, MAX_CPU_S + 2))
        resource.setrlimit(resource.RLIMIT_DATA, (GUARD_BYTES, GUARD_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for number, path in enumerate(streams, 1):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.stdout = os.fdopen(1, "w", errors="backslashreplace")
        sys.stderr = os.fdopen(2, "w", errors="backslashreplace")
        os.chdir(folder)
        code = work()
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        import traceback

        traceback.print_exc(file=sys.stderr)
        sys.stderr.flush()
    finally:
        os._exit(code)


def state(folder: Path) -> dict[str, str]:
    """Return mode, size and hash of all files in a folder, except in ``out``."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name.partition("/")[0] != "out":
            about, regular = path.lstat(), path.is_file() and not path.is_symlink()
            content = sha256(path.read_bytes()).hexdigest() if regular and about.st_size < 1 << 26 else ""
            found[name] = f"{about.st_mode} {about.st_size if regular else 0} {content}"
    return found


def problems(args: Sequence[str], folder: Path) -> tuple[End, list[str]]:
    """Run ``mavnav args`` in a folder; return its result, and the problems that no input may cause.

    Only ``out`` in the folder may be written, and nothing may remain in the temporary folder.
    """
    temporary = folder.with_name(f"{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    before = state(folder)

    def work() -> int:
        tempfile.tempdir = str(temporary)
        return cli.run(args)

    end = run_forked(work, folder)
    found = list(_wrong(end))
    now = state(folder)
    if {name: now.get(name) for name in before} != before:
        found.append("altered inputs")
    if outside := [*(now.keys() - before.keys()), *(path.name for path in temporary.iterdir())]:
        found.append(f"files outside: {outside[:3]}")
    return end, found


def _wrong(end: End) -> Iterator[str]:
    if end.timed_out:
        yield "hang"
    elif end.code == -signal.SIGXCPU or end.cpu_s > MAX_CPU_S:
        yield "slow"
    elif end.code == 70:
        yield "exit 70"
    elif end.code not in CODES:
        yield f"crash: {end.code}"
    if "Traceback" in end.err:
        yield "traceback"
    if end.memory_bytes > MAX_MEMORY_BYTES:
        yield "memory"


def table_row(name: str, counts: Counter[str]) -> str:
    """Return a line of a table with the number of problems of each kind."""
    return f"{name:16s}{counts['inputs']:6d} inputs  " + "  ".join(f"{what} {counts[what]}" for what in COUNTED)
