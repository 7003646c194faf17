"""The files of a batch: batch.json, batch.csv, batch.html, and JUnit XML for CI servers.

The page has all runs, worst first, each with a small map and the reasons of a failure. The format of the XML, a test
suite per log, a test case per run, is junit-10.xsd, the schema of Jenkins' xUnit plugin: ``testsuites`` of
``testsuite`` of ``testcase``, each case with at most one ``failure`` or ``error``. A failed gate, a lost track and a
damaged log are failures; a run without a result is an error. Metrics are the output of a case, because the schema has
properties for suites only.
"""

from __future__ import annotations

import csv
import io
import os
import re
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as XML  # noqa: N814  short, because many lines use it

import numpy as np
from PIL import Image

from mavnav.atomic_files import beside, writing
from mavnav.batch.document import BATCH_FILE, ENDS, IDENTICAL_GATE, why, worst_first
from mavnav.batch.summary import batch_headline, change_text
from mavnav.config.named_files import read_json
from mavnav.errors import ExitCode, UsageError
from mavnav.jobs.run_cache import RUNS_FOLDER
from mavnav.mapping.tiled_arrays import crop, max_pool
from mavnav.outputs.directory import RUN_FILE, check_apart
from mavnav.outputs.documents.quantities import NAMED, PATH, TIME, UNUSABLE, Quantity, number, verdict_texts
from mavnav.outputs.files.document import to_json
from mavnav.outputs.report.html import environment, facts, inline
from mavnav.outputs.report.markdown import inert
from mavnav.outputs.writers import REPORT_FILE

PAGE_FILE: Final = "batch.html"

FIGURES: Final = (
    "scans.processed",
    "map.accepted_share",
    "tracking.tracked_share",
    "tracking.path_length_m",
    "map_quality.meaningful",
    "wall_thickness.spread.median_mm",
    "wall_thickness.spread.p95_mm",
    "wall_thickness.2.p95_mm",
    "wall_thickness.2.max_mm",
    "map_quality.ghost_walls.length_m",
    "map_quality.revisits.nn_l_mm",
    "map_quality.crispness.occupied_cells_per_m",
    "search.evaluations_per_scan.mean",
    "timing.cpu_s",
    "timing.wall_s",
)
"""Numbers of run.json that have a column in batch.csv."""

_HEAD: Final = ("name", "log", "setting", "method", "grid", "azimuth", "status", "exit_code", "code", "error")


def write_batch(document: dict[str, Any], directory: Path) -> None:
    """Write the files of a batch, each complete or not at all; raises OutputError."""
    for name, text in TEXTS.items():
        write_text(text(document), directory / name)
    write_text(to_page(document, directory), directory / PAGE_FILE)


def write_text(text: str, path: Path) -> None:
    """Write one file; raises OutputError."""
    with writing(path), beside(path) as partial:
        partial.write_text(text, "utf-8", "backslashreplace")  # names of files need not be UTF-8


def check_files(files: Mapping[str, Path], inputs: Iterable[Path], directory: Path) -> None:
    """Raise UsageError for a file that would overwrite an input or a file of the batch, or another one of ``files``.

    ``files`` are the files to write by their options, ``directory`` is the directory of the batch.
    """
    own = Path(os.path.realpath(directory))
    for option, path in files.items():
        place = Path(os.path.realpath(path))
        if place in {own / name for name in (*TEXTS, PAGE_FILE)} or place.is_relative_to(own / RUNS_FOLDER):
            raise UsageError(f"{option}: {path} is a file of the batch itself; name another file")
        if own.is_relative_to(place):
            raise UsageError(f"{option}: {path} is a directory of the batch; name another file")
    check_apart(files, inputs)


def append_text(text: str, path: Path) -> None:
    """Append text to a file; raises OutputError."""
    with writing(path, "name another"), path.open("a", encoding="utf-8", errors="backslashreplace") as file:
        file.write(text)


def batch_csv(document: dict[str, Any]) -> str:
    """Return CSV with one line per run: its settings, its result, and its metrics under their names in run.json."""
    rows = io.StringIO()
    table = csv.writer(rows, lineterminator="\n")
    table.writerow([*_HEAD, "verdict", "reason", "gates_failed", "baseline", "seconds", "directory", *FIGURES])
    for row in document["cells"]:
        failed = " ".join(gate["gate"] for gate in row["gates"] if not gate["passed"])
        change = (row["baseline"] or {}).get("change")
        more = [*verdict_texts(row["run"]), failed, change, row["seconds"], row["directory"]]
        texts = [inert(value) for value in (*(row[key] for key in _HEAD), *more)]
        table.writerow([*texts, *(number(row["run"], name) for name in FIGURES)])
    return rows.getvalue()


