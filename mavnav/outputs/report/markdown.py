"""Tables in GitHub's Markdown, and cells of CSV files that a spreadsheet takes for text."""

from __future__ import annotations

from collections.abc import Iterable


def table_row(texts: Iterable[str]) -> str:
    """Write a row of a table."""
    return f"| {' | '.join(texts)} |"


def escape(text: str) -> str:
    """Keep Markdown from taking a log's name, or a line's end in it, for its own marks, or calling people by it.

    GitHub calls ``@name`` and links addresses wherever they stand, also after a backslash: an empty comment parts them.
    """
    plain = "".join(c if c.isprintable() else "?" for c in text)
    marked = "".join(f"\\{c}" if c in r"\`*_{}[]<>|#" else c for c in plain)
    return marked.replace("@", "@<!-- -->").replace("://", ":<!-- -->//")


def inert(value: object) -> object:
    """Return a cell of a CSV file that no spreadsheet takes for a formula: text that could be one begins with ``'``."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value
