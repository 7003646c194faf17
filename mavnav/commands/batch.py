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
    ConfigFile,
    End,
    Extrinsic,
    Odom,
    Online,
    Quiet,
    RunAgain,
    Sets,
    Start,
    Strict,
    Topic,
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
            metavar="[MANIFEST.yaml | LOG ...]", help="A manifest; logs, folders, patterns.", show_default=False
        ),
    ] = None,
    *,
    methods: Annotated[
        list[str] | None, typer.Option("--method", help="robust (default) or paper; repeat it.", show_default=False)
    ] = None,
    grids: Annotated[
        list[str] | None, typer.Option("--grid", metavar="NxM", help="A search grid; repeat it.", show_default=False)
    ] = None,
    azimuths: Annotated[
        list[int] | None,
        typer.Option("--azimuth", help="Points of the azimuth grid: one for all, or one a grid.", show_default=False),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=1, help="Runs at a time; by itself one a processor.", show_default=False),
    ] = None,
    directory: Annotated[
        Path | None, typer.Option("--output", "-o", help="Directory; runs/batch if not given.", show_default=False)
    ] = None,
    timeout: Annotated[
        float | None, typer.Option(min=0.1, help="Seconds that a run may take.", show_default=False)
    ] = None,
    memory_mb: Annotated[
        int | None, typer.Option("--memory-mb", min=1, help="Data that a run may hold (Linux).", show_default=False)
    ] = None,
    tries: Annotated[
        int | None, typer.Option(min=1, help="Tries of a run whose process is killed; 3.", show_default=False)
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT|local", help=r"Run on a Dask cluster, mavnav\[cluster].", show_default=False
        ),
    ] = None,
    part: Annotated[
        str | None, typer.Option(metavar="I/N", help="Run one of N parts; all share -o.", show_default=False)
    ] = None,
    gates: Gates = None,
    accept: Annotated[
        list[int] | None,
        typer.Option("--accept", metavar="CODE", help="An exit code that counts as done.", show_default=False),
    ] = None,
    baseline: Annotated[
        Path | None, typer.Option(metavar="DIR|FILE", help="An earlier batch to compare with.", show_default=False)
    ] = None,
    tolerances: Annotated[
        list[str] | None,
        typer.Option("--tolerance", metavar="NAME=X[%]", help="How far a number may move.", show_default=False),
    ] = None,
    update_baseline: Annotated[
        bool, typer.Option("--update-baseline", help="Write the baseline file anew, whatever it says.")
    ] = False,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write JUnit XML for CI.", show_default=False)
    ] = None,
    summary: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a summary in Markdown; GitHub's by itself.", show_default=False),
    ] = None,
    annotations: Annotated[
        bool, typer.Option("--annotations", help="GitHub annotations on stderr; there by itself.")
    ] = False,
    online: Online = False,
    odom: Odom = None,
    topic: Topic = None,
    start: Start = None,
    end: End = None,
    extrinsic: Extrinsic = None,
    config: ConfigFile = None,
    sets: Sets = None,
    strict: Strict = False,
    pages: Annotated[bool, typer.Option("--report", help="Draw a page of every run too.")] = False,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON Schema of manifests.")] = False,
    force: RunAgain = False,
    json: Annotated[
        bool, typer.Option("--json", help="A line of JSON a run on stdout, and a last one on all.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Replay many logs with many settings; what fails fails alone, what was run before is not run again."""
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
