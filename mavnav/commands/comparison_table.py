"""The table of a comparison on a terminal: a line per run, the best values marked, the main metrics with bars."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavnav.commands.terminal import can_print, emit, emit_json, note, printable, table_console, verdict_mark

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from mavnav.outputs.documents.quantities import Quantity

METRICS_WITH_BAR = {"wall_thickness.spread.p95_mm", "timing.cpu_s"}
"""Metrics that are shown with a bar."""

BAR_WIDTH = 6
EIGHTHS = " ▏▎▍▌▋▊▉█"

BARS, LOGS, WORDS, SIGNS, REMARKS, EVALUATIONS, CPU = "bars", "logs", "verdict", "signs", "remarks", "evals x", "cpu x"

NARROWER = (
    BARS,
    "map_quality.crispness.entropy_bits",
    "map_quality.crispness.occupied_cells_per_m",
    "wall_thickness.paper_cells.max",
    "search.evaluations_per_scan.mean",
    "map_quality.revisits.nn_l_mm",
    "map.accepted_share",
    "wall_thickness.spread.median_mm",
    "timing.cpu_s",
    WORDS,
    REMARKS,
    CPU,
    LOGS,
    EVALUATIONS,
    "map_quality.ghost_walls.length_m",
    "reference.ate.rmse_m",
    "reference.map_distance.mean_mm",
    "wall_thickness.spread.p95_mm",
    SIGNS,
)
"""What makes the table narrower, in this order; the files and the report contain all columns.

Metrics, relative costs and bars are left out, and of verdicts first the words; the names of logs and the remarks are
folded.
"""

FOLDED = {LOGS: 10, REMARKS: 12}
"""Width in characters of a column that is folded."""


def print_result_of(document: dict[str, Any], page: Path, *, json: bool) -> None:
    """Print the result on stdout, and on stderr what the user must not miss."""
    from mavnav.comparison.document import problems, remarks

    if json:
        emit_json(document)
    else:
        print_comparison(document)
        emit(f"\nreport  {page}")
    for problem in problems(document):
        note(f"mavnav: error: {problem}")
    for remark in remarks(document):
        note(f"mavnav: warning: {remark}")


def print_comparison(document: dict[str, Any]) -> None:
    """Print the table of comparison.json on stdout."""
    from mavnav.comparison.document import cell_size_notes

    out = table_console()
    out.print(_text(document["headline"]), soft_wrap=False)
    out.print()
    unbounded = out.options.update_width(1000)
    less: set[str] = set()
    table = _table(document, less)
    for name in NARROWER:
        if out.measure(table, options=unbounded).maximum > out.width:
            less.add(name)
            table = _table(document, less)
    out.print(table)
    for line in cell_size_notes(document):
        out.print(_text(line))


def _table(document: dict[str, Any], less: set[str]) -> Table:
    """Return the table without what is in ``less``, see `NARROWER`, and without metrics that no run has."""
    from rich.table import Table

    from mavnav.comparison.document import labels, ratio
    from mavnav.outputs.documents.quantities import QUANTITIES, verdict_texts

    table = Table(box=None, pad_edge=False, header_style="bold")
    runs = [cell["run"] for cell in document["cells"]]
    known = [q for q in QUANTITIES if q.name not in less and any(q.of(run) is not None for run in runs)]
    costs = {EVALUATIONS: "evaluations", CPU: "cpu"}
    shown = {title: name for title, name in costs.items() if title not in less}
    several = len(document["logs"]) > 1
    if several:
        table.add_column("log", overflow="fold", max_width=FOLDED[LOGS] if LOGS in less else None)
    for title in ("method", "grid", *([] if SIGNS in less else ["" if WORDS in less else WORDS])):
        table.add_column(title, no_wrap=True)
    for title in (*(figure.head for figure in known), *shown):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", overflow="fold", max_width=FOLDED[REMARKS] if REMARKS in less else None)
    for k, cell in enumerate(document["cells"]):
        log = [_text(cell["log"])] if several else []
        figures = [_figure(document, k, figure, bars=BARS not in less) for figure in known]
        ratios = [_text(ratio(document, name, k)) for name in shown.values()]
        marked, style = verdict_mark(verdict_texts(cell["run"])[0])
        word = [] if SIGNS in less else [_text(marked[:1] if WORDS in less else marked, style)]
        table.add_row(*log, *map(_text, labels(cell)), *word, *figures, *ratios, _text(_state(cell)))
    return table


def _text(text: str, style: str = "") -> Text:
    from rich.text import Text

    return Text(printable(text), style=style)


def _figure(document: dict[str, Any], k: int, figure: Quantity, *, bars: bool) -> Text:
    """Format a metric, with a bar before it if it has one and ``bars``, and an asterisk after the best value."""
    from mavnav.comparison.document import winning

    run = document["cells"][k]["run"]
    number = figure.of(run)
    won = k in winning(document, figure.name)
    text = figure.text_of(run) + ("*" if won else " ")
    if bars and figure.name in METRICS_WITH_BAR and number is not None:
        largest = max(figure.of(cell["run"]) or 0.0 for cell in document["cells"])
        text = f"{bar(number, largest)} {text}"
    return _text(text, "bold green" if won else "")


def bar(number: float, largest: float) -> str:
    """Return a bar of ``BAR_WIDTH`` characters, full for the largest number; hashes if blocks cannot be printed."""
    share = number / largest if largest > 0 else 0.0
    if not can_print(EIGHTHS, sys.stdout):
        return ("#" * round(BAR_WIDTH * share)).ljust(BAR_WIDTH)
    whole, rest = divmod(round(8 * BAR_WIDTH * share), 8)
    return ("█" * whole + EIGHTHS[rest].strip()).ljust(BAR_WIDTH)


def _state(cell: dict[str, Any]) -> str:
    """Return the status of a run in words: failed, reused, no map, not meaningful."""
    if cell["status"] == "failed":
        return "failed"
    remarks = ["reused"] if cell["status"] == "cached" else []
    remarks += [] if "map" in cell["run"] else ["no map"]
    if (cell["run"].get("map_quality") or {}).get("meaningful", True) is False:
        remarks.append("not meaningful")
    return ", ".join(remarks)
