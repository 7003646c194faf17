"""The documents of scored trajectories side by side, in the form of a comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mavnav.batch.document import SECTIONS
from mavnav.comparison.document import RELATIVE_COSTS, NamedDocument, best, one_best
from mavnav.errors import ExitCode, worst
from mavnav.metrics.gates import stored_verdict
from mavnav.outputs.documents.verdict import Verdict, worst_verdict
from mavnav.outputs.files.document import plain
from mavnav.outputs.report.entry import FAILED
from mavnav.outputs.report.headline import headline
from mavnav.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.pipelines.score import Scored

SHOWN: Final = [name for name in SECTIONS if name not in {"search", "timing"}]
"""Sections of run.json that are repeated for every run: nothing is searched, and the time is that of drawing."""


def score_document(log: str, scored: Sequence[Scored]) -> dict[str, Any]:
    """Return comparison.json of the runs of a log at the poses of trajectories; costs are not compared."""
    runs, unknown = [each.document for each in scored], [None] * len(scored)
    made = [NamedDocument(each.name, each.document) for each in scored if each.document]
    verdicts = (Verdict(**known) for each in made if (known := stored_verdict(each.document)))
    summary = headline(made)
    return {
        "schema_version": 1,
        "mavnav_version": __version__,
        "verdict": plain(worst_verdict(verdicts)),
        "headline": summary,
        "profile": next((each.document["map_quality"]["profile"] for each in made), None),
        "cells": [_cell(log, each) for each in scored],
        "winners": one_best(runs),
        "logs": [{"log": log, "headline": summary, "cells": [*range(len(runs))], "best": best(runs)}],
        "price": dict.fromkeys(("coarsest", *RELATIVE_COSTS), unknown),
        "gates": [],
        "exit_code": worst([run["exit_code"] if run else ExitCode.GATE_FAILED for run in runs]),
    }


def _cell(log: str, scored: Scored) -> dict[str, Any]:
    run = scored.document
    return {
        "name": scored.name,
        "trajectory": scored.name,
        "log": log,
        "method": "external",
        "differs": "",
        "grid": None,
        "azimuth": None,
        "key": None,
        "status": "done" if run else FAILED,
        "exit_code": run["exit_code"] if run else ExitCode.GATE_FAILED,
        "error": scored.error or None,
        "directory": scored.name if run else None,
        "run": {name: run[name] for name in SHOWN if name in run} if run else None,
    }
