"""A small batch in the current folder, for the tests of batches."""

from __future__ import annotations

from typing import Any

from mavnav.batch.options import BatchOptions, request_of
from mavnav.batch.runner import plan_batch, run_batch

OPTIONS: dict[str, Any] = {
    "sources": ("logs", "gone.bag"),
    "grids": ("5x5",),
    "azimuths": (6,),
    "options": {"online": True, "end_s": 0.5},
    "jobs": 1,
}
NAME = "6/5x5 final_pass=false end_s=0.5"


def batch(**more: Any) -> tuple[dict[str, Any], list[str]]:
    """Run a batch in the current folder; return batch.json and the names of the runs that were not cached."""
    listen = more.pop("listen", lambda event: None)
    planned = plan_batch(request_of(BatchOptions(**{**OPTIONS, **more})), lambda phase, done, total: None)
    document = run_batch(planned, listen, lambda row: None)
    return document, [case.name for case in planned.missing]
