"""Programs of others are measured by themselves, whatever mavnav takes, and do not outlive it."""

from __future__ import annotations

import fcntl
import os
import sys
import time
from multiprocessing import get_context
from typing import TYPE_CHECKING

import pytest

from mavnav.pipelines.trajectory_source import Program, run_program

if TYPE_CHECKING:
    from pathlib import Path

needs_wait4 = pytest.mark.skipif(not hasattr(os, "wait4"), reason="this system does not say what a process took")


@needs_wait4
@pytest.mark.parametrize("taken_mb", [0, 60])
def test_memory_is_that_of_the_program_and_not_of_this_process(tmp_path: Path, taken_mb: int) -> None:
    held = bytearray(200 * 10**6)
    code = f"taken = bytearray({taken_mb}*10**6); open('{{out}}', 'w').close()"
    cost = run_program(Program("p", f'{sys.executable} -S -c "{code}"'), tmp_path / "log", tmp_path / "out.tum", 60.0)
    assert cost.problem == ""
    assert (tmp_path / "out.txt").read_bytes() == b""  # what starts it says nothing
    assert cost.peak_memory_mb is not None
    assert taken_mb < cost.peak_memory_mb < taken_mb + 40 < len(held) / 1e6


@needs_wait4
def test_a_program_ends_with_the_process_that_runs_it(tmp_path: Path) -> None:
    code = f"import fcntl, time; f = open('{tmp_path}/held', 'w'); fcntl.flock(f, fcntl.LOCK_EX); "
    code += "print('held', flush=True); time.sleep(60); '{out}'"
    program = Program("p", f'{sys.executable} -S -c "{code}"')
    runner = get_context("spawn").Process(target=run_program, args=(program, tmp_path, tmp_path / "out.tum", 60.0))
    runner.start()
    while not ((tmp_path / "out.txt").is_file() and (tmp_path / "out.txt").read_text()):
        assert runner.is_alive()
        time.sleep(0.05)
    runner.kill()
    runner.join()
    killed_s = time.monotonic()
    with (tmp_path / "held").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # waits for the end of the program
    assert time.monotonic() - killed_s < 20.0
