"""``mavnav batch [MANIFEST.yaml | LOG ...]``: many logs with many settings, each run apart, one verdict.

Examples
--------
mavnav batch logs/ -j 4 --gate 'map.accepted_share>=0.95'
mavnav batch 'drives/**/*.mcap' --method robust --method paper --grid 10x10 --grid 20x20
mavnav batch nightly.yaml --baseline baseline.json --gate baseline --junit batch.xml --summary batch.md
mavnav batch nightly.yaml --scheduler tcp://10.0.0.1:8786
mavnav batch logs/ --repeat 2 --gate identical
mavnav batch logs/ --external kiss='python kiss.py {log} {out}' --time-limit 600
mavnav batch benchmark --only ccny_demo --junit benchmark.xml
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands import shared, signals
from mavnav.commands.progress import loading_modules, reporting, watching
from mavnav.commands.terminal import emit, emit_json, json_text, note, printable, table_console, verdict_mark
from mavnav.config.options import READING, read_options
from mavnav.profiling import Progress
from mavnav.units import pluralize

if TYPE_CHECKING:
    from rich.table import Table

    from mavnav.batch.options import BatchOptions
    from mavnav.batch.request import BatchRequest
    from mavnav.batch.runner import BatchPlan
    from mavnav.jobs.dask import Cluster


@shared.with_options(*READING, "strict", "resolution_m", "online")
def batch(
    context: typer.Context,
    sources: Annotated[list[str] | None, typer.Argument(metavar="MANIFEST.yaml|LOG", show_default=False)] = None,
    *,
    schema: Annotated[bool, shared.schema_option()] = False,
    methods: shared.Methods = None,
    grids: Annotated[list[str] | None, shared.replay_option("grid")] = None,
    azimuths: shared.Azimuths = None,
    config: shared.ConfigFile = None,
    sets: shared.Sets = None,
    programs: shared.Programs = None,
    program_s: shared.ProgramLimit = 3600.0,
    directory: Annotated[Path | None, shared.directory_option()] = None,
    force: shared.Force = False,
    report: Annotated[bool, shared.output_option("--report")] = False,
    json: Annotated[bool, shared.output_option("--json")] = False,
    junit: Annotated[Path | None, shared.output_option(metavar="FILE")] = None,
    summary: Annotated[Path | None, shared.output_option(metavar="FILE")] = None,
    annotations: Annotated[bool, shared.output_option("--annotations")] = False,
    quiet: shared.Quiet = False,
    gates: shared.Gates = None,
    accept: shared.Accept = None,
    baseline: Annotated[Path | None, shared.check_option(metavar="DIR|FILE")] = None,
    tolerances: Annotated[list[str] | None, shared.check_option("--tolerance", metavar="NAME=X[%]")] = None,
    copies: Annotated[Path | None, shared.input_option(metavar="DIR")] = None,
    only: Annotated[list[str] | None, shared.input_option(metavar="NAME")] = None,
    repeat: Annotated[int | None, shared.check_option(min=1, max=100, metavar="N")] = None,
    update_baseline: Annotated[bool, shared.check_option("--update-baseline")] = False,
    jobs: shared.Jobs = None,
    timeout_s: Annotated[float | None, shared.resource_option("--timeout", min=0.1, metavar="SECONDS")] = None,
    memory_mb: Annotated[int | None, shared.resource_option("--memory-mb", min=1, max=10**9, metavar="MB")] = None,
    tries: Annotated[int | None, shared.resource_option(min=1, metavar="N")] = None,
    scheduler: Annotated[str | None, shared.resource_option(metavar="tcp://HOST:PORT|local")] = None,
    part: Annotated[str | None, shared.resource_option(metavar="I/N")] = None,
    **given: object,
) -> None:
    r"""Replay many logs with many settings; a failed run does not stop the others, finished runs are reused.

    Parameters
    ----------
    sources
        A manifest, or logs, folders and patterns.
    schema
        Print the JSON Schema of manifests.
    grids
        Search grid; repeatable (default 10x10).
    directory
        Output directory (default runs/batch, or runs/batch-MANIFEST).
    force
        Ignore finished runs and repeat them.
    report
        Also write a page for every run.
    json
        Print one line of JSON for each run, then one for all.
    junit
        Write JUnit XML for CI.
    summary
        Write a Markdown summary (default: GitHub's step summary, where there is one).
    annotations
        Print GitHub annotations on stderr (default on GitHub).
    baseline
        Compare with an earlier batch.
    tolerances
        Allowed change of a metric against the baseline; repeatable.
    copies
        Folder with copies of pinned logs, which are not fetched then.
    only
        Only this log of the manifest; repeatable.
    repeat
        Make every run N times (default 1), for --gate identical.
    update_baseline
        Overwrite the baseline file with this batch.
    timeout_s
        Time limit of a run (default none).
    memory_mb
        Memory limit of a run (Linux; default none).
    tries
        Attempts if the process of a run is killed (default 3).
    scheduler
        Run on a Dask cluster (default this machine; needs mavnav\[cluster]).
    part
        Run part I of N (default all); all parts share --output.
    """
    typed = dict(locals())  # parameters have the names of the fields of BatchOptions
    if schema:
        from mavnav.batch.manifest import Manifest
        from mavnav.config.loading import schema_of

        emit_json(schema_of(Manifest))
        return
    with reporting(quiet=quiet) as progress:
        with loading_modules():
            from mavnav.batch.options import BatchOptions
        files = {name: file for name, file in (("--junit", junit), ("--summary", summary)) if file}
        own = {name: typed[name] for name in BatchOptions.__struct_fields__ if typed.get(name) is not None}
        options = BatchOptions(words=context.obj, options=read_options(given), files=files, **own)
        plan = _plan(options, progress)
    document = _run(plan, json=json, quiet=quiet)
    from mavnav.batch.baseline import is_any_unwritten

    if plan.request.new_baseline and is_any_unwritten(document["cells"]):
        note(f"mavnav: warning: no baseline {plan.request.new_baseline} is written: runs could not be; make room")
    elif plan.request.new_baseline and not quiet:
        codes = [row["code"] for row in document["cells"]]
        failures = f"{sum(map(bool, codes))} of {len(codes)} runs in it failed"
        note(f"mavnav: wrote the baseline {plan.request.new_baseline}; {failures}")
    try:
        _write_for_ci(document, junit, summary, annotations=annotations)
    finally:
        print_batch(document, plan.request, json=json)
    raise typer.Exit(document["exit_code"])


def _plan(options: BatchOptions, report: Progress) -> BatchPlan:
    """Read manifest and logs, and load the kernels here."""
    from mavnav.batch.options import request_of
    from mavnav.batch.runner import load_kernels, plan_batch
    from mavnav.metrics.gates import renaming

    plan = plan_batch(request_of(options), report)
    gates = [*plan.request.rules.gates, *(gate for case in plan.cases for gate in case.gates)]
    for old in dict.fromkeys(filter(None, (renaming(gate.name) for gate in gates))):
        note(f"mavnav: {old}")
    load_kernels(plan, report)
    return plan


def _run(plan: BatchPlan, *, json: bool, quiet: bool) -> dict[str, Any]:
    from mavnav.batch.runner import run_batch

    with (
        _cluster(plan.request, quiet=quiet) as cluster,
        watching([case.name for case in plan.missing], quiet=quiet, lines=False) as listen,
    ):
        try:
            return run_batch(plan, listen, row_printer(len(plan.cases), json=json, quiet=quiet), cluster)
        except signals.Stopped:
            directory = plan.request.directory
            note(f"mavnav: runs that are finished stay in {directory}; the same call makes the others")
            raise


@contextmanager
def _cluster(request: BatchRequest, *, quiet: bool) -> Iterator[Cluster | None]:
    """Connect to the cluster of a request, if it names one, and report it."""
    limits = request.limits
    if limits.scheduler is None:
        yield None
        return
    from mavnav.jobs.dask import connect

    with connect(limits.scheduler, request.directory, limits.workers, limits.memory_mb, limits.tries) as cluster:
        if not quiet:
            note(f"mavnav: {pluralize(cluster.workers, 'worker')}; dashboard at {cluster.dashboard}")
        yield cluster


def _write_for_ci(document: dict[str, Any], junit: Path | None, summary: Path | None, *, annotations: bool) -> None:
    """Write what CI reads: files, and GitHub annotations."""
    from mavnav.batch.ci import github_commands, to_junit, to_summary
    from mavnav.batch.files import append_text, write_text

    if junit:
        write_text(to_junit(document), junit)
    if summary:
        write_text(to_summary(document), summary)
    if github := os.environ.get("GITHUB_STEP_SUMMARY"):
        append_text(to_summary(document), Path(github))
    if annotations or os.environ.get("GITHUB_ACTIONS") == "true":
        for line in github_commands(document):
            note(line)


MAX_ROWS = 60
"""Maximum number of runs in the table; the worst ones are shown."""


def row_printer(total: int, *, json: bool, quiet: bool) -> Callable[[dict[str, Any]], None]:
    """Return the function that prints the row of every run when it ends.

    Reused runs are counted, but not printed on stderr. On a terminal the bars replace the lines.
    """
    from mavnav.batch.document import remark

    silent = quiet or sys.stderr.isatty()
    numbers = count(1)

    def print_row(row: dict[str, Any]) -> None:
        number = next(numbers)
        if json:
            emit(_line({"event": "run", **row}))
        if row["status"] != "cached" and not silent:
            end = ", ".join(filter(None, ("" if row["code"] else "passed", remark(row))))
            took = f" in {row['seconds']:.1f} s" if row["seconds"] else ""
            note(f"mavnav: {number} of {total}: {row['name']}{took}: {end}")

    return print_row


def _line(document: dict[str, Any]) -> str:
    from mavnav.outputs.files.document import plain

    return json_text(plain(document))


def print_batch(document: dict[str, Any], request: BatchRequest, *, json: bool) -> None:
    """Print the result of a batch on stdout: a table, worst runs first, or with ``json`` one line without the rows.

    Below the table is why runs did not pass or are suspect, and where more of the results is: the page, or the
    directory of a part, which has none.
    """
    from mavnav.batch.document import batch_headline, missing_lines, remark, worst_first
    from mavnav.batch.files import PAGE_FILE

    if json:
        emit(_line({"event": "batch", **{k: v for k, v in document.items() if k != "cells"}}))
        return
    rows = worst_first(document["cells"])[:MAX_ROWS]
    table_console().print(_table(rows, len(document["cells"]) - len(rows)))
    emit("")
    for row in rows:
        if text := remark(row):
            emit(printable(f"{row['name']}: {text}"))
    results = request.directory if request.part else request.directory / PAGE_FILE
    emit(f"\n{printable(batch_headline(document))}; {printable(results)}")
    for kind, text in missing_lines(document):
        note(f"mavnav: {kind}: {text}")


def _table(rows: list[dict[str, Any]], more: int) -> Table:
    """Return the table of some runs, with how many ``more`` there are."""
    from rich.table import Table
    from rich.text import Text

    from mavnav.batch.document import KEY_FIGURES, change_text
    from mavnav.outputs.documents.quantities import verdict_texts

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("run", overflow="fold")
    table.add_column("verdict", no_wrap=True)
    for figure in KEY_FIGURES:
        table.add_column(figure.head, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for row in rows:
        texts = [figure.text_of(row["run"]) for figure in KEY_FIGURES]
        remarks = [change_text(row), "reused" if row["status"] == "cached" else ""]
        text = printable("; ".join(filter(None, remarks))).replace("::", ":\\x3a")
        name = Text(printable(row["name"]).replace("::", ":\\x3a"), style="red" if row["code"] else "")
        word = Text(*verdict_mark(verdict_texts(row["run"])[0]))
        table.add_row(name, word, *texts, Text(text))  # a name may be folded anywhere
    if more:
        table.caption = f"{more} more in batch.csv"
    return table
