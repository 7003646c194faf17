"""Programs that write a trajectory of a log: run with a time limit, their output kept, their cost measured."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
from threading import Timer
from time import perf_counter
from typing import TYPE_CHECKING

from msgspec import Struct

from mavnav.errors import UsageError, reason_of
from mavnav.profiling import MAXRSS_MB

if TYPE_CHECKING:
    from pathlib import Path

LOG, OUT = "{log}", "{out}"


class Program(Struct, frozen=True):
    """A command by its name: the words ``{log}`` and ``{out}`` stand for the log and the trajectory to be written."""

    name: str
    command: str


class ProgramCost(Struct, frozen=True):
    """What a program took, all its processes: by the clock and of the processor, s, and the memory of the largest, MB.

    ``problem`` says why it gave no trajectory, empty where it did. Unknown numbers are None.
    """

    wall_s: float
    cpu_s: float | None
    peak_memory_mb: float | None
    problem: str


def read_program(text: str) -> Program:
    """Read ``NAME=COMMAND``; raises UsageError for a command without ``{out}``, or that a shell could not split."""
    name, _, command = text.partition("=")
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise UsageError(f"--external {text!r} cannot be split into words: {error}; mend its quotes") from error
    if not name.replace("-", "").replace("_", "").replace(".", "").isalnum():
        raise UsageError(f"--external {text!r}: {name!r} names no directory; write NAME='command {LOG} {OUT}'")
    if not any(OUT in word for word in words):
        raise UsageError(f"--external {text!r}: the command has no {OUT}, the trajectory that it writes; add it")
    return Program(name, command)


def run_program(program: Program, log: Path, out: Path, limit_s: float) -> ProgramCost:
    """Run a program, without a shell, in a group of processes that ends with it or after ``limit_s``.

    What it prints is kept beside ``out``, with the suffix ``.txt``. Nothing that it does raises an error.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    out.unlink(missing_ok=True)
    values = {LOG: str(log.absolute()), OUT: str(out.absolute())}
    words = [word.replace(LOG, values[LOG]).replace(OUT, values[OUT]) for word in shlex.split(program.command)]
    started_s, stopped = perf_counter(), []
    with out.with_suffix(".txt").open("wb") as printed:
        try:
            process = subprocess.Popen(  # noqa: S603  the user typed it
                words, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.STDOUT, start_new_session=True
            )
        except OSError as error:
            return ProgramCost(0.0, None, None, f"{words[0]} cannot be started: {reason_of(error)}")

        def stop() -> None:
            stopped.append(True)
            _kill(process)

        timer = Timer(limit_s, stop)
        timer.start()
        try:
            code, cpu_s, memory_mb = _wait(process)
        finally:
            timer.cancel()
            _kill(process)
    problem = f"it ended with code {code}" if code else "" if out.is_file() else "it wrote no trajectory"
    problem = f"it took over {limit_s:g} s" if stopped else problem
    kept = f"; see {out.with_suffix('.txt')}" if problem else ""
    return ProgramCost(perf_counter() - started_s, cpu_s, memory_mb, problem + kept)


def _wait(process: subprocess.Popen[bytes]) -> tuple[int, float | None, float | None]:
    """Return exit code, processor time, s, and largest memory, MB, of a process; None where the system has neither."""
    if not hasattr(os, "wait4"):
        return process.wait(), None, None
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss * MAXRSS_MB


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a program and all processes that it started."""
    if not hasattr(os, "killpg"):
        process.kill()
        return
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:  # all have ended
        return
