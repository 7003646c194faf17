"""The page of a report, and its pictures as separate files; the page of whatever a directory holds.

That is a run, a comparison, a batch, a merge. The interactive map is moved by Leaflet, whose script comes from the
package ``xstatic-leaflet``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from msgspec import Struct

from mavnav.atomic_files import beside, writing
from mavnav.config.named_files import read_json, what_is_wrong
from mavnav.errors import UsageError
from mavnav.outputs.directory import MERGE_FILE, RUN_FILE
from mavnav.outputs.documents.quantities import verdict_texts, without_search
from mavnav.outputs.report import panels, tables
from mavnav.outputs.report.entry import Entry, Failure, load, load_merge
from mavnav.outputs.report.headline import headline
from mavnav.outputs.report.html import environment, facts, inline
from mavnav.outputs.report.pictures import Pictures, draw
from mavnav.outputs.report.view_data import view_data
from mavnav.outputs.run import RunResult
from mavnav.units import pluralize
from mavnav.version import DOCUMENT_HEAD, __version__

SCRIPTS: Final = ("data", "map", "plots", "viewer")
"""The scripts of the interactive map, each of which needs those before it."""

MAX_TOTAL_BYTES: Final = 3_000_000
"""Maximum size of all pictures of a page, in bytes; base64 adds a third."""

MAX_PICTURE_BYTES: Final = 250_000
"""Maximum size of one picture of a page, in bytes."""


class LogSection(Struct, frozen=True):
    """The section of the page on one log: its runs, failures, texts and pictures."""

    log: str
    headline: str
    facts: str
    entries: list[Entry]
    failures: list[Failure]
    table: tables.RunTable
    pictures: Pictures | None


def single(document: dict[str, Any], directory: str = ".") -> dict[str, Any]:
    """Return a comparison document with one run, whose files are in ``directory``."""
    cell = {key: document[key] for key in ("method", "grid", "azimuth", "exit_code")}
    cell |= {"log": document["input"]["path"], "status": "done", "directory": directory}
    cell |= {"trajectory": document["external"]["name"]} if "external" in document else {}
    return {**DOCUMENT_HEAD, "mavnav_version": document["mavnav_version"], "cells": [cell]}


def write_report(comparison: dict[str, Any], directory: Path, path: Path) -> None:
    """Write the page of a comparison to ``path``, and its pictures as PNG files to the same folder.

    ``comparison`` is the document of ``comparison.json``, or the result of `single`; the directories of its cells are
    relative to ``directory``. The pictures are maps.png, closeups.png, thickness.png, cost.png and motion.png, with a
    number from the second log on (maps_2.png). Raises OutputError if a file cannot be written.
    """
    sections = _sections(comparison, directory)
    with writing(path, "make room or choose another with -o"):
        for number, section in enumerate(sections, 1):
            for name, picture in section.pictures.sheets().items() if section.pictures else ():
                with beside(path.with_name(f"{name}{'' if number == 1 else f'_{number}'}.png")) as unfinished:
                    unfinished.write_bytes(panels.png(picture))
        with beside(path) as unfinished:
            unfinished.write_text(_page(comparison, sections), "utf-8", "backslashreplace")  # names need not be UTF-8


def _sections(comparison: dict[str, Any], directory: Path, run: RunResult | None = None) -> list[LogSection]:
    loaded = [load(cell, directory, run) for cell in comparison.get("cells") or []]
    return [_section(log, [e for e in loaded if e.log == log]) for log in dict.fromkeys(e.log for e in loaded)]


def _section(log: str, loaded: list[Entry | Failure]) -> LogSection:
    entries, failures = _by_kind(loaded)
    shown = (without_search(e.document) if "external" in e.document else e.document for e in entries)
    runs = [tables.NamedRun(entry.name, document) for entry, document in zip(entries, shown, strict=True)]
    return LogSection(
        log=log,
        headline=headline(runs),
        facts=facts([run.document for run in runs]),
        entries=entries,
        failures=failures,
        table=tables.table(runs),
        pictures=draw(entries) if entries else None,
    )


def _by_kind(loaded: Sequence[Entry | Failure]) -> tuple[list[Entry], list[Failure]]:
    """Divide what was loaded."""
    return [e for e in loaded if isinstance(e, Entry)], [e for e in loaded if isinstance(e, Failure)]


def page_text(comparison: dict[str, Any], directory: Path, run: RunResult | None = None) -> str:
    """Return the page of `write_report` alone; ``run`` is its one run, where that has just ended."""
    return _page(comparison, _sections(comparison, directory, run))


def list_text(loaded: Sequence[Entry | Failure], title: str) -> str:
    """Return a page of many runs: a list of them, and the interactive map of the one that is chosen."""
    entries, failures = _by_kind(loaded)
    return _render("list.html", {}, view_data(entries, {}), title=title, failures=failures)


def _page(comparison: dict[str, Any], sections: list[LogSection]) -> str:
    max_bytes = min(MAX_PICTURE_BYTES, MAX_TOTAL_BYTES // max(1, sum(s.pictures.count for s in sections if s.pictures)))
    entries = [entry for section in sections for entry in section.entries]
    several = {s.log: s.pictures.closeups for s in sections if s.pictures and len(s.entries) > 1}
    return _render(
        "report.html",
        comparison,
        view_data(entries, several),
        title=_title(sections),
        sections=sections,
        tables=tables,
        data_uri=partial(panels.data_uri, max_bytes=max_bytes),
        density=panels.DENSITY,
    )


def _render(template: str, comparison: dict[str, Any], view: list[dict[str, Any]], **more: object) -> str:
    """Fill a template; the interactive map and its scripts are on the page if there is any run to show."""
    templates = environment("mavnav.outputs.report")
    style = inline(templates, "report.css", *(["view/view.css"] if view else []), before=leaflet_style())
    script = inline(templates, *(f"view/{name}.js" for name in SCRIPTS), before=leaflet_script()) if view else None
    return templates.get_template(template).render(
        style=style,
        script=script,
        view=view,
        version=comparison.get("mavnav_version") or __version__,
        profile=comparison.get("profile"),
        **more,
    )


def _title(sections: list[LogSection]) -> str:
    names = [section.log.rpartition("/")[2] or section.log for section in sections]
    words = [verdict_texts(entry.document)[0] for section in sections for entry in section.entries]
    title = ", ".join(names) if len(names) <= 3 else f"{len(names)} logs"
    return f"{title}: {words[0]}" if len(words) == 1 and words[0] else title


def _shown(comparison: dict[str, Any], directory: Path) -> str:
    """Return the page of `page_text`; raises UsageError where it would show no run: an earlier page stays."""
    sections = _sections(comparison, directory)
    if sections and not any(section.entries for section in sections):
        raise UsageError(f"{directory} cannot be shown: {sections[0].failures[0].why}")
    return _page(comparison, sections)


def _of_batch(document: dict[str, Any], directory: Path) -> str:
    runs = [load(cell, directory) for cell in document["cells"]]
    return list_text(runs, f"Batch of {pluralize(len(runs), 'run')}")


PAGES: Final[dict[str, tuple[str, Callable[[dict[str, Any], Path], str]]]] = {
    "comparison.json": ("report.html", _shown),
    "batch.json": ("view.html", _of_batch),
    MERGE_FILE: ("view.html", lambda merge, folder: list_text([load_merge(merge, folder)], merge["headline"])),
    RUN_FILE: ("report.html", lambda run, folder: _shown(single(run), folder)),
}
"""The document of a directory -> the name and the text of its page; report.html of a merge is another one."""


def finished_page(directory: Path) -> tuple[str, str]:
    """Return name and text of the page of a directory; raises UsageError where it holds nothing that has one."""
    for name, (file, page) in PAGES.items():
        if (directory / name).is_file():
            try:
                return file, page(read_json(directory / name), directory)
            except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
                reason = f"{name} {what_is_wrong(error, 'lacks what is needed, as of an earlier version or altered')}"
                raise UsageError(f"{directory} cannot be shown: {reason}; make it again") from error
    raise UsageError(f"{directory} holds no run, comparison, batch or merge; name the directory of a finished one")


def leaflet_script() -> str:
    """Return the script of Leaflet, which begins with its license."""
    return _leaflet("leaflet.js").replace("//# sourceMappingURL=leaflet.js.map", "")


def leaflet_style() -> str:
    """Return the style sheet of Leaflet; the pictures that it names are of controls that the page does not have."""
    return re.sub(r"url\([^)]*\)", "none", _leaflet("leaflet.css"))


def _leaflet(name: str) -> str:
    return (files("xstatic.pkg.leaflet") / "data" / name).read_text(encoding="utf-8")
