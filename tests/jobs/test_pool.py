"""Worker processes: results, every way to die, the clock, the memory, and the end of it all."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest

from mavnav.errors import ExitCode
from mavnav.jobs.pool import run_jobs, run_with_retries, usable_cores
from mavnav.jobs.worker import Ended, Event, Job, Outcome, Progressed, Retried, Started, Status, failure
from mavnav.logs.content import reading
from support import strange_jobs as strange


def run(*jobs: Job, workers: int = 1, **limits: float) -> list[Outcome]:
    return run_jobs(jobs, workers, lambda event: None, **limits)  # type: ignore[arg-type]


def forked_mb() -> int:
    """Return the data of this process, in MB: a forked worker holds it too, and other tests may have left much."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(status["VmData"].split()[0]) // 1024


def gone(pid: int) -> bool:
    """Wait until a process has ended."""
    deadline_s = time.monotonic() + 10
    while time.monotonic() < deadline_s:
        stat = Path(f"/proc/{pid}/stat")
        if not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z":
            return True
        time.sleep(0.05)
    return False


def test_a_system_without_masks_of_signals_runs_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavnav.jobs.pool.signal", SimpleNamespace(Signals=signal.Signals))  # as on Windows
    assert [outcome.value for outcome in run(Job("a", strange.square, (3,)))] == [9]
    (dead,) = run(Job("b", strange.leave, ()))
    assert "its process exited with code 3" in dead.error


def test_results_come_in_the_order_of_the_jobs() -> None:
    events: list[Event] = []
    outcomes = run_jobs([Job(str(k), strange.square, (k,)) for k in range(5)], 2, events.append)
    assert [outcome.value for outcome in outcomes] == [0, 1, 4, 9, 16]
    assert {outcome.status for outcome in outcomes} == {Status.DONE}
    for k in range(5):
        kinds = [type(event) for event in events if event.index == k]
        assert kinds == [Started, Progressed, Ended]
    assert {outcome.pid for outcome in outcomes} == {e.pid for e in events if isinstance(e, Started)}


def test_no_jobs_start_nobody() -> None:
    assert run(workers=4) == []


def test_a_worker_runs_one_job_after_another() -> None:
    first, second = run(Job("a", strange.who), Job("b", strange.who))
    assert first.value == second.value != os.getpid()


def test_a_crash_costs_its_own_job_alone() -> None:
    killed, refused, left, blundered, good = run(
        Job("killed", strange.kill_itself),
        Job("refused", strange.refuse),
        Job("left", strange.leave),
        Job("blundered", strange.blunder),
        Job("good", strange.square, (3,)),
    )
    assert (killed.status, killed.exit_code) == (Status.DIED, ExitCode.BUG)
    assert killed.error == "its process was killed by SIGKILL; the memory may have run out"
    assert (left.status, left.error) == (Status.DIED, "its process exited with code 3")
    assert (refused.status, refused.exit_code) == (Status.FAILED, ExitCode.NO_SCANS)
    assert refused.error == "empty.bag: no scans; choose another"
    assert (blundered.exit_code, blundered.error) == (ExitCode.BUG, "a bug: ZeroDivisionError: x")
    assert (good.status, good.value) == (Status.DONE, 9)
    assert good.pid == blundered.pid != killed.pid


def test_the_clock_stops_a_job_that_hangs() -> None:
    hung, good = run(Job("hung", strange.hang), Job("good", strange.square, (2,)), timeout_s=2.0)
    assert (hung.status, hung.error) == (Status.TIMEOUT, "took longer than 2 s")
    assert 2.0 <= hung.seconds < 10.0
    assert good.value == 4
    assert gone(hung.pid)


@pytest.mark.skipif(sys.platform != "linux", reason="RLIMIT_DATA counts mapped memory on Linux alone")
def test_what_ends_for_want_of_memory_says_that_there_was_a_limit() -> None:
    """Native code that gets no memory ends its process, in whatever way."""
    (left,) = run(Job("left", strange.leave), memory_mb=forked_mb() + 300)
    assert left.error == "its process exited with code 3; the memory may have run out"


@pytest.mark.skipif(sys.platform != "linux", reason="RLIMIT_DATA counts mapped memory on Linux alone")
def test_memory_is_limited() -> None:
    jobs = Job("greedy", strange.devour, (900,)), Job("modest", strange.devour, (1,))
    greedy, modest = run(*jobs, memory_mb=forked_mb() + 300)
    said = "it needs more memory than it may use; allow more with --memory-mb"
    assert (greedy.status, greedy.error, greedy.exit_code) == (Status.FAILED, said, ExitCode.BUG)
    assert modest.value == 2**20
    (allowed,) = run(jobs[0], memory_mb=forked_mb() + 1500)
    assert allowed.status is Status.DONE


