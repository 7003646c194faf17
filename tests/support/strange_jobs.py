"""Jobs for the tests of worker processes; a module of its own, because workers import them by name."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

from mavnav.errors import NoScansError
from mavnav.jobs.dask import in_cluster


def square(x: int, report) -> int:
    report("squaring", 1, 2)
    return x * x


def who(report) -> int:
    return os.getpid()


def kill_itself(report) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def leave(report) -> None:
    os._exit(3)


def refuse(report) -> None:
    raise NoScansError("empty.bag: no scans; choose another")


def blunder(report) -> None:
    raise ZeroDivisionError("x")


def shout(report) -> str:
    print("on stdout", flush=True)
    print("on stderr", file=sys.stderr, flush=True)
    os.write(1, b"raw")
    return "said"


def hang(report) -> None:
    time.sleep(60)


def devour(megabytes: int, report) -> int:
    return len(bytearray(megabytes * 2**20))


def hold(megabytes: int, report) -> int:
    """Keep memory that is written to for as long as Dask takes to notice."""
    block = b"x" * (megabytes * 2**20)
    time.sleep(2.0)
    return len(block)


def sleep_with_a_file(path: Path, report) -> None:
    """Create a file, sleep, and remove the file in any case."""
    path.write_text(str(os.getpid()))
    try:
        report("sleeping", 0, None)
        time.sleep(60)
    finally:
        path.unlink()


def kill_the_first(mark: Path, report) -> str:
    """Kill the first process that runs this job."""
    if not mark.exists():
        mark.touch()
        kill_itself(report)
    return "done"


def report_for_ever(report) -> None:
    for count in range(10**6):
        report("waiting", count, None)
        time.sleep(0.01)


def where(report) -> str:
    return str(Path.cwd())


def is_elsewhere(report) -> bool:
    return in_cluster()
