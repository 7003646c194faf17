"""Repeated runs of a batch: which bytes of their files differ."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavnav.errors import ExitCode, worst
from mavnav.outputs.directory import digests_of

IDENTICAL_GATE: Final = "identical"


def compare_repeats(rows: Sequence[dict[str, Any]], directory: Path, *, gate: bool) -> None:
    """Add to ``repeat`` of the row of each repetition how its files differ from those of the run that it repeats.

    With ``gate``, a repetition with other bytes, or that ended otherwise, fails.
    """
    named = {row["name"]: row for row in rows}
    for row in (row for row in rows if row["repeat"] and row["repeat"]["of"] in named):
        differs = row["repeat"]["differs"] = _differences(named[row["repeat"]["of"]], row, directory)
        if gate:
            why = "; ".join(differs)
            row["gates"].append({"gate": IDENTICAL_GATE, "value": len(differs), "passed": not differs, "why": why})
            row["code"] = int(worst([row["code"], *([ExitCode.GATE_FAILED] if differs else [])]))


def _differences(one: dict[str, Any], other: dict[str, Any], directory: Path) -> list[str]:
    codes = [one["exit_code"], other["exit_code"]]
    ends = [f"exit codes {codes[0]} and {codes[1]}"] if codes[0] != codes[1] else []
    folders = [directory / row["directory"] for row in (one, other) if row["directory"]]
    return ends + (file_differences(*folders) if len(folders) == len(codes) else [])


def file_differences(one: Path, other: Path) -> list[str]:
    """Return a line for each output file of two run directories whose bytes differ.

    run.json and the page are left out: they have times.
    """
    names = sorted({*digests_of(one), *digests_of(other)})
    return [f"{name}: {text}" for name in names if (text := _byte_difference(one / name, other / name))]


def _byte_difference(one: Path, other: Path) -> str:
    if not (one.is_file() and other.is_file()):
        return f"only in {(one if one.is_file() else other).parent.name}"
    a, b = (np.fromfile(path, dtype=np.uint8) for path in (one, other))
    shorter = min(len(a), len(b))
    differ = np.flatnonzero(a[:shorter] != b[:shorter])
    sizes = f", sizes {len(a)} and {len(b)}" if len(a) != len(b) else ""
    if not len(differ):
        return sizes and f"the same up to byte {shorter}{sizes}"
    return f"{len(differ)} of {shorter} bytes differ, from byte {differ[0]} to {differ[-1]}{sizes}"
