"""The documents of scored trajectories side by side, in the form of a comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from mavnav.batch.document import SECTIONS
from mavnav.comparison.document import RELATIVE_COSTS, SCHEMA_VERSION, best, one_best
from mavnav.errors import worst
from mavnav.metrics.gates import stored_verdict
from mavnav.outputs.documents.verdict import Verdict, worst_verdict
from mavnav.outputs.files.document import plain
from mavnav.outputs.report.headline import headline
from mavnav.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence


class Scored(NamedTuple):
    """A trajectory that was scored: its name, which is that of its directory, and its run.json."""

    name: str
    document: dict[str, Any]


def score_document(scored: Sequence[Scored]) -> dict[str, Any]:
    """Return comparison.json of the runs of one log at the poses of trajectories; nothing is known of their cost."""
    runs, unknown = [each.document for each in scored], [None] * len(scored)
    log, summary = runs[0]["input"]["path"], headline(scored)
    verdicts = (Verdict(**known) for run in runs if (known := stored_verdict(run)))
    return {
        "schema_version": SCHEMA_VERSION,
        "mavnav_version": __version__,
        "verdict": plain(worst_verdict(verdicts)),
        "headline": summary,
        "profile": runs[0]["map_quality"]["profile"],
        "cells": [_cell(log, each) for each in scored],
        "winners": one_best(runs),
        "logs": [{"log": log, "headline": summary, "cells": [*range(len(runs))], "best": best(runs)}],
        "price": dict.fromkeys(("coarsest", *RELATIVE_COSTS), unknown),
        "gates": [],
        "exit_code": worst([run["exit_code"] for run in runs]),
    }


def _cell(log: str, scored: Scored) -> dict[str, Any]:
    run = scored.document
    return {
        **{key: run[key] for key in ("method", "grid", "azimuth", "exit_code")},
        "name": scored.name,
        "trajectory": scored.name,
        "log": log,
        "key": None,
        "status": "done",
        "error": None,
        "directory": scored.name,
        "run": {name: run[name] for name in SECTIONS if name in run and name not in {"search", "timing"}},
    }
