"""One file a subcommand: options -> pipelines -> messages.

These modules are imported to print ``mavnav --help``, so at their top they import the standard library, typer,
``mavnav.errors`` and ``mavnav.units``; other packages and libraries are imported inside the functions.
"""

from __future__ import annotations

from typing import Final

COMMANDS: Final = {
    "replay": "cli.md#replay",
    "compare": "compare.md",
    "score": "score.md",
    "batch": "ci.md",
    "check": "cli.md#quality-gates",
    "view": "report.md",
    "metrics": "metrics.md",
    "diff": "diff.md",
    "edit": "cli.md#edit-a-map",
    "merge": "merge.md",
    "plan": "cli.md#floor-plan",
    "calibrate": "calibrate.md",
    "simulate": "scenarios.md",
    "info": "cli.md#examine-and-convert",
    "convert": "cli.md#examine-and-convert",
    "warmup": "ci.md#compiled-kernels",
    "config": "cli.md#configuration",
    "docs": "index.md",
}
"""Name of a command, which is a function or an app in the module of that name -> its page in docs/."""
