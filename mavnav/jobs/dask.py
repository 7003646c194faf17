"""Jobs on a Dask cluster: the scheduler assigns them, and reassigns the jobs of a lost worker.

Needs ``mavnav[cluster]``. Workers need the same version of mavnav, and the same folders under the same paths. A worker
runs one job at a time, in its own process and the folder of the caller. Dask runs a job that killed its worker on
another one, a few times at most.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, chdir, contextmanager
from logging import CRITICAL, getLogger
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import NamedTemporaryFile
from threading import Lock
from time import monotonic, sleep
from typing import Any, Final
from urllib.parse import urlsplit
from uuid import uuid4

from msgspec import Struct
from msgspec.structs import asdict, replace

from mavnav.errors import ExitCode, UsageError
from mavnav.jobs.pool import POLL_S, Listener, run_with_retries
from mavnav.jobs.run_cache import source_sha256
from mavnav.jobs.worker import Ended, Event, Job, Outcome, Progressed, Reporter, Started, Status, attempt, failure
from mavnav.units import pluralize
from mavnav.version import __version__

LOCAL: Final = "local"
"""Name of a scheduler that is started on this machine, with workers, and ends with the batch."""

LOCAL_SETTINGS: Final = {"worker.profile.enabled": False, "admin.tick.interval": "1s", "nanny.pre-spawn-environ": {}}
"""Settings of Dask for such workers: they do not watch themselves 100 times a second, nor return memory at once."""

CONNECT_S: Final = 20.0
"""Maximum time to wait for a scheduler, and for its first worker, in s."""


class Cluster(Struct, frozen=True):
    """A scheduler whose workers have been checked; ``dashboard`` is the address of its web pages."""

    client: Any
    dashboard: str

    @property
    def workers(self) -> int:
        """Current number of workers."""
        return len(self.client.nthreads())

    def run_jobs(self, jobs: Sequence[Job], on_event: Listener, timeout_s: float | None = None) -> None:
        """Run jobs on the cluster; ``on_event`` gets the events of `run_with_retries`.

        Dask runs the jobs of a lost worker again, and counts the failure against every job that was assigned to it. So
        there are never more unfinished jobs than workers, and jobs that Dask gave up are run once more, one at a time.
        An exception of ``on_event`` cancels the jobs that have not begun, and propagates. Raises UsageError if the
        scheduler is lost.
        """
        max_jobs = iter((None, 1))
        run_with_retries(jobs, lambda some, listen: self._round(some, listen, timeout_s, next(max_jobs)), on_event, 2)

    def _round(
        self, jobs: Sequence[Job], on_event: Listener, timeout_s: float | None, max_jobs: int | None
    ) -> list[Outcome]:
        """Run jobs, ``max_jobs`` at a time, or one per worker if that is None."""
        topic = f"mavnav-{uuid4()}"
        context = JobContext(*our_version(), str(Path.cwd()), topic, timeout_s)
        received: SimpleQueue[Any] = SimpleQueue()
        self.client.subscribe_topic(topic, lambda event: received.put(Progressed(*event[1]["progress"])))
        under_way, outcomes = dict[int, _Submitted](), dict[int, Outcome]()
        waiting = list(enumerate(jobs))[::-1]
        try:
            while len(outcomes) < len(jobs):
                while waiting and len(under_way) < (max_jobs or max(self._count(), 1)):
                    index, job = waiting.pop()
                    under_way[index] = self._submit(index, job, context, received)
                    on_event(Started(index, 0))
                for event in _events(received, under_way):
                    if isinstance(event, Ended):
                        del under_way[event.index]
                        outcomes[event.index] = event.outcome
                    on_event(event)
        finally:
            self.client.cancel([job.future for job in under_way.values()])
            self.client.unsubscribe_topic(topic)
        return [outcomes[index] for index in range(len(jobs))]

    def _count(self) -> int:
        try:
            return self.workers
        except OSError as error:
            raise UsageError("the scheduler is gone; start it again and call again: what is finished stays") from error

    def _submit(self, index: int, job: Job, context: JobContext, received: SimpleQueue[Any]) -> _Submitted:
        key = f"{job.name} {uuid4().hex[:8]}"
        future = self.client.submit(run_on_worker, index, pickle.dumps(job), asdict(context), key=key, pure=False)
        future.add_done_callback(lambda _: received.put(index))
        return _Submitted(future, monotonic())


class _Submitted(Struct, frozen=True):
    future: Any
    began_s: float


def _events(received: SimpleQueue[Any], under_way: dict[int, _Submitted]) -> Iterator[Event]:
    """Yield the next event of a running job; yield nothing if none arrives within ``POLL_S``."""
    try:
        item = received.get(timeout=POLL_S)
    except Empty:
        return
    if isinstance(item, Progressed):
        if item.index in under_way:
            yield item
    elif item in under_way and under_way[item].future.status == "lost":  # with its worker: Dask runs the job again
        sleep(POLL_S)
        received.put(item)
    elif item in under_way:
        yield Ended(item, _outcome(under_way[item]))


def _outcome(job: _Submitted) -> Outcome:
    """Return the outcome of a job; for a dead worker, with the error that Dask reports."""
    from distributed.scheduler import KilledWorker  # noqa: PLC0415  an extra

    future = job.future
    if future.status == "finished":
        outcome: Outcome = future.result()
        return outcome
    if future.status != "error":
        raise UsageError("the scheduler is gone; start it again and call again: what is finished stays")
    error = future.exception()
    if isinstance(error, KilledWorker):
        count = error.allowed_failures + 1
        memory = "if the memory ran out, allow more: --memory-mb, or dask worker --memory-limit"
        last = error.last_worker.address
        status, text = Status.DIED, f"{pluralize(count, 'worker')} died of it, the last {last}; {memory}"
    else:
        status, text = Status.FAILED, f"its worker could not run it: {type(error).__name__}: {error}"
    return Outcome(status, 0, monotonic() - job.began_s, error=text, exit_code=ExitCode.BUG)


@contextmanager
def connect(scheduler: str, directory: Path, workers: int, memory_mb: int | None, tries: int) -> Iterator[Cluster]:
    """Connect to a scheduler, or start one with ``workers`` on this machine for `LOCAL`, and check its workers.

    Parameters
    ----------
    scheduler
        Its address, ``tcp://HOST:PORT``, or `LOCAL`.
    directory
        The directory of the results, which every worker must be able to access.
    workers, memory_mb, tries
        For `LOCAL`: the number of workers, the memory limit of each, and the number of attempts per job.

    Raises
    ------
    UsageError
        ``mavnav[cluster]`` is not installed, the scheduler does not answer, or a worker has no mavnav, another version,
        or no access to the directory.
    """
    distributed = _import_distributed()
    with _silence(), ExitStack() as stack:
        try:
            address = scheduler
            if scheduler == LOCAL:
                address = stack.enter_context(_start_local(workers, memory_mb, tries))
            else:
                _check_scheduler(address)
            client = stack.enter_context(distributed.Client(address, timeout=CONNECT_S, set_as_default=False))
            client.wait_for_workers(1, timeout=CONNECT_S)
        except (OSError, ValueError, TypeError, RuntimeError) as error:  # the last two: certificates are missing
            advice = "start one with `dask scheduler`, and `dask worker ADDRESS` where the work is to be done"
            if scheduler.startswith("tls://"):
                advice = "name authority, certificate and key in Dask's settings, distributed.comm.tls"
            raise UsageError(f"{scheduler}: no scheduler with workers answers; {advice}") from error
        _check_workers(client, directory)
        yield Cluster(client, client.dashboard_link)


@contextmanager
def _silence() -> Iterator[None]:
    """Keep the tracebacks that Dask logs for a lost scheduler from stderr; what is raised says that it is lost."""
    levels = {logger: logger.level for logger in map(getLogger, ("distributed", "distributed.client"))}
    for logger in levels:
        logger.setLevel(CRITICAL)
    try:
        yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)


def _check_scheduler(address: str) -> None:
    """Raise UsageError where something else than a scheduler answers, or says nothing; a client would wait for ever."""
    import asyncio  # noqa: PLC0415  it takes long to load

    from distributed.comm import connect  # noqa: PLC0415  an extra
    from distributed.security import Security  # noqa: PLC0415  an extra

    async def greet() -> None:
        comm = await connect(address, timeout=CONNECT_S, **Security().get_connection_args("client"))
        await comm.close()

    try:
        asyncio.run(asyncio.wait_for(greet(), CONNECT_S + POLL_S))
    except (MemoryError, TimeoutError) as error:  # the text of a web server is read as a length of petabytes
        advice = "is this the port of its dashboard? Name that of the scheduler, such as tcp://HOST:8786"
        raise UsageError(f"no Dask scheduler answers at {address}; {advice}") from error


@contextmanager
def _start_local(workers: int, memory_mb: int | None, tries: int) -> Iterator[Any]:
    """Start a scheduler with workers on this machine; yield the cluster."""
    import dask  # noqa: PLC0415  an extra

    distributed = _import_distributed()
    memory = "auto" if memory_mb is None else memory_mb * 2**20
    settings = LOCAL_SETTINGS | {"scheduler.allowed-failures": tries - 1}
    with (
        dask.config.set({f"distributed.{name}": value for name, value in settings.items()}),
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            memory_limit=memory,
            silence_logs=CRITICAL,
            dashboard_address="127.0.0.1:0",
        ) as cluster,
    ):
        yield cluster


def _import_distributed() -> Any:  # noqa: ANN401  a module
    try:
        import distributed  # noqa: PLC0415  an extra
    except ImportError as error:
        raise UsageError("a cluster needs Dask; pip install 'mavnav[cluster]'") from error
    return distributed


def _check_workers(client: Any, directory: Path) -> None:  # noqa: ANN401  a client of dask
    """Raise UsageError for workers without mavnav, with another version, or without access to the directory."""
    directory.mkdir(parents=True, exist_ok=True)
    ours = our_version()
    with NamedTemporaryFile(dir=directory, prefix=".seen-") as file:
        versions = client.run(our_version, on_error="return")
        seen = client.run(os.path.isfile, str(Path(file.name).absolute()), on_error="return")
    reasons = {worker: _incompatibility(version, seen.get(worker), ours) for worker, version in versions.items()}
    if problems := [f"{worker}: {why}" for worker, why in reasons.items() if why]:
        advice = f"install mavnav {ours[0]} there, and share the folder"
        raise UsageError(f"{'; '.join(problems)}: {advice}, or stop these workers")


def _incompatibility(version: Any, seen: Any, ours: tuple[str, str]) -> str:  # noqa: ANN401  what a worker answered
    if isinstance(version, ImportError | AttributeError):
        return "the worker has no mavnav, or one without clusters"
    if isinstance(version, Exception):
        return f"the worker cannot be asked ({version})"
    if tuple(version) != ours:
        same = " of other sources" if version[0] == ours[0] else ""
        return f"the worker has mavnav {version[0]}{same}, not {ours[0]}"
    return "" if seen is True else "the worker does not see the directory of the results"


REPORT_PERIOD_S = 0.5
"""Minimum time between two progress reports of a worker, in s."""

_ONE_AT_A_TIME = Lock()
"""Prevents concurrent jobs: the current folder, memory and drawing state are shared by all threads of a process."""


class JobContext(Struct, frozen=True):
    """Context of a job: the required version of mavnav, the current folder, and the time limit.

    Progress is sent to ``topic``.
    """

    version: str
    modules_sha256: str
    folder: str
    topic: str
    timeout_s: float | None = None


def our_version() -> tuple[str, str]:
    """Return the version of mavnav in this process, and the hash of its modules."""
    return __version__, source_sha256()


def in_cluster() -> bool:
    """Return whether this thread runs a job of a scheduler on another machine."""
    if "distributed" not in sys.modules:
        return False
    from distributed import get_worker  # noqa: PLC0415  an extra

    try:
        scheduler = urlsplit(get_worker().scheduler.address)
    except ValueError:
        return False
    return scheduler.scheme != "inproc" and scheduler.hostname not in {"127.0.0.1", "::1", "localhost"}


def run_on_worker(index: int, packed: bytes, context: dict[str, Any]) -> Outcome:
    """Run one job in this process."""
    began_s = monotonic()
    try:
        return _run(index, packed, JobContext(**context))
    except Exception as error:
        return failure(error, began_s)


def _run(index: int, packed: bytes, context: JobContext) -> Outcome:
    if our_version() != (context.version, context.modules_sha256):
        raise UsageError(f"a worker has another mavnav ({__version__}); install {context.version} there")
    from distributed import get_worker  # noqa: PLC0415  an extra

    def send(progress: Progressed) -> None:
        get_worker().log_event(context.topic, {"progress": list(asdict(progress).values())})

    with _ONE_AT_A_TIME, chdir(context.folder):
        report = Reporter(index, send, REPORT_PERIOD_S, context.timeout_s)
        outcome = attempt(packed, report)
    if report.late and outcome.status is Status.FAILED:
        return replace(outcome, status=Status.TIMEOUT, error=f"took longer than {context.timeout_s:g} s")
    return outcome
