"""``mavnav batch [MANIFEST.yaml | LOG ...]``: many logs with many settings, each run apart, one verdict."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands import signals
from mavnav.commands.batch_rows import print_verdict, telling
from mavnav.commands.gating import Gates
from mavnav.commands.options import (
    CHECKS,
    INPUT,
    OUTPUT,
    RESOURCES,
    SEARCH,
    ConfigFile,
    End,
    Extrinsic,
    Jobs,
    Methods,
    Odom,
    Online,
    Quiet,
    RunAgain,
    Sets,
    Start,
    Strict,
    Topic,
    given,
)
from mavnav.commands.progress import loading_kernels, reporting
from mavnav.commands.replay import pose
from mavnav.commands.run_progress import watching
from mavnav.commands.terminal import emit, note

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.batch.plan import Request
    from mavnav.jobs.dask import Cluster

EPILOG = """
[bold]Examples[/bold]

mavnav batch logs/ -j 4 --gate 'map.accepted_share>=0.95'

mavnav batch 'drives/**/*.mcap' --method robust --method paper --grid 10x10 --grid 20x20

mavnav batch nightly.yaml --baseline baseline.json --gate baseline --junit batch.xml --summary batch.md

mavnav batch nightly.yaml --scheduler tcp://10.0.0.1:8786
"""


def batch(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MANIFEST.yaml | LOG ...]", help="A manifest, or logs, folders and patterns.", show_default=False
        ),
    ] = None,
    *,
    topic: Topic = None,
    start: Start = None,
    end: End = None,
    odom: Odom = None,
    extrinsic: Extrinsic = None,
    strict: Strict = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of manifests.", rich_help_panel=INPUT)
    ] = False,
    methods: Methods = None,
    grids: Annotated[
        list[str] | None,
        given("--grid", metavar="NxM", help="Search grid; repeatable.", rich_help_panel=SEARCH),
    ] = None,
    azimuths: Annotated[
        list[int] | None,
        given(
            "--azimuth",
            metavar="N",
            help="Yaw samples: one number for all grids, or one for each.",
            rich_help_panel=SEARCH,
        ),
    ] = None,
    online: Online = False,
    config: ConfigFile = None,
    sets: Sets = None,
    directory: Annotated[
        Path | None,
        given("--output", "-o", metavar="DIR", help="Output directory (default runs/batch).", rich_help_panel=OUTPUT),
    ] = None,
    force: RunAgain = False,
    pages: Annotated[
        bool, typer.Option("--report", help="Also write a page for every run.", rich_help_panel=OUTPUT)
    ] = False,
    json: Annotated[
        bool,
        typer.Option("--json", help="Print one line of JSON for each run, then one for all.", rich_help_panel=OUTPUT),
    ] = False,
    junit: Annotated[Path | None, given(metavar="FILE", help="Write JUnit XML for CI.", rich_help_panel=OUTPUT)] = None,
    summary: Annotated[
        Path | None,
        given(
            metavar="FILE",
            help="Write a Markdown summary (default: GitHub's step summary, where there is one).",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    annotations: Annotated[
        bool,
        typer.Option(
            "--annotations",
            help="Print GitHub annotations on stderr (default on GitHub).",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    quiet: Quiet = False,
    gates: Gates = None,
    accept: Annotated[
        list[int] | None,
        given("--accept", metavar="CODE", help="Exit code that counts as done; repeatable.", rich_help_panel=CHECKS),
    ] = None,
    baseline: Annotated[
        Path | None, given(metavar="DIR|FILE", help="Compare with an earlier batch.", rich_help_panel=CHECKS)
    ] = None,
    tolerances: Annotated[
        list[str] | None,
        given(
            "--tolerance",
            metavar="NAME=X[%]",
            help="Allowed change of a metric against the baseline; repeatable.",
            rich_help_panel=CHECKS,
        ),
    ] = None,
    update_baseline: Annotated[
        bool,
        typer.Option("--update-baseline", help="Overwrite the baseline file with this batch.", rich_help_panel=CHECKS),
    ] = False,
    jobs: Jobs = None,
    timeout: Annotated[
        float | None, given(min=0.1, metavar="SECONDS", help="Time limit of a run.", rich_help_panel=RESOURCES)
    ] = None,
    memory_mb: Annotated[
        int | None,
        given("--memory-mb", min=1, metavar="MB", help="Memory limit of a run (Linux).", rich_help_panel=RESOURCES),
    ] = None,
    tries: Annotated[
        int | None,
        given(
            min=1,
            metavar="N",
            help="Attempts if the process of a run is killed (default 3).",
            rich_help_panel=RESOURCES,
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        given(
            metavar="tcp://HOST:PORT|local",
            help=r"Run on a Dask cluster (needs mavnav\[cluster]).",
            rich_help_panel=RESOURCES,
        ),
    ] = None,
    part: Annotated[
        str | None,
        given(metavar="I/N", help="Run part I of N; all parts share --output.", rich_help_panel=RESOURCES),
    ] = None,
) -> None:
    """Replay many logs with many settings; a failed run does not stop the others, finished runs are reused."""
    if schema:
        _print_schema()
        return
    with reporting(quiet=quiet) as report:
        with loading_kernels(report):
            from mavnav.batch.plan import plan as make_plan
            from mavnav.batch.run import run_batch
            from mavnav.slam.registry import load_kernels
        from mavnav.batch.files import PAGE_FILE, check_file
        from mavnav.batch.request import Options, request_of

        for file in filter(None, (junit, summary)):
            check_file(file)
        mounting = pose(extrinsic) if extrinsic else None
        place = (mounting.x_m, mounting.y_m, mounting.yaw_rad) if mounting else None
        request = request_of(
            Options(
                sources=sources or (),
                methods=methods or (),
                grids=grids or (),
                azimuths=azimuths or (),
                config=config,
                sets=sets or (),
                options=_given(odom=odom, final_pass=False if online else None),
                reading=_given(topic=topic, start_s=start, end_s=end, extrinsic=place, strict=strict or None),
                gates=gates or (),
                accept=accept or (),
                baseline=baseline,
                tolerances=tolerances or (),
                directory=directory,
                jobs=jobs,
                timeout_s=timeout,
                memory_mb=memory_mb,
                tries=tries,
                scheduler=scheduler,
                part=part,
                force=force,
                report=pages,
                update_baseline=update_baseline,
            )
        )
        plan = make_plan(request, report)
        with loading_kernels(report):  # not in every worker, by the clock of its first run
            for case in plan.missing if request.limits.scheduler is None else ():
                load_kernels(case.setting.config)
    with (
        _cluster(request, quiet=quiet) as cluster,
        watching([case.name for case in plan.missing], quiet=quiet, lines=False) as listen,
        telling(len(plan.cases), json=json, quiet=quiet) as tell,
    ):
        try:
            document = run_batch(plan, listen, tell, cluster)
        except signals.Stopped:
            note(f"mavnav: runs that are finished stay in {request.directory}; the same call makes the others")
            raise
    try:
        _leave(document, junit, summary, annotations=annotations)
    finally:
        print_verdict(document, request.directory if request.part else request.directory / PAGE_FILE, json=json)
    raise typer.Exit(document["exit_code"])


@contextmanager
def _cluster(request: Request, *, quiet: bool) -> Iterator[Cluster | None]:
    """Connect to the cluster that is asked for, if any, and tell of it."""
    limits = request.limits
    if limits.scheduler is None:
        yield None
        return
    from mavnav.jobs.dask import connected

    with connected(limits.scheduler, request.directory, limits.workers, limits.memory_mb, limits.tries) as cluster:
        if not quiet:
            note(f"mavnav: {cluster.workers} workers; dashboard at {cluster.dashboard}")
        yield cluster


def _given(**values: object) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _print_schema() -> None:
    from json import dumps

    from mavnav.batch.manifest import Manifest

    emit(dumps(Manifest.model_json_schema(), indent=2))


def _leave(document: dict[str, Any], junit: Path | None, summary: Path | None, *, annotations: bool) -> None:
    """Write what CI reads."""
    from mavnav.batch.files import append_text, write_text
    from mavnav.batch.junit import to_junit
    from mavnav.batch.summary import github_commands, to_summary

    if junit:
        write_text(to_junit(document), junit)
    if summary:
        write_text(to_summary(document), summary)
    if github := os.environ.get("GITHUB_STEP_SUMMARY"):
        append_text(to_summary(document), Path(github))
    if annotations or os.environ.get("GITHUB_ACTIONS") == "true":
        for line in github_commands(document):
            note(line)
