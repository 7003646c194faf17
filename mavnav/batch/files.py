"""The files of a batch: batch.json, batch.csv, and batch.html, the page of all runs.

The page has the worst run first, each with a small map and the reasons of a failure.
"""

from __future__ import annotations

import csv
import io
import os
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image

from mavnav.atomic_files import beside, writing
from mavnav.batch.document import BATCH_FILE, ENDS, IDENTICAL_GATE, batch_headline, change_text, why, worst_first
from mavnav.config.named_files import read_json
from mavnav.errors import ExitCode, UsageError
from mavnav.jobs.run_cache import RUNS_FOLDER
from mavnav.mapping.tiled_arrays import crop, max_pool
from mavnav.outputs.directory import RUN_FILE, check_apart, check_target
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
"""Numbers of run.json that have a column in batch.csv, and stand in the JUnit report."""

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

    Raises OutputError for a file that cannot be written. ``files`` are the files to write by their options,
    ``directory`` is the directory of the batch.
    """
    own = Path(os.path.realpath(directory))
    for option, path in files.items():
        place = Path(os.path.realpath(path))
        if place in {own / name for name in (*TEXTS, PAGE_FILE)} or place.is_relative_to(own / RUNS_FOLDER):
            raise UsageError(f"{option}: {path} is a file of the batch itself; name another file")
        if own.is_relative_to(place):
            raise UsageError(f"{option}: {path} is a directory of the batch; name another file")
        check_target(path)
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