TEXTS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {BATCH_FILE: to_json, "batch.csv": batch_csv}


COLUMNS: Final = (
    NAMED["map.accepted_share"],
    PATH,
    NAMED["wall_thickness.spread.p95_mm"],
    NAMED["map_quality.ghost_walls.length_m"],
    NAMED["map_quality.revisits.nn_l_mm"],
    TIME,
)


def to_page(document: Mapping[str, Any], directory: Path) -> str:
    """Return the page of a batch whose run directories are in ``directory``."""
    templates = environment("mavnav.batch", "mavnav.outputs.report")
    lines = [_line(row, directory) for row in worst_first(document["cells"])]
    return templates.get_template("batch.html").render(
        headline=batch_headline(document),
        lines=lines,
        kinds=Counter(line["kind"] for line in lines),
        changes=Counter(line["change"] for line in lines if line["change"]) if document["baseline"] else {},
        missing=(document["baseline"] or {}).get("missing", []),
        columns=COLUMNS,
        style=inline(templates, "report.css", "batch.css"),
        script=inline(templates, "batch.js"),
        version=document["mavnav_version"],
        profile=document["profile"],
    )


def _line(row: dict[str, Any], directory: Path) -> dict[str, Any]:
    """Return what the page says of a run.

    ``facts`` are its date, log and sensor; ``kind`` is passed, failed, or broken (a run without a result); ``link`` is
    the address of the run's page; ``change`` is the change since the baseline; ``fields`` are the metrics of `COLUMNS`.
    """
    path = directory / row["directory"] if row["directory"] else None
    code, (word, reason) = ExitCode(row["code"]), verdict_texts(row["run"])
    end = "passed" if not code else "failed" if word in UNUSABLE else ENDS[code]
    return {
        "name": row["name"],
        "kind": "passed" if not code else "failed" if row["run"] else "broken",
        "end": end,
        "word": word,
        "reason": reason,
        "facts": " · ".join(filter(None, (_facts(path) if path else "", *_remarks(row)))),
        "reasons": [line for line in (*why(row), *_unlike(row)) if line not in (end, f"{word}: {reason}")],
        "link": _link(path, row["directory"]) if path else None,
        "picture": thumbnail(path) if path else None,
        "change": str((row["baseline"] or {}).get("change") or ""),
        "change_text": change_text(row),
        "fields": [_field(column, row) for column in COLUMNS],
    }


def _remarks(row: Mapping[str, Any]) -> Iterator[str]:
    """Yield the licence of the log, and that a repetition has the bytes of the first run."""
    if row["licence"]:
        yield f"licence {row['licence']}"
    if row["repeat"] and not row["repeat"]["differs"]:
        yield f"the same bytes as {row['repeat']['of']}"


def _unlike(row: Mapping[str, Any]) -> list[str]:
    """Return which bytes of a repetition differ, unless its failed gate says so."""
    gated = any(gate["gate"] == IDENTICAL_GATE for gate in row["gates"])
    return [] if gated or not row["repeat"] else row["repeat"]["differs"]


def _link(path: Path, address: str) -> str | None:
    """Return the address of a run's report, else of its map or run.json; ``address`` is that of its directory."""
    names = (name for name in (REPORT_FILE, "map.png", RUN_FILE) if (path / name).is_file())
    return next((f"{address}/{name}" for name in names), None)


def _facts(path: Path) -> str:
    """Return the facts of a run from its run.json; empty if that cannot be read."""
    try:
        return facts([read_json(path / RUN_FILE)])
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return ""


