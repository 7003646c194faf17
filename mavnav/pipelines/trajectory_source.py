"""Where a trajectory that is scored comes from, as it is named on the command line: a file, the log, a program.

A program that writes a trajectory of a log is run with a time limit, its output kept, its cost measured.
"""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from subprocess import DEVNULL, PIPE, STDOUT
from threading import Timer
from time import perf_counter
from typing import IO, Final

from msgspec import Struct
from msgspec.structs import replace

from mavnav.config.option_kinds import recorded_topic
from mavnav.errors import UsageError, reason_of
from mavnav.ground_truth.references import SWEEPS
from mavnav.outputs.files.finished_run import finished_run
from mavnav.profiling import MAXRSS_MB

LASER: Final = "laser"
RUN_POSES: Final = "trajectory.tum"
MERGED_POSES: Final = "session_*.tum"
WHOLE: Final = "whole"
"""Where in a sweep the pose holds at which the scan as recorded fits best."""


class TrajectorySource(Struct, frozen=True):
    """Where a trajectory comes from: ``in_log`` is a topic or ``tf:MAP,FRAME`` of the log, else ``path`` is a file.

    Poses of a file are those of ``frame``. With the stamp of a scan they hold at its beam ``pose_at``, or for the
    ``whole`` scan as recorded.
    """

    name: str
    text: str
    frame: str = ""
    pose_at: str = WHOLE

    @property
    def in_log(self) -> str | None:
        """The topic or the frames of the log; None for a file."""
        return recorded_topic(self.text)

    @property
    def path(self) -> Path:
        """The file; that of the poses in a run directory. Raises UsageError for a merge, which has several."""
        path = Path(self.text)
        if not (path / RUN_POSES).exists() and (sessions := sorted(path.glob(MERGED_POSES))):
            names = " or ".join(map(str, sessions))
            raise UsageError(f"{path} is a merge, with a trajectory of each session; name {names}")
        return path / RUN_POSES if path.is_dir() else path


def read_source(text: str) -> TrajectorySource:
    """Read ``[NAME=]FILE[,FRAME]``, ``[NAME=]topic:/T`` or ``[NAME=]tf:MAP,FRAME``, and after ``@`` where poses hold.

    Raises UsageError for a name that cannot be that of a directory.
    """
    name, has_name, source = text.partition("=")
    source = source if has_name else text
    before, _, at = source.rpartition("@")
    source, at = (before, at) if at in {*SWEEPS, WHOLE} else (source, _usual_instant(Path(source)))
    if recorded_topic(source) is not None:
        frame = ""
        name = name if has_name else source.rpartition("/")[2].replace(":", "_")
    else:
        file, _, after = source.rpartition(",")
        source, frame = (file, after) if file and not Path(source).exists() else (source, LASER)
        name = name if has_name else Path(source).stem
    if not name or Path(name).name != name:
        raise UsageError(f"--trajectory {text!r}: {name!r} names no directory; write NAME=FILE with a plain name")
    return TrajectorySource(name, source, frame, at)


def _usual_instant(path: Path) -> str:
    """Return where poses hold if nothing is said: those of a run in causal mode at mid-sweep."""
    if not (path / "run.json").is_file():
        return WHOLE
    return WHOLE if finished_run(path).record.config.final_pass else "middle"


LOG, OUT = "{log}", "{out}"


class Program(Struct, frozen=True):
    """A command by its name: the words ``{log}`` and ``{out}`` stand for the log and the trajectory to be written."""

    name: str
    command: str

    def with_absolute_paths(self) -> Program:
        """Return the same command for any folder: its words that name files have their whole paths."""
        words = (str(Path(word).absolute()) if Path(word).is_file() else word for word in shlex.split(self.command))
        return replace(self, command=shlex.join(words))

    def key(self) -> list[str]:
        """Return the words of the command, in place of files the SHA-256 of their content."""
        words = map(Path, shlex.split(self.command))
        return [hashlib.sha256(word.read_bytes()).hexdigest() if word.is_file() else str(word) for word in words]


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


_WAIT: Final = """
import json, os, signal, sys, _thread
def end_with_parent():
    os.read(0, 1)
    os.killpg(0, signal.SIGKILL)
_thread.start_new_thread(end_with_parent, ())
files = [(os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0), (os.POSIX_SPAWN_DUP2, 2, 1)]
try:
    _, status, used = os.wait4(os.posix_spawnp(sys.argv[1], sys.argv[1:], os.environ, file_actions=files), 0)
    told = [os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss]
except OSError as error:
    told = error.strerror
os.write(1, json.dumps(told).encode())
os._exit(0)
"""
"""What starts a program and waits for it, in a small process of its own.

The memory of a process counts from that of the one which starts it. The program also ends when mavnav dies.
"""


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
            process = _start(words, printed)
        except OSError as error:
            return _not_started(words[0], reason_of(error))

        def stop() -> None:
            stopped.append(True)
            _kill(process)

        timer = Timer(limit_s, stop)
        timer.start()
        with process:
            try:
                said = process.stdout.read() if process.stdout else b""
                code = process.wait()
            finally:
                timer.cancel()
                _kill(process)
    told = json.loads(said or "null")
    if isinstance(told, str):
        return _not_started(words[0], told)
    code, cpu_s, memory = told or (code, None, None)
    problem = f"it ended with code {code}" if code else "" if out.is_file() else "it wrote no trajectory"
    problem = f"it took over {limit_s:g} s" if stopped else problem
    kept = f"; see {out.with_suffix('.txt')}" if problem else ""
    return ProgramCost(perf_counter() - started_s, cpu_s, memory and memory * MAXRSS_MB, problem + kept)


def _start(words: Sequence[str], printed: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start a program; raises OSError. Where the system can tell what it took, `_WAIT` prints that when it has ended.

    Otherwise only its exit code is known.
    """
    if hasattr(os, "wait4"):
        helper = (sys.executable, "-I", "-S", "-c", _WAIT, *words)
        return subprocess.Popen(helper, stdin=PIPE, stdout=PIPE, stderr=printed, start_new_session=True)  # noqa: S603
    return subprocess.Popen(words, stdin=DEVNULL, stdout=printed, stderr=STDOUT)  # noqa: S603  the user typed it


def _not_started(word: str, why: str) -> ProgramCost:
    return ProgramCost(0.0, None, None, f"{word} cannot be started: {why}")


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a program and all processes that it started."""
    if not hasattr(os, "killpg"):
        process.kill()
        return
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:  # all have ended
        return
