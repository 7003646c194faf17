"""The pipeline of ``mavnav batch``: many logs with many settings, each run in its own process, and one exit code.

The directory of a batch contains a run directory for every run in ``cells/``, so that finished runs are not repeated.
``batch.json``, ``batch.csv`` and ``batch.html`` cover all runs.
"""

from __future__ import annotations

from time import monotonic
from typing import TYPE_CHECKING, Any

from mavnav.batch.baseline import missing, write_baseline
from mavnav.batch.document import batch_document, judged_row
from mavnav.batch.files import write_batch
from mavnav.batch.runner import run_cases

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.batch.cases import CaseResult
    from mavnav.batch.plan import BatchPlan
    from mavnav.jobs import Event
    from mavnav.jobs.dask import Cluster

    Row = dict[str, Any]


def run_batch(
    plan: BatchPlan, on_event: Callable[[Event], None], on_row: Callable[[Row], None], cluster: Cluster | None = None
) -> Row:
    """Run the missing runs, evaluate all gates, and return batch.json.

    ``on_row`` is called with the row of every run as soon as it is known; ``on_event`` and ``cluster`` are those of
    `run_cases`. Raises OutputError if the documents cannot be written. A part of a batch writes no documents, and does
    not report runs missing since the baseline: run the whole batch for these when all parts are finished.
    """
    began_s, request = monotonic(), plan.request

    def judge(result: CaseResult) -> Row:
        row = judged_row(result, request)
        on_row(row)
        return row

    rows, rules = run_cases(plan, on_event, judge, cluster), request.rules
    missing_runs = [] if rules.baseline is None or request.part else missing(rows, rules.baseline)
    document = batch_document(
        rows, monotonic() - began_s, rules.baseline, missing_runs, baseline_gate=rules.baseline_gate
    )
    if request.part is None:
        write_batch(document, request.directory)
    if request.new_baseline:
        write_baseline(rows, request.new_baseline, rules.watched)
    return document
