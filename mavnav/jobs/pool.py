"""The process pool: worker processes, the job of each, the cause of its death, and retries."""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from multiprocessing import connection, get_context
from time import monotonic

from msgspec.structs import replace

from mavnav.errors import ExitCode
from mavnav.jobs.worker import Ended, Event, Job, Outcome, Retried, Started, Status, serve

Listener = Callable[[Event], None]
Run = Callable[[Sequence[Job], Listener], Sequence[Outcome]]


CONTEXT = get_context("fork") if sys.platform == "linux" else get_context("spawn")
"""Start method of workers. A forked worker shares its parent's modules; a spawned one takes 1 s of CPU to load them.

On other systems, libraries have threads that do not survive a fork.
"""

POLL_S = 0.2
"""Maximum time to wait for events before the time limits of jobs are checked, in s."""

KILLED = -9
"""Exit code of a process that SIGKILL ended, a name that Windows lacks."""

GRACE_S = 3.0
"""Time for a terminated worker to remove its unfinished files before it is killed, in s."""


def usable_cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def run_jobs(
    jobs: Sequence[Job], workers: int, on_event: Listener, timeout_s: float | None = None, memory_mb: int | None = None
) -> list[Outcome]:
    """Run jobs in worker processes, in order, and return their outcomes in the same order.

    Parameters
    ----------
    jobs
        The jobs to run.
    workers
        Number of jobs at the same time, 1 or more.
    on_event
        Called in this process when jobs start, progress and end. An exception of it, or of a signal handler, ends all
        workers and propagates.
    timeout_s
        Time limit of a job, which is killed if it takes longer; None for no limit.
    memory_mb
        Limit on the data of a worker (Linux); None for no limit. An allocation over it fails, and with it the job.
    """
    waiting = deque(enumerate(jobs))
    outcomes: dict[int, Outcome] = {}
    pool: list[_Worker] = []
    try:
        while len(outcomes) < len(jobs):
            for event in chain(_assign_jobs(waiting, pool, workers, memory_mb), _receive_events(pool, timeout_s)):
                if isinstance(event, Ended):
                    outcomes[event.index] = event.outcome
                on_event(event)
    finally:
        _end_all(pool)
    return [outcomes[index] for index in range(len(jobs))]


def _assign_jobs(
    waiting: deque[tuple[int, Job]], pool: list[_Worker], workers: int, memory_mb: int | None
) -> Iterator[Event]:
    """Assign a job to each idle worker; start new workers up to their number, also in place of dead ones."""
    pool[:] = [worker for worker in pool if worker.process.is_alive() or worker.index is not None]
    while waiting:
        idle = next((worker for worker in pool if worker.index is None), None)
        if idle is None and len(pool) == workers:
            return
        if idle is None:
            idle = _Worker(memory_mb)
            pool.append(idle)
        index, job = waiting.popleft()
        idle.assign(index, job)
        yield Started(index, idle.pid)


def _receive_events(pool: list[_Worker], timeout_s: float | None) -> Iterator[Event]:
    """Yield the events of workers, and stop jobs that exceed their time limit."""
    busy = {worker.channel: worker for worker in pool if worker.index is not None}
    ready = connection.wait(list(busy), POLL_S if timeout_s is None else min(POLL_S, timeout_s))
    for channel, worker in busy.items():
        if channel in ready:
            yield worker.receive()
        elif timeout_s is not None and worker.seconds > timeout_s:
            yield worker.stop_late(timeout_s)


def _end_all(pool: list[_Worker]) -> None:
    """Terminate all workers, and kill those that do not end in time."""
    for worker in pool:
        worker.process.terminate()
    deadline_s = monotonic() + GRACE_S
    for worker in pool:
        worker.process.join(max(deadline_s - monotonic(), 0.0))
        worker.end()


class _Worker:
    """A process, the channel to it, and the index of its job, None if it is idle."""

    def __init__(self, memory_mb: int | None) -> None:
        self.memory_mb = memory_mb
        self.channel, theirs = CONTEXT.Pipe()
        self.process = CONTEXT.Process(target=serve, args=(theirs, memory_mb), daemon=True)
        with _block_sigint():
            self.process.start()
        theirs.close()  # otherwise the channel would not report the end of the worker
        self.pid = self.process.pid or 0
        self.index: int | None = None
        self.began_s = 0.0

    @property
    def seconds(self) -> float:
        return monotonic() - self.began_s

    def assign(self, index: int, job: Job) -> None:
        self.index, self.began_s = index, monotonic()
        with suppress(OSError):  # the worker has just died, which `receive` reports
            self.channel.send((index, pickle.dumps(job)))

    def receive(self) -> Event:
        """Return the next event of the worker; the death of its process gives one too."""
        try:
            event: Event = self.channel.recv()
        except (EOFError, OSError):
            return self._end_job(Status.DIED, self._cause())
        if isinstance(event, Ended):
            self.index = None
        return event

    def stop_late(self, timeout_s: float) -> Event:
        """Terminate the process of a job that exceeds its time limit."""
        self.process.terminate()
        self.process.join(GRACE_S)
        return self._end_job(Status.TIMEOUT, f"took longer than {timeout_s:g} s")

    def end(self) -> None:
        """Kill the process and close its channel."""
        self.process.kill()
        self.process.join()
        self.channel.close()

    def _end_job(self, status: Status, error: str) -> Ended:
        index, self.index = self.index, None
        self.end()
        return Ended(index or 0, Outcome(status, self.pid, self.seconds, error=error, exit_code=ExitCode.BUG))

    def _cause(self) -> str:
        """Return the cause of the end of the process as text."""
        self.process.join(GRACE_S)
        code = self.process.exitcode
        limited = self.memory_mb is not None  # native code aborts if an allocation fails
        memory = "; the memory may have run out" if limited or code == KILLED else ""
        if code is None or code >= 0:
            return f"its process exited with code {code}{memory}"
        return f"its process was killed by {signal.Signals(-code).name}{memory}"


@contextmanager
def _block_sigint() -> Iterator[None]:
    """Block SIGINT in processes started in this context: a terminal sends Ctrl-C to all, but their parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def run_with_retries(jobs: Sequence[Job], run: Run, on_event: Listener, tries: int) -> None:
    """Run jobs; run those whose process died again after all others, up to ``tries`` times in all.

    ``run`` runs some jobs, as `run_jobs` does. ``on_event`` gets an `Ended` for every job once, with its index in
    ``jobs``; a death before the last try is reported as `Retried`.
    """
    left = list(range(len(jobs)))
    for number in range(1, tries + 1):
        outcomes = run([jobs[k] for k in left], _renumber(left, on_event, number, tries))
        left = [k for k, outcome in zip(left, outcomes, strict=True) if outcome.status is Status.DIED]
        if not left:
            return


def _renumber(numbers: Sequence[int], on_event: Listener, number: int, tries: int) -> Listener:
    """Return a listener that replaces the index of a job in this round by its index among all jobs."""

    def listen(event: Event) -> None:
        event = replace(event, index=numbers[event.index])
        if isinstance(event, Ended) and event.outcome.status is Status.DIED:
            error = event.outcome.error
            if number < tries:
                event = Retried(event.index, error)
            elif tries > 1:
                outcome = replace(event.outcome, error=f"{error}; given up after {tries} tries")
                event = Ended(event.index, outcome)
        on_event(event)

    return listen
