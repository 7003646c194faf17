"""Outputs: the files of a run, each by one writer, and the directory that holds them.

A new file is one function ``(RunResult, Path) -> None`` and one line in `GROUPS`.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from mavnav.errors import UsageError
from mavnav.outputs.directory import RUN_FILE, atomic_directory, file_sha256
from mavnav.outputs.files.document import plain, plain_json, run_document, with_picture, write_metrics
from mavnav.outputs.files.gridmap import write_npz, write_pgm, write_yaml
from mavnav.outputs.files.sessions import recording_file, trajectory_file, write_poses, write_scans
from mavnav.outputs.files.slices_files import slice_files, write_slice
from mavnav.outputs.files.trajectory import (
    TRUE_WALLS_FILE,
    write_base_tum,
    write_csv,
    write_true_walls,
    write_truth_tum,
    write_tum,
)
from mavnav.profiling import Stage

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from mavnav.outputs.run import RunResult

    Writer = Callable[[RunResult, Path], None]

REPORT_FILE: Final = "report.html"


def _late(module: str, run: RunResult, path: Path) -> None:
    """Call the ``write`` of a module that imports a heavy library, so that nobody waits for it before."""
    import_module(f"mavnav.outputs.{module}").write(run, path)


GROUPS: Final[dict[str, dict[str, Writer]]] = {
    "trajectory": {
        "trajectory.tum": write_tum,
        "trajectory_base.tum": write_base_tum,
        "trajectory.csv": write_csv,
        "truth.tum": write_truth_tum,
        TRUE_WALLS_FILE: write_true_walls,
    },
    "map": {"map.pgm": write_pgm, "map.yaml": write_yaml, "hits.npz": write_npz},
    "metrics": {"walls.csv": partial(_late, "files.wall_table"), "metrics.json": write_metrics},
    "pictures": {
        "wall_thickness.png": partial(_late, "pictures.wall_picture"),  # first: smaller pictures reuse its memory
        "map.png": partial(_late, "pictures.map_picture"),
        "true_map.png": partial(_late, "pictures.mission_picture"),
    },
    "mcap": {
        "result.mcap": partial(_late, "files.replay_log"),
        "foxglove_layout.json": partial(_late, "files.foxglove_layout"),
    },
    "report": {},
    "slices": {"map_3d.png": partial(_late, "pictures.slices_picture")},
    "svg": {"map.svg": partial(_late, "pictures.vector_map")},
    "scale": dict.fromkeys(("map_scale.png", "map_scale.yaml"), partial(_late, "pictures.scale_map")),
    "graph": {"pose_graph.g2o": partial(_late, "files.graph_file")},
}
"""The files of a run and their writers, in groups by the names of ``--outputs``; run.json is always written.

The page is written last. Files of slices are named by height.
"""

WRITERS: Final[dict[str, Writer]] = {name: write for files in GROUPS.values() for name, write in files.items()}

ALL: Final = "all"
"""The name of all groups."""

_IF_NAMED: Final = {"report", "svg", "scale", "graph"}
"""The groups that are not written by default."""

_OF_PAGE: Final = {"trajectory", "map"}
"""The groups that a page is drawn from."""


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
    """Write the files of a run and return its document, which is run.json; with ``report`` its page as well.

    ``groups`` are the `GROUPS` of files to write, by default all but the page and those that must be named. The
    directory appears complete or not at all. Raises OutputError where it exists (and ``force`` does not say to replace
    it), holds something else than a run, or cannot be written.
    """
    with atomic_directory(directory, force=force) as folder:
        names = _names(run, groups)
        digests = {name: _write(WRITERS.get(name, write_slice), run, folder / name) for name in names}
        for name, write in _of_sessions(run, names).items():
            digests[name] = _write(write, run, folder / name)
        document: dict[str, Any] = plain(run_document(run, digests))
        document["warnings"] = [with_picture(line, digests) for line in document["warnings"]]
        path = folder / RUN_FILE
        path.write_text(plain_json(document), encoding="utf-8")
        if report:
            write_page(import_module("mavnav.outputs.report").single(document), folder)
    return document


def write_page(comparison: dict[str, Any], folder: Path) -> None:
    """Write report.html and its pictures of runs below a folder; it shows what their files say, so it comes after."""
    import_module("mavnav.outputs.report").write_report(comparison, folder, folder / REPORT_FILE)


def _names(run: RunResult, groups: Collection[str] | None) -> list[str]:
    """Return the wanted files that can be written: some need more than every log contains."""
    chosen = GROUPS.keys() - _IF_NAMED if groups is None else GROUPS if ALL in groups else groups
    wanted = {name for group in chosen for name in GROUPS[group]}
    known = {"trajectory_base.tum": run.log.base_T_laser is not None}
    known["pose_graph.g2o"] = run.slam.loops.graph is not None
    known |= dict.fromkeys(("truth.tum", "true_map.png"), run.truth is not None)
    known[TRUE_WALLS_FILE] = run.true_walls is not None
    known["map_3d.png"] = run.slices is not None
    by_height = slice_files(run.slices.layers) if run.slices and "slices" in chosen else []
    return [*(name for name in WRITERS if name in wanted and known.get(name, True)), *by_height]


def _of_sessions(run: RunResult, names: Collection[str]) -> dict[str, Callable[[RunResult, Path], None]]:
    """Return the files of the sessions of a continued run, with their writers: of the groups that are written."""
    writers: dict[str, Callable[[RunResult, Path], None]] = {}
    for number, session in enumerate(run.earlier):
        if "trajectory.tum" in names:
            writers[trajectory_file(session.name)] = partial(_poses_of, number)
        if "result.mcap" in names:
            writers[recording_file(session.name)] = partial(_scans_of, number)
    return writers


def _poses_of(number: int, run: RunResult, path: Path) -> None:
    write_poses(run.earlier[number].map_T_laser, path)


def _scans_of(number: int, run: RunResult, path: Path) -> None:
    write_scans(run.earlier[number].scans(), path)


def _write(write: Callable[[RunResult, Path], None], run: RunResult, path: Path) -> str:
    """Write one file and return its SHA-256."""
    with Stage("pictures" if path.suffix == ".png" else "outputs"):
        write(run, path)
        return file_sha256(path)
