"""Output of a batch: a plain line per run on stderr, or a line of JSON per run on stdout; and the final result."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from mavnav.commands.terminal import emit, json_text, note, printable, table_console, verdict_mark

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from rich.table import Table

MAX_ROWS = 60
"""Maximum number of runs in the table; the worst ones are shown."""


def row_printer(total: int, *, json: bool, quiet: bool) -> Callable[[dict[str, Any]], None]:
    """Return the function that prints the row of every run when it ends.

    Reused runs are counted, but not printed on stderr. On a terminal the bars replace the lines.
    """
    from mavnav.batch.document import remark

    silent = quiet or sys.stderr.isatty()
    ended = 0

    def print_row(row: dict[str, Any]) -> None:
        nonlocal ended
        ended += 1
        if json:
            emit(_line({"event": "run", **row}))
        if row["status"] != "cached" and not silent:
            end = ", ".join(filter(None, ("" if row["code"] else "passed", remark(row))))
            took = f" in {row['seconds']:.1f} s" if row["seconds"] else ""
            note(f"mavnav: {ended} of {total}: {row['name']}{took}: {end}")

    return print_row


def _line(document: dict[str, Any]) -> str:
    from mavnav.outputs.files.document import plain

    return json_text(plain(document))


def print_batch(document: dict[str, Any], results: Path, *, json: bool) -> None:
    """Print the result of a batch on stdout: a table, worst runs first, or with ``json`` one line without the rows.

    Below the table is why runs did not pass or are suspect, and ``results``, the path with further results.
    """
    from mavnav.batch.document import remark, worst_first
    from mavnav.batch.summary import batch_headline, missing_lines

    if json:
        emit(_line({"event": "batch", **{k: v for k, v in document.items() if k != "cells"}}))
        return
    table_console().print(_table(document))
    emit("")
    for row in worst_first(document["cells"])[:MAX_ROWS]:
        if text := remark(row):
            emit(printable(f"{row['name']}: {text}"))
    emit(f"\n{printable(batch_headline(document))}; {printable(results)}")
    for kind, text in missing_lines(document):
        note(f"mavnav: {kind}: {text}")


def _table(document: dict[str, Any]) -> Table:
    from rich.table import Table
    from rich.text import Text

    from mavnav.batch.document import worst_first
    from mavnav.batch.summary import FIGURES, change_text
    from mavnav.outputs.documents.quantities import verdict_texts

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("run", overflow="fold")
    table.add_column("verdict", no_wrap=True)
    for figure in FIGURES:
        table.add_column(figure.head, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for row in worst_first(document["cells"])[:MAX_ROWS]:
        texts = [figure.text_of(row["run"]) for figure in FIGURES]
        remarks = [change_text(row), "reused" if row["status"] == "cached" else ""]
        text = printable("; ".join(filter(None, remarks))).replace("::", ":\\x3a")
        name = Text(printable(row["name"]).replace("::", ":\\x3a"), style="red" if row["code"] else "")
        word = Text(*verdict_mark(verdict_texts(row["run"])[0]))
        table.add_row(name, word, *texts, Text(text))  # a name may be folded anywhere
    if len(document["cells"]) > MAX_ROWS:
        table.caption = f"{len(document['cells']) - MAX_ROWS} more in batch.csv"
    return table
