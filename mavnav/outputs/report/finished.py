"""The page of whatever a directory holds: a run, a comparison, a batch, a merge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mavnav.config.named_files import read_json
from mavnav.errors import UsageError
from mavnav.outputs.directory import MERGE_FILE, RUN_FILE
from mavnav.outputs.report.entry import load
from mavnav.outputs.report.merged import load_merge
from mavnav.outputs.report.page import list_text, page_text, single
from mavnav.units import pluralize

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def _of_batch(document: dict[str, Any], directory: Path) -> str:
    runs = [load(cell, directory) for cell in document["cells"]]
    return list_text(runs, f"Batch of {pluralize(len(runs), 'run')}")


def _of_merge(document: dict[str, Any], directory: Path) -> str:
    return list_text([load_merge(document, directory)], document["headline"])


def _of_run(document: dict[str, Any], directory: Path) -> str:
    return page_text(single(document), directory)


PAGES: Final[dict[str, tuple[str, Callable[[dict[str, Any], Path], str]]]] = {
    "comparison.json": ("report.html", page_text),
    "batch.json": ("view.html", _of_batch),
    MERGE_FILE: ("view.html", _of_merge),
    RUN_FILE: ("report.html", _of_run),
}
"""The document of a directory -> the name and the text of its page; report.html of a merge is another one."""


def finished_page(directory: Path) -> tuple[str, str]:
    """Return name and text of the page of a directory; raises UsageError where it holds nothing that has one."""
    for name, (file, page) in PAGES.items():
        if (directory / name).is_file():
            try:
                return file, page(read_json(directory / name), directory)
            except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
                reason = f"{name} lacks what is needed, as of an earlier version or altered"
                raise UsageError(f"{directory} cannot be shown: {reason}; make it again") from error
    raise UsageError(f"{directory} holds no run, comparison, batch or merge; name the directory of a finished one")
