"""Outputs: the files of a run, each by one writer, and the directory that holds them.

A new file is one function ``(RunResult, Path) -> None`` and one line in `GROUPS`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from mavnav.errors import UsageError
from mavnav.outputs.directory import RUN_FILE, atomic_directory, file_sha256
from mavnav.outputs.files import gridmap, trajectory
from mavnav.outputs.files.document import plain, plain_json, run_document, with_picture, write_metrics
from mavnav.outputs.run import RunResult
from mavnav.profiling import Stage

Writer = Callable[[RunResult, Path], None]
FileWriter = Callable[[Path], None]

REPORT_FILE: Final = "report.html"


def _late(module: str, run: RunResult, path: Path, writer: str = "write") -> None:
    """Call the writer of a module that imports a heavy library, so that nobody waits for it before."""
    getattr(import_module(f"mavnav.outputs.{module}"), writer)(run, path)


GROUPS: Final[dict[str, dict[str, Writer]]] = {
    "trajectory": {
        "trajectory.tum": trajectory.write_tum,
        "trajectory_base.tum": trajectory.write_base_tum,
        "trajectory.csv": trajectory.write_csv,
        "truth.tum": trajectory.write_truth_tum,
        trajectory.TRUE_WALLS_FILE: trajectory.write_true_walls,
    },
    "map": {"map.pgm": gridmap.write_pgm, "map.yaml": gridmap.write_yaml, "hits.npz": gridmap.write_npz},
    "metrics": {"walls.csv": gridmap.write_walls, "metrics.json": write_metrics},
    "pictures": {
        "wall_thickness.png": partial(_late, "pictures.wall_picture"),  # first: smaller pictures reuse its memory
        "map.png": partial(_late, "pictures.map_picture"),
        "true_map.png": partial(_late, "pictures.map_picture", writer="write_true_map"),
    },
    "mcap": {
        "result.mcap": partial(_late, "files.replay_log"),
        "foxglove_layout.json": partial(_late, "files.replay_log", writer="write_layout"),
    },
    "report": {},
    "slices": {"map_3d.png": partial(_late, "pictures.slices_picture")},
    "svg": {"map.svg": partial(_late, "pictures.vector_map")},
    "scale": {"map_scale.png": gridmap.write_scale, "map_scale.yaml": gridmap.write_scale},
    "graph": {"pose_graph.g2o": trajectory.write_graph},
}
"""The files of a run and their writers, in groups by the names of ``--outputs``; run.json is always written.

The page is written last. Files of slices are named by height.
"""

WRITERS: Final[dict[str, Writer]] = {name: write for files in GROUPS.values() for name, write in files.items()}

ALL: Final = "all"
"""The name of all groups."""

_IF_NAMED: Final = {"report", "svg", "scale", "graph"}
"""The groups that are not written by default."""

_WHY_EMPTY: Final = {
    "slices": "the heights of the scans are not known",
    "graph": "the path returns nowhere, or no loop was looked for",
}
"""The groups that a run may have no file of -> why."""

_OF_PAGE: Final = {"trajectory", "map"}
"""The groups that a page is drawn from."""

WITHOUT_MAP: Final = {"trajectory", "graph"}
"""The groups for which no map is drawn or measured."""


def check_groups(names: Collection[str]) -> None:
    """Raise UsageError for a name that is no group of files, and for a page without the files that it is drawn from."""
    for name in names:
        if name not in {*GROUPS, ALL}:
            raise UsageError(f"--outputs: unknown {name!r}; known are {', '.join(GROUPS)}, {ALL}")
    if "report" in names and ALL not in names and not set(names) >= _OF_PAGE:
        raise UsageError("--outputs: report is drawn from trajectory and map; add them")


def write_run(
    run: RunResult, directory: Path, *, force: bool = False, report: bool = False, groups: Collection[str] | None = None
) -> dict[str, Any]:
    """Write the files of a run and return its document, which is run.json; with ``report`` its page, report.html, too.

    ``groups`` are the `GROUPS` of files to write, by default all but the page and those that must be named. The
    directory appears complete or not at all. Raises OutputError where it exists (and ``force`` does not say to replace
    it), holds something else than a run, or cannot be written.
    """
    with atomic_directory(directory, force=force) as folder:
        writers = _writers(run, groups)
        digests = {name: _write(write, folder / name) for name, write in writers.items()}
        document: dict[str, Any] = plain(run_document(run, digests))
        document["warnings"] = [with_picture(line, digests) for line in document["warnings"]]
        empty = [name for name in _WHY_EMPTY if name in (groups or ()) and digests.keys().isdisjoint(GROUPS[name])]
        document["warnings"] += [f"no {name} written: {_WHY_EMPTY[name]}" for name in empty]
        document["verdict"]["advice"] = with_picture(document["verdict"]["advice"], digests)
        (folder / RUN_FILE).write_text(plain_json(document), encoding="utf-8")
        if report:
            with Stage("page"):
                pages = import_module("mavnav.outputs.report.page")
                page = pages.page_text(pages.single(document), folder, run)
                (folder / REPORT_FILE).write_text(page, "utf-8", "backslashreplace")  # names need not be UTF-8
    return document


def write_page(comparison: dict[str, Any], folder: Path) -> None:
    """Write report.html of a comparison, and its pictures, into the folder that has the runs below it."""
    import_module("mavnav.outputs.report.page").write_report(comparison, folder, folder / REPORT_FILE)


def _writers(run: RunResult, groups: Collection[str] | None) -> dict[str, FileWriter]:
    """Return the wanted files that can be written, with their writers: some need more than every log contains.

    A continued run has files of its earlier sessions too, of the groups that are written.
    """
    chosen = GROUPS.keys() - _IF_NAMED if groups is None else GROUPS if ALL in groups else groups
    names = {name for group in chosen for name in GROUPS[group]}
    needed = {
        "trajectory_base.tum": run.log.base_T_laser,
        "pose_graph.g2o": run.slam.loops.graph,
        "truth.tum": run.truth,
        "true_map.png": run.truth,
        trajectory.TRUE_WALLS_FILE: run.true_walls,
        "map_3d.png": run.slices,
    }
    names -= {name for name, value in needed.items() if value is None}
    writers: dict[str, FileWriter] = {name: partial(write, run) for name, write in WRITERS.items() if name in names}
    if run.slices and "slices" in chosen:
        writers |= dict.fromkeys(gridmap.slice_files(run.slices.layers), partial(gridmap.write_slice, run))
    for session in run.earlier:
        poses, recording = trajectory.session_files(session.name)
        if "trajectory.tum" in names:
            writers[poses] = partial(trajectory.write_poses, session.map_T_laser)
        if "result.mcap" in names:
            writers[recording] = partial(trajectory.write_scans, session.scans)
    return writers


def _write(write: FileWriter, path: Path) -> str:
    """Write one file and return its SHA-256."""
    with Stage("pictures" if path.suffix == ".png" else "outputs"):
        write(path)
        return file_sha256(path)
