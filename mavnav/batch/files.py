"""The files of a batch: batch.json, batch.csv and batch.html."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mavnav.atomic_files import beside
from mavnav.batch.document import BATCH_FILE
from mavnav.batch.page import to_page
from mavnav.errors import OutputError, UsageError
from mavnav.jobs.run_cache import RUNS_FOLDER
from mavnav.outputs.directory import check_apart
from mavnav.outputs.documents.quantities import number
from mavnav.outputs.files.document import to_json
from mavnav.outputs.report.markdown import inert

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

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

_HEAD: Final = ("name", "log", "setting", "method", "grid", "azimuth", "status", "exit_code", "verdict", "error")


def write_batch(document: dict[str, Any], directory: Path) -> None:
    """Write the files of a batch, each complete or not at all; raises OutputError."""
    for name, text in TEXTS.items():
        write_text(text(document), directory / name)
    write_text(to_page(document, directory), directory / PAGE_FILE)


def write_text(text: str, path: Path) -> None:
    """Write one file; raises OutputError."""
    try:
        with beside(path) as partial:
            partial.write_text(text, "utf-8", "backslashreplace")  # names of files need not be UTF-8
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}; make room or name another") from error


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
    try:
        with path.open("a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}; name another") from error


def batch_csv(document: dict[str, Any]) -> str:
    """Return CSV with one line per run: its settings, its result, and its metrics under their names in run.json."""
    rows = io.StringIO()
    table = csv.writer(rows, lineterminator="\n")
    table.writerow([*_HEAD, "gates_failed", "baseline", "seconds", "directory", *FIGURES])
    for row in document["cells"]:
        failed = " ".join(gate["gate"] for gate in row["gates"] if not gate["passed"])
        more = [failed, (row["baseline"] or {}).get("change"), row["seconds"], row["directory"]]
        texts = [inert(value) for value in (*(row[key] for key in _HEAD), *more)]
        table.writerow([*texts, *(number(row["run"], name) for name in FIGURES)])
    return rows.getvalue()


TEXTS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {BATCH_FILE: to_json, "batch.csv": batch_csv}
