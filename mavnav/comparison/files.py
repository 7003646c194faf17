"""The files of a comparison: comparison.json, and tables in CSV and Markdown."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any, Final

from mavnav.atomic_files import beside
from mavnav.batch.document import ENDS
from mavnav.comparison.document import RELATIVE_COSTS
from mavnav.errors import OutputError
from mavnav.outputs.documents.quantities import QUANTITIES, number, size_note
from mavnav.outputs.files.document import to_json
from mavnav.outputs.report.markdown import escape, inert, table_row

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

COMPARISON_FILE: Final = "comparison.json"


def write_comparison(document: dict[str, Any], directory: Path) -> None:
    """Write the files of a comparison, each complete or not at all; raises OutputError."""
    for name, text in TEXTS.items():
        try:
            with beside(directory / name) as path:
                path.write_text(text(document), "utf-8", "backslashreplace")  # names of files need not be UTF-8
        except OSError as error:
            raise OutputError(f"{directory / name} cannot be written: {error.strerror or error}; make room") from error


HIT_QUANTITIES: Final = ("wall_thickness.2.p95_mm", "wall_thickness.2.max_mm")
"""Additional columns of the CSV file, for comparison with earlier files."""


def comparison_csv(document: dict[str, Any]) -> str:
    """Return CSV with one line per run: its settings, its metrics under their names in run.json, its relative cost."""
    rows = io.StringIO()
    table = csv.writer(rows, lineterminator="\n")
    head = ("log", "method", "grid", "azimuth", "status", "exit_code", "error", "directory")
    names = [*(figure.name for figure in QUANTITIES), *HIT_QUANTITIES]
    table.writerow([*head, *names, *(f"price.{name}" for name in RELATIVE_COSTS)])
    for k, cell in enumerate(document["cells"]):
        figures = [number(cell["run"], name) for name in names]
        texts = [inert(cell[key]) for key in head]
        table.writerow([*texts, *figures, *(document["price"][name][k] for name in RELATIVE_COSTS)])
    return rows.getvalue()


def comparison_markdown(document: dict[str, Any]) -> str:
    """Return a table in GitHub's Markdown with the best values in bold, and a list of failures below it."""
    titles = ["log", "method", "yaw samples/grid", *(f.head for f in QUANTITIES), "evaluations ratio", "cpu ratio"]
    lines = [f"# mavnav {document['mavnav_version']} compare", "", table_row(titles), table_row(["---"] * len(titles))]
    lines += [table_row(_cells(document, k)) for k in range(len(document["cells"]))]
    failed = [f"- {escape(line)}" for line in (*problems(document), *remarks(document))]
    notes = [escape(line) for line in cell_size_notes(document)]
    return "\n".join([*lines, *(["", *notes] if notes else []), *(["", *failed] if failed else [])]) + "\n"


def _cells(document: dict[str, Any], k: int) -> list[str]:
    cell = document["cells"][k]
    texts = [escape(cell["log"]), cell["method"], f"{cell['azimuth']}/{cell['grid']}"]
    for figure in QUANTITIES:
        text = figure.text_of(cell["run"])
        texts.append(f"**{text}**" if k in winning(document, figure.name) else text)
    return texts + [ratio(document, name, k) for name in ("evaluations", "cpu")]


def winning(document: dict[str, Any], metric: str) -> set[int]:
    """Return the indices of the runs that are the best of their log by a metric."""
    return {k for log in document["logs"] for k in log["best"][metric]}


def cell_size_notes(document: dict[str, Any]) -> list[str]:
    """Return a line for every log whose maps have several cell sizes: what is not compared, and why."""
    several = len(document["logs"]) > 1
    notes = [(log["log"], size_note(document["cells"][k]["run"] for k in log["cells"])) for log in document["logs"]]
    return [f"{log}: {why}" if several else why for log, why in notes if why]


def ratio(document: dict[str, Any], cost: str, k: int) -> str:
    """Format the cost of a run relative to the coarsest one; a dash if it is unknown."""
    number = document["price"][cost][k]
    return "-" if number is None else f"{number:.1f}"


def problems(document: dict[str, Any]) -> list[str]:
    """Return a line for every run that failed and every gate that did not hold."""
    failed = [f"{cell['name']}: {cell['error']}" for cell in document["cells"] if cell["status"] == "failed"]
    gates = [
        f"{document['cells'][gate['cell']]['name']}: gate {gate['gate']} failed: {gate['why']}"
        for gate in document["gates"]
        if not gate["passed"]
    ]
    return failed + gates


def remarks(document: dict[str, Any]) -> list[str]:
    """Return a line for every run of a damaged log, and every one that lost its track for good."""
    return [f"{c['name']}: {ENDS[c['exit_code']]}" for c in document["cells"] if c["run"] and c["exit_code"]]


TEXTS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {
    COMPARISON_FILE: to_json,
    "comparison.csv": comparison_csv,
    "comparison.md": comparison_markdown,
}
