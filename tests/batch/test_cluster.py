"""Jobs on a Dask cluster: the same outcomes as here; lost workers cost nothing, and what kills them is named."""

from __future__ import annotations

import logging
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

from mavnav.batch.options import BatchOptions, request_of
from mavnav.batch.runner import plan_batch, run_batch
from mavnav.errors import ExitCode, UsageError
from mavnav.jobs import dask as cluster_client
from mavnav.jobs.dask import LOCAL, Cluster, _incompatibility, connect, in_cluster
from mavnav.jobs.worker import Ended, Event, Job, Outcome, Progressed, Started, Status
from support import strange_jobs
from support.small_batch import OPTIONS

distributed = pytest.importorskip("distributed", reason="the extra mavnav[cluster]")

TRIES = 2


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    """Return a cluster of one worker in this process: quick."""
    with (
        distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as local,
        distributed.Client(local, set_as_default=False) as client,
    ):
        yield Cluster(client, "")


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with connect(LOCAL, tmp_path_factory.mktemp("shared"), 2, None, TRIES) as found:
        yield found


def wait_until(holds: Callable[[], bool]) -> None:
    until_s = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < until_s
        time.sleep(0.01)


def ignore(event: Event) -> None:
    """Hear nothing."""


def outcomes_of(cluster: Cluster, jobs: list[Job], on_event=ignore, **more) -> list[Outcome]:
    ended: dict[int, Outcome] = {}

    def hear(event: Event) -> None:
        if isinstance(event, Ended):
            assert event.index not in ended
            ended[event.index] = event.outcome
        on_event(event)

    cluster.run_jobs(jobs, hear, **more)
    return [ended[index] for index in range(len(jobs))]


