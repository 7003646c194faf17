"""Output to the terminal: escaped text, messages, results and tables."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, TextIO

if TYPE_CHECKING:
    from rich.console import Console

Json = dict[str, Any]
"""A document of a result, or a part of it."""

Rows = Iterable[tuple[str, str]]
"""Names and values of a summary table."""

LISTED: Final = 10
"""Maximum number of items of a list that are printed."""

UNFOLDED: Final = 200
"""Width in characters of a table if the output is no terminal, so that no line is folded."""


VERDICT_MARKS: Final = {
    "good": ("✓", "+", "bold green"),
    "suspect": ("?", "?", "bold yellow"),
    "wrong": ("✗", "x", "bold red"),
    "lost": ("✗", "x", "bold red"),
}
"""Word of a verdict -> its sign, a sign of ASCII, and its style."""


COLOURS: Final = {"mavnav: error:": "\x1b[1;31m", "mavnav: warning:": "\x1b[33m"}
"""Beginning of a message -> its colour, as an escape sequence."""


def printable(text: object) -> str:
    """Escape text that could control a terminal, or that a CI runner could take for a workflow command.

    Control, format and bidirectional characters are replaced by escapes, and so is the beginning of a workflow command,
    at the start of a line or within it.
    """
    return re.sub(r"^( *):(?=:)", r"\1\\x3a", _visible(text))


def _visible(text: object) -> str:
    from mavnav.outputs.documents.addresses import public_line

    text = public_line(str(text))
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return re.sub(r"##(?=\w*\[)", r"#\\x23", text)


def can_print(text: str, stream: TextIO) -> bool:
    """Return whether a stream's encoding contains all characters of a text."""
    try:
        text.encode(stream.encoding or "ascii")
    except UnicodeEncodeError:
        return False
    return True


def console(*, stderr: bool = False) -> Console:
    """Return a console for results (stdout) or messages (stderr), without markup.

    Colors are off with NO_COLOR and if the stream is no terminal.
    """
    from rich.console import Console

    return Console(stderr=stderr, highlight=False, markup=False, soft_wrap=True)


def verdict_mark(word: str, stream: TextIO | None = None) -> tuple[str, str]:
    """Return the word of a verdict after its sign, of ASCII where the stream has no other, and its style."""
    sign, plain, style = VERDICT_MARKS.get(word, ("", "", ""))
    shown = sign if can_print(sign, stream or sys.stdout) else plain
    return f"{shown} {word}".strip(), style


def table_console() -> Console:
    """Return a console for a table on stdout; where that is no terminal, it is so wide that no line is folded."""
    out = console()
    if not out.is_terminal:
        out.width = UNFOLDED
    return out


def note(text: str) -> None:
    """Print one line on stderr; errors of a full or closed stream are ignored, and the exit code stays the same."""
    with suppress(OSError, ValueError):
        print(_coloured(_visible(text)), file=sys.stderr, flush=True)  # noqa: T201  only the command line prints


def _coloured(line: str) -> str:
    """Colour what a line is, an error or a warning, where stderr is a terminal that shows colours."""
    kind = next((kind for kind in COLOURS if line.startswith(kind)), "")
    shown = kind and sys.stderr.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    return f"{COLOURS[kind]}{kind}\x1b[0m{line.removeprefix(kind)}" if shown else line


def print_traceback(error: BaseException) -> None:
    """Print the traceback of an exception on stderr, without the secrets of addresses in it."""
    from traceback import format_exception

    from mavnav.outputs.documents.addresses import public_line

    with suppress(OSError, ValueError):
        sys.stderr.write(public_line("".join(format_exception(error))))


def note_problems(document: Json) -> None:
    """Print the ``warnings`` and the first items of ``damage`` of a document on stderr, one line each."""
    for warning in document["warnings"]:
        note(f"mavnav: warning: {warning}")
    for damage in document["damage"][:LISTED]:
        note(f"mavnav: damage: {damage['what']}, {damage['where']}")
    if len(document["damage"]) > LISTED:
        note(f"mavnav: damage: {len(document['damage']) - LISTED} more; --json lists them")


def emit(text: str) -> None:
    """Write a result to stdout without escaping."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def emit_json(document: Json) -> None:
    """Write a document to stdout as indented JSON."""
    emit(json_text(document, indent=2))


def json_text(document: Json, *, indent: int | None = None) -> str:
    """Return a document as JSON, with the beginnings of workflow commands of a CI runner escaped."""
    from json import dumps

    return re.sub(r"##(?=\w*\[)", r"#\\u0023", dumps(document, indent=indent))


def print_result(document: Json, rows: Rows, *, json: bool) -> None:
    """Print a result on stdout: the document with ``json``, else its rows as a table."""
    if json:
        emit_json(document)
    else:
        print_table(rows)


def print_verdict(document: Json, rows: Rows) -> None:
    """Print the verdict of a document, its headline and its rows as one table."""
    name, style = verdict_mark(document["verdict"]["word"])
    print_table([*verdict_rows(document["verdict"]), ("result", document["headline"]), *rows], styles={name: style})


def verdict_rows(verdict: dict[str, str]) -> Rows:
    """Yield the rows of a verdict: the word with its reason, and what to do, if there is anything."""
    yield verdict_mark(verdict["word"])[0], verdict["reason"]
    if verdict["advice"]:
        yield "  try", verdict["advice"]


def print_table(rows: Rows, width: int = 0, styles: Mapping[str, str] | None = None) -> None:
    """Print names and values on stdout: on a terminal as a table, else as plain lines, which need no imports.

    The names are as wide as the longest one, at least ``width`` characters. ``styles`` are those of some names.
    """
    rows = list(rows)
    width = max([width, *(len(name) for name, _ in rows)])
    if not sys.stdout.isatty():
        emit("\n".join(f"{name:<{width}}  {printable(value)}" for name, value in rows))
        return
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(min_width=width)
    for name, value in rows:
        table.add_row(Text(name, style=(styles or {}).get(name, "bold")), Text(printable(value), overflow="fold"))
    console().print(table)
