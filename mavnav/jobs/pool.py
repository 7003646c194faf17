"""The process pool: worker processes, which job each runs, and what it died of."""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections import deque
from contextlib import contextmanager, suppress
from itertools import chain
from multiprocessing import connection, get_context
from time import monotonic
from typing import TYPE_CHECKING

from mavnav.errors import ExitCode
from mavnav.jobs.records import Ended, Event, Fate, Job, Outcome, Started
from mavnav.jobs.worker import serve

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

CONTEXT = get_context("fork") if sys.platform == "linux" else get_context("spawn")
"""A forked worker shares what its parent has loaded, where a spawned one takes a second of processor time to load it.

On other systems libraries keep threads that do not survive a fork.
"""

LISTEN_S = 0.2
"""How long to listen at most before the clock is looked at."""

GRACE_S = 3.0
"""A worker that is terminated has so long to remove its unfinished files, then it is killed."""


def usable_cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def run_jobs(
    jobs: Sequence[Job],
    workers: int,
    on_event: Callable[[Event], None],
    timeout_s: float | None = None,
    memory_mb: int | None = None,
) -> list[Outcome]:
    """Run jobs in worker processes, in order, and return their outcomes in the same order.

    Parameters
    ----------
    jobs
        What to run.
    workers
        How many at the same time, 1 or more.
    on_event
        Called in this process as jobs start, progress and end. What it raises ends all workers and is passed on, as is
        any signal's exception.
    timeout_s
        A job that takes longer is killed, if given.
    memory_mb
        Data that a worker may hold, if given (Linux): beyond it an allocation fails, and with it that job.
    """
    waiting = deque(enumerate(jobs))
    outcomes: dict[int, Outcome] = {}
    pool: list[_Worker] = []
    try:
        while len(outcomes) < len(jobs):
            for event in chain(_hand_out(waiting, pool, workers, memory_mb), _listen(pool, timeout_s)):
                if isinstance(event, Ended):
                    outcomes[event.index] = event.outcome
                on_event(event)
    finally:
        _end_all(pool)
    return [outcomes[index] for index in range(len(jobs))]


def _hand_out(
    waiting: deque[tuple[int, Job]], pool: list[_Worker], workers: int, memory_mb: int | None
) -> Iterator[Event]:
    """Give a job to everyone who has none; new workers take the places of those that died."""
    pool[:] = [worker for worker in pool if worker.process.is_alive() or worker.index is not None]
    while waiting:
        idle = next((worker for worker in pool if worker.index is None), None)
        if idle is None and len(pool) == workers:
            return
        if idle is None:
            idle = _Worker(memory_mb)
            pool.append(idle)
        index, job = waiting.popleft()
        idle.give(index, job)
        yield Started(index, idle.pid)


def _listen(pool: list[_Worker], timeout_s: float | None) -> Iterator[Event]:
    """Receive the events of workers, and stop jobs whose time is over."""
    busy = {worker.channel: worker for worker in pool if worker.index is not None}
    ready = connection.wait(list(busy), LISTEN_S if timeout_s is None else min(LISTEN_S, timeout_s))
    for channel, worker in busy.items():
        if channel in ready:
            yield worker.receive()
        elif timeout_s is not None and worker.seconds > timeout_s:
            yield worker.give_up(timeout_s)


def _end_all(pool: list[_Worker]) -> None:
    """Terminate all workers at once, and kill those that remain."""
    for worker in pool:
        worker.process.terminate()
    deadline_s = monotonic() + GRACE_S
    for worker in pool:
        worker.process.join(max(deadline_s - monotonic(), 0.0))
        worker.end()


class _Worker:
    """A process, the channel to it, and the job that it runs."""

    def __init__(self, memory_mb: int | None) -> None:
        self.memory_mb = memory_mb
        self.channel, theirs = CONTEXT.Pipe()
        self.process = CONTEXT.Process(target=serve, args=(theirs, memory_mb), daemon=True)
        with _children_without_sigint():
            self.process.start()
        theirs.close()  # or the end of the worker would not be noticed
        self.pid = self.process.pid or 0
        self.index: int | None = None
        self.began_s = 0.0

    @property
    def seconds(self) -> float:
        return monotonic() - self.began_s

    def give(self, index: int, job: Job) -> None:
        self.index, self.began_s = index, monotonic()
        with suppress(OSError):  # it has just died, which `receive` finds out
            self.channel.send((index, pickle.dumps(job)))

    def receive(self) -> Event:
        """Receive one event; the end of the process is one."""
        try:
            event: Event = self.channel.recv()
        except (EOFError, OSError):
            return self._ended(Fate.DIED, self._cause())
        if isinstance(event, Ended):
            self.index = None
        return event

    def give_up(self, timeout_s: float) -> Event:
        """Stop a job that takes too long."""
        self.process.terminate()
        self.process.join(GRACE_S)
        return self._ended(Fate.TIMEOUT, f"took longer than {timeout_s:g} s")

    def end(self) -> None:
        """Make sure that the process is gone."""
        self.process.kill()
        self.process.join()
        self.channel.close()

    def _ended(self, fate: Fate, error: str) -> Ended:
        index, self.index = self.index, None
        self.end()
        return Ended(index or 0, Outcome(fate, self.pid, self.seconds, error=error, exit_code=ExitCode.BUG))

    def _cause(self) -> str:
        """Return what ended the process."""
        self.process.join(GRACE_S)
        code = self.process.exitcode
        limited = self.memory_mb is not None  # native code that gets no memory aborts
        memory = "; the memory may have run out" if limited or code == -signal.SIGKILL else ""
        if code is None or code >= 0:
            return f"its process exited with code {code}{memory}"
        return f"its process was killed by {signal.Signals(-code).name}{memory}"


@contextmanager
def _children_without_sigint() -> Iterator[None]:
    """Keep Ctrl-C, which a terminal sends to all, from processes started within: their parent ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