def unmapped() -> OSError:
    """Return what llvmlite raises where its library is refused memory."""
    error = OSError("Could not find/load shared object file 'libllvmlite.so'")
    error.__context__ = OSError("libllvmlite.so: failed to map segment from shared object")
    return error


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.ENOMEM, "Cannot allocate memory", "a.bag"),
        ImportError("a.so: failed to map segment from shared object"),
        SystemError("error return without exception set"),
        SystemError("<function f> returned NULL without setting an exception"),
        unmapped(),
    ],
)
def test_a_lack_of_memory_is_no_bug(error: Exception) -> None:
    outcome = failure(error, 0.0)
    assert (outcome.error, outcome.exit_code) == ("it needs more memory than it may use", ExitCode.USAGE)
    other = failure(ImportError("no module named a"), 0.0)
    assert (other.error, other.exit_code) == ("a bug: ImportError: no module named a", ExitCode.BUG)


def test_a_log_that_cannot_be_opened_for_want_of_memory_is_not_unreadable() -> None:
    with pytest.raises(MemoryError), reading(Path("a.bag")):
        raise OSError(errno.ENOMEM, "Cannot allocate memory")


def test_workers_say_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(Job("loud", strange.shout))[0].value == "said"
    assert capfd.readouterr() == ("", "")


def test_what_the_listener_raises_ends_the_workers(tmp_path: Path) -> None:
    pids = []

    def listen(event: Event) -> None:
        if isinstance(event, Started):
            pids.append(event.pid)
        if isinstance(event, Progressed):
            raise KeyError("enough")

    with pytest.raises(KeyError, match="enough"):
        run_jobs([Job("long", strange.sleep_with_a_file, (tmp_path / "unfinished",))], 1, listen)
    assert not (tmp_path / "unfinished").exists()
    assert gone(pids[0])


def test_workers_follow_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    file = tmp_path / "unfinished"
    script.write_text(
        textwrap.dedent(f"""
        import pathlib, sys
        sys.path.insert(0, {str(Path(__file__).parents[1])!r})
        from support import strange_jobs
        from mavnav.jobs.pool import run_jobs
        from mavnav.jobs.worker import Job
        if __name__ == "__main__":
            job = Job("long", strange_jobs.sleep_with_a_file, (pathlib.Path({str(file)!r}),))
            run_jobs([job], 1, lambda event: print(event, flush=True))
        """)
    )
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    while "Progressed" not in parent.stdout.readline():
        pass
    worker = int(file.read_text())
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    assert gone(worker)
    assert not file.exists()


def test_usable_cores() -> None:
    assert 1 <= usable_cores() <= (os.cpu_count() or 1)


JOBS = [Job(name, print) for name in ("good", "unlucky", "hopeless", "refused")]


def crew(rounds: list[list[str]]) -> Callable[[Sequence[Job], Callable[[Event], None]], list[Outcome]]:
    """Return a stand-in for `run_jobs`: the hopeless one always dies, the unlucky one in its first round."""

    def run(jobs: Sequence[Job], on_event: Callable[[Event], None]) -> list[Outcome]:
        rounds.append([job.name for job in jobs])
        outcomes = []
        for k, job in enumerate(jobs):
            dies = job.name == "hopeless" or (job.name == "unlucky" and len(rounds) == 1)
            status = Status.DIED if dies else Status.FAILED if job.name == "refused" else Status.DONE
            outcomes.append(Outcome(status, 1, 0.0, error="killed" if dies else ""))
            on_event(Started(k, 1))
            on_event(Ended(k, outcomes[-1]))
        return outcomes

    return run


def test_only_the_dead_are_tried_again() -> None:
    rounds: list[list[str]] = []
    events: list[Event] = []
    run_with_retries(JOBS, crew(rounds), events.append, 3)
    assert rounds == [["good", "unlucky", "hopeless", "refused"], ["unlucky", "hopeless"], ["hopeless"]]
    ended = {event.index: event.outcome for event in events if isinstance(event, Ended)}
    assert [ended[k].status for k in range(4)] == [Status.DONE, Status.DONE, Status.DIED, Status.FAILED]
    assert ended[2].error == "killed; given up after 3 tries"
    assert [e for e in events if isinstance(e, Retried)] == [Retried(k, "killed") for k in (1, 2, 2)]
    assert [e.index for e in events if isinstance(e, Started)] == [0, 1, 2, 3, 1, 2, 2]


def test_a_single_try() -> None:
    rounds: list[list[str]] = []
    events: list[Event] = []
    run_with_retries(JOBS[2:3], crew(rounds), events.append, 1)
    assert rounds == [["hopeless"]]
    assert isinstance(events[-1], Ended)
    assert events[-1].outcome.error == "killed"


def test_nothing_to_do() -> None:
    run_with_retries([], lambda jobs, listen: [], lambda event: None, 3)