def _field(column: Quantity, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the text of a metric and its sort key, empty without a value, and what the baseline and others have."""
    others = {"baseline": (row["baseline"] or {}).get("before", {}), **row["peers"]}
    beside = [f"{name} {column.write(each[column.name])}" for name, each in others.items() if column.name in each]
    value = column.of(row["run"])
    text, key = ("", "") if value is None else (column.text_of(row["run"]), f"{value:.9g}")
    return {"text": text, "key": key, "beside": beside}


MAX_PIXELS: Final = 160
"""Maximum width and height of a thumbnail, in pixels; it is shown at half that size, for high-density screens."""

_UNKNOWN: Final = 205
"""Gray level of map_server for a cell that no beam has crossed."""

_SHADES: Final = {"wall": 24, "unknown": 232, "free": 255}


def thumbnail(directory: Path) -> str | None:
    """Return a small image of the map of a run as a data URI, cropped to the known cells; None without a map."""
    try:
        with Image.open(directory / "map.pgm", formats=("PPM",)) as image:
            cells = np.asarray(image)
    except (OSError, ValueError, Image.DecompressionBombError):  # ValueError before pillow 13, for a file that is cut
        return None
    known = crop(cells, cells != _UNKNOWN)
    # the darkest cell of each square, so that a wall of one cell remains visible
    seen = 255 - max_pool(255 - known, -(-max(known.shape) // MAX_PIXELS))
    shades = np.where(seen < _UNKNOWN, _SHADES["wall"], np.where(seen == _UNKNOWN, _SHADES["unknown"], _SHADES["free"]))
    buffer = io.BytesIO()
    Image.fromarray(shades.astype(np.uint8)).quantize(4).save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + b64encode(buffer.getvalue()).decode("ascii")


_INVALID_XML: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 does not allow (section 2.2)."""


def to_junit(document: Mapping[str, Any]) -> str:
    """Return a batch as JUnit XML."""
    logs: dict[str, list[Mapping[str, Any]]] = {}
    for row in document["cells"]:
        logs.setdefault(row["log"], []).append(row)
    suites = [_suite(log, rows) for log, rows in logs.items()]
    missing_runs = (document["baseline"] or {}).get("missing", [])
    if missing_runs:
        suites.append(_missing(missing_runs, failed=bool(document["baseline"].get("gate"))))
    sums = {name: str(sum(int(suite.attrib[name]) for suite in suites)) for name in ("tests", "failures", "errors")}
    seconds = sum(float(suite.attrib["time"]) for suite in suites)
    root = XML.Element("testsuites", {"name": "mavnav batch", **sums, "time": f"{seconds:.3f}"})
    root.extend(suites)
    XML.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + XML.tostring(root, encoding="unicode") + "\n"


def _totals(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    kinds = Counter(_kind(row) for row in rows)
    counts = {"tests": len(rows), "failures": kinds["failure"], "errors": kinds["error"]}
    return {**{name: str(count) for name, count in counts.items()}, "time": f"{sum(map(_seconds, rows)):.3f}"}


def _seconds(row: Mapping[str, Any]) -> float:
    """Return the duration of a run in s, in this batch or, if it was finished before, in its own run."""
    return float(row["seconds"] or number(row["run"], "timing.wall_s") or 0.0)


def _kind(row: Mapping[str, Any]) -> str | None:
    return None if not row["code"] else "failure" if row["run"] else "error"


def _suite(log: str, rows: Sequence[Mapping[str, Any]]) -> XML.Element:
    suite = XML.Element("testsuite", {"name": _text(log), **_totals(rows), "skipped": "0"})
    suite.extend(_case(log, row) for row in rows)
    return suite


def _case(log: str, row: Mapping[str, Any]) -> XML.Element:
    name = row["name"].removeprefix(log).strip() or row["name"]
    case = XML.Element("testcase", {"name": _text(name), "classname": _text(log), "time": f"{_seconds(row):.3f}"})
    kind, reasons = _kind(row), [_text(reason) for reason in why(row)]
    if kind:
        about = {"message": reasons[0], "type": f"exit code {row['code']}"}
        XML.SubElement(case, kind, about).text = "\n".join(reasons)
    figures = ((name, number(row["run"], name)) for name in FIGURES)
    old = (row["baseline"] or {}).get("before", {})
    before = {name: f" baseline {value:.6g}" for name, value in old.items() if value is not None}
    if known := [f"{name} {value:.6g}{before.get(name, '')}" for name, value in figures if value is not None]:
        word, reason = verdict_texts(row["run"])
        XML.SubElement(case, "system-out").text = _text("\n".join([f"verdict {word}: {reason}", *known]))
    return case


def _missing(names: Sequence[str], *, failed: bool) -> XML.Element:
    """Return a suite of the runs that are in the baseline and not in the batch."""
    count = str(len(names) if failed else 0)
    counts = {"tests": str(len(names)), "failures": count, "errors": "0", "time": "0.000"}
    suite = XML.Element("testsuite", {"name": "missing", **counts, "skipped": str(0 if failed else len(names))})
    for name in names:
        case = XML.SubElement(suite, "testcase", {"name": _text(name), "classname": "missing", "time": "0.000"})
        XML.SubElement(case, "failure" if failed else "skipped", {"message": "the baseline has it, this batch has not"})
    return suite


def _text(text: str) -> str:
    return _INVALID_XML.sub("?", text)