def test_outcomes_come_in_order_and_events_as_they_happen(cluster: Cluster, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    events: list[Event] = []
    jobs = [Job("square", strange_jobs.square, (7,)), Job("refuse", strange_jobs.refuse)]
    jobs += [Job("blunder", strange_jobs.blunder), Job("where", strange_jobs.where)]
    outcomes = outcomes_of(cluster, jobs, events.append)
    assert [outcome.status for outcome in outcomes] == [Status.DONE, Status.FAILED, Status.FAILED, Status.DONE]
    assert outcomes[0].value == 49
    assert (outcomes[1].exit_code, outcomes[1].error) == (ExitCode.NO_SCANS, "empty.bag: no scans; choose another")
    assert outcomes[2].exit_code == ExitCode.BUG
    assert outcomes[3].value == str(tmp_path)
    for kind in (Started, Ended):
        assert sorted(event.index for event in events if isinstance(event, kind)) == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("scheduler", "elsewhere"),
    [("tcp://10.0.0.1:8786", True), ("tls://head.example.org:8786", True), ("tcp://127.0.0.1:8786", False)],
)
def test_a_scheduler_on_another_machine_is_noticed(
    cluster: Cluster, scheduler: str, elsewhere: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not in_cluster()
    assert outcomes_of(cluster, [Job("here", strange_jobs.is_elsewhere)])[0].value is False
    monkeypatch.setattr(
        distributed, "get_worker", lambda: SimpleNamespace(scheduler=SimpleNamespace(address=scheduler))
    )
    assert in_cluster() is elsewhere


@pytest.mark.slow
def test_a_result_that_is_lost_with_its_worker_is_made_again(processes: Cluster) -> None:
    client = processes.client

    def lose_the_result(event: Event) -> None:
        if isinstance(event, Started):
            (state,) = client.futures.values()
            wait_until(lambda: state.status == "finished")
            client.run(os._exit, 3, on_error="ignore")
            wait_until(lambda: state.status == "lost")

    (outcome,) = outcomes_of(processes, [Job("square", strange_jobs.square, (7,))], lose_the_result)
    assert (outcome.status, outcome.value) == (Status.DONE, 49)


@pytest.mark.slow
def test_a_lost_worker_costs_nothing_and_what_kills_workers_is_named(processes: Cluster, tmp_path: Path) -> None:
    jobs = [Job(f"good {x}", strange_jobs.square, (x,)) for x in range(3)]
    jobs[1:1] = [Job("bad", strange_jobs.kill_itself), Job("unlucky", strange_jobs.kill_the_first, (tmp_path / "x",))]
    outcomes = outcomes_of(processes, jobs)
    assert [outcome.status for outcome in outcomes] == [Status.DONE, Status.DIED, Status.DONE, Status.DONE, Status.DONE]
    assert re.fullmatch(
        rf"{TRIES} workers died of it, the last tcp://127.0.0.1:\d+; if the memory .*; given up after 2 tries",
        outcomes[1].error,
    )
    assert outcomes[1].exit_code == ExitCode.BUG
    assert outcomes[2].value == "done"


@pytest.mark.slow
def test_a_job_that_is_killed_for_its_memory_ends_where_more_is_allowed(tmp_path: Path) -> None:
    job, outcomes = Job("hungry", strange_jobs.hold, (400,)), []
    for memory_mb in (400, 2000):
        with connect(LOCAL, tmp_path, 1, memory_mb, 1) as cluster:
            outcomes += outcomes_of(cluster, [job])
    assert [outcome.status for outcome in outcomes] == [Status.DIED, Status.DONE]
    assert "allow more: --memory-mb, or dask worker --memory-limit" in outcomes[0].error


@pytest.mark.slow
def test_a_worker_that_is_started_with_a_limit_keeps_it(repo_root: Path, tmp_path: Path) -> None:
    modules = os.environ | {"PYTHONPATH": f"{repo_root}{os.pathsep}{repo_root / 'tests'}"}
    with distributed.LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as scheduler:
        command = [sys.executable, "-m", "dask", "worker", scheduler.scheduler_address, "--memory-limit", "1.5GB"]
        with subprocess.Popen([*command, "--no-dashboard"], stderr=subprocess.DEVNULL, env=modules) as worker:
            try:
                with connect(scheduler.scheduler_address, tmp_path, 1, None, 1) as cluster:
                    (limit,) = [each["memory_limit"] for each in cluster.client.scheduler_info()["workers"].values()]
                    (outcome,) = outcomes_of(cluster, [Job("square", strange_jobs.square, (3,))])
            finally:
                worker.terminate()
    assert (limit, outcome.value) == (1_500_000_000, 9)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="only Linux lists the sockets")
def test_the_pages_of_a_local_scheduler_are_for_this_machine_alone(processes: Cluster) -> None:
    """They were open to the network."""
    port = f"{urlsplit(processes.dashboard).port:04X}"
    rows = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    listening = {row[1] for row in rows if row[3] == "0A" and row[1].endswith(f":{port}")}
    assert listening == {f"0100007F:{port}"}


def test_a_job_that_takes_too_long(cluster: Cluster) -> None:
    events: list[Event] = []
    outcome = outcomes_of(cluster, [Job("slow", strange_jobs.report_for_ever)], events.append, timeout_s=0.6)[0]
    assert (outcome.status, outcome.error) == (Status.TIMEOUT, "took longer than 0.6 s")
    assert any(isinstance(event, Progressed) and event.phase == "waiting" for event in events)


def files(directory: Path) -> dict[str, str]:
    """Return the hashes of what a run leaves, but for the clock's."""
    return {
        f"{path.parent.name}/{path.name}": sha256(path.read_bytes()).hexdigest()
        for name in ("trajectory.*", "map.*", "hits.npz", "wall_thickness.png", "result.mcap")
        for path in sorted(directory.glob(f"cells/*/{name}"))
    }


def test_a_batch_has_the_same_bytes_as_one_made_here(cluster: Cluster, home: Path) -> None:
    planned = plan_batch(request_of(BatchOptions(**OPTIONS, directory=Path("runs/there"))), lambda *args: None)
    document = run_batch(planned, ignore, lambda row: None, cluster)
    assert [row["exit_code"] for row in document["cells"]] == [3, 4, 0, 2]
    assert len(files(Path("runs/there"))) >= 10
    assert files(Path("runs/there")) == files(Path("runs/batch"))


def test_what_the_listener_raises_ends_it(cluster: Cluster) -> None:
    def stop(event: Event) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cluster.run_jobs([Job("square", strange_jobs.square, (7,))] * 3, stop)
    assert outcomes_of(cluster, [Job("square", strange_jobs.square, (2,))])[0].value == 4


@pytest.mark.parametrize(
    ("version", "seen", "said"),
    [
        (("1.0", "a"), True, ""),
        (("0.9", "b"), True, "the worker has mavnav 0.9, not 1.0"),
        (("1.0", "b"), True, "the worker has mavnav 1.0 of other sources, not 1.0"),
        (("1.0", "a"), False, "the worker does not see the directory of the results"),
        (ModuleNotFoundError("mavnav"), None, "the worker has no mavnav, or one without clusters"),
        (OSError("gone"), None, "the worker cannot be asked (gone)"),
    ],
)
def test_workers_that_will_not_do(version, seen, said: str) -> None:
    assert _incompatibility(version, seen, ("1.0", "a")) == said


@pytest.mark.slow
def test_workers_of_another_version_are_refused(processes: Cluster, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("mavnav.jobs.dask.__version__", "0.0.9")
    with (
        pytest.raises(UsageError, match=r"the worker has mavnav .*, not 0\.0\.9: install mavnav 0\.0\.9"),
        connect(processes.client.scheduler.address, tmp_path, 1, None, 1),
    ):
        pass


def test_a_lost_scheduler_is_no_matter_of_dasks_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For one that was killed it printed 38 lines, two tracebacks among them."""
    monkeypatch.setattr(cluster_client, "CONNECT_S", 1.0)
    heard: list[logging.LogRecord] = []
    logger = logging.getLogger("distributed.client")
    level = logger.level
    monkeypatch.setattr(logger, "handle", heard.append)
    with (
        distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as local,
        connect(local.scheduler_address, tmp_path, 1, None, 1) as found,
    ):
        local.close()
        with pytest.raises(UsageError, match="the scheduler is gone"):
            found.run_jobs([Job("square", strange_jobs.square, (3,))], ignore)
        time.sleep(1.5)  # until the client gives up
    assert not heard
    assert logger.level == level


def test_where_nobody_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_client, "CONNECT_S", 0.3)
    for scheduler in ("tcp://127.0.0.1:9", "nonsense"):
        with (
            pytest.raises(UsageError, match=f"{scheduler}: no scheduler with workers answers; start one"),
            connect(scheduler, tmp_path, 1, None, 1),
        ):
            pass


@pytest.mark.parametrize("answer", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b""], ids=["at once", "never"])
def test_where_something_else_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: bytes) -> None:
    """As the dashboard does, at the port beside that of the scheduler."""
    monkeypatch.setattr(cluster_client, "CONNECT_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        answered: list[socket.socket] = []

        def serve() -> None:
            answered.append(server.accept()[0])
            answered[0].sendall(answer)

        thread = Thread(target=serve)
        thread.start()
        scheduler = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with (
            pytest.raises(UsageError, match=f"no Dask scheduler answers at {scheduler}; is this the port of its dash"),
            connect(scheduler, tmp_path, 1, None, 1),
        ):
            pass
        thread.join()
        answered[0].close()


def test_without_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"pip install 'mavnav\[cluster\]'"), connect(LOCAL, tmp_path, 1, None, 1):
        pass


def test_memory_is_not_for_workers_that_run_already() -> None:
    with pytest.raises(UsageError, match="--memory-limit"):
        request_of(BatchOptions(sources=("logs",), scheduler="tcp://127.0.0.1:9", memory_mb=100))
