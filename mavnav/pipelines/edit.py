"""The pipeline of ``mavnav edit``: a finished map, edited on purpose, written beside it with digests that hold."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.config.named_files import read_json
from mavnav.errors import UsageError
from mavnav.ground_truth.map_file import map_files
from mavnav.mapping.map_edits import MapEdits, Rectangle, edit_grid
from mavnav.mapping.occupancy_grid import OCCUPIED, UNKNOWN, Grid, occupancy
from mavnav.outputs import directory
from mavnav.outputs.documents.provenance import shell_line
from mavnav.outputs.documents.run_json import METRICS
from mavnav.outputs.documents.verdict import Verdict
from mavnav.outputs.files import gridmap
from mavnav.outputs.files.document import plain, to_json
from mavnav.outputs.files.finished_run import MergeRecord, RunRecord, finished_run
from mavnav.outputs.files.gridmap import HITS_FILE, GridMap, map_section, write_npz, write_pgm, write_yaml, yaml_text
from mavnav.outputs.pictures.map_picture import write_merged
from mavnav.outputs.run import picture_turn_rad
from mavnav.pipelines.diff import read_grid
from mavnav.pipelines.sessions import poses_of
from mavnav.pose import Pose
from mavnav.profiling import Progress
from mavnav.version import DOCUMENT_HEAD

KEPT: Final = (".tum", ".csv", ".mcap", ".json", ".g2o")
"""Files of a run that are copied; pictures, pages and slices would show the map before."""

METRICS_FILE: Final = "metrics.json"

MARK: Final = "# edited: "
"""Before the command line in the YAML file of an edited map."""


def read_edits(erase: Sequence[str], unknown: Sequence[str], crop: str | None, *, keep_largest: bool) -> MapEdits:
    """Read the edits as the command line has them; raises UsageError where there is none, or one that is none."""
    if not (erase or unknown or crop or keep_largest):
        raise UsageError("nothing to change; give --crop, --erase, --unknown or --keep-largest")
    erased = tuple(_rectangle("--erase", text) for text in erase)
    forgotten = tuple(_rectangle("--unknown", text) for text in unknown)
    return MapEdits(erased, forgotten, _rectangle("--crop", crop) if crop else None, keep_largest)


def _rectangle(option: str, text: str) -> Rectangle:
    """Read ``X0,Y0,X1,Y1``, two opposite corners; raises UsageError where it is none, or has no area."""
    try:
        x0, y0, x1, y1 = (float(word) for word in text.split(","))
    except ValueError:
        x0 = y0 = x1 = y1 = np.nan
    rectangle = Rectangle(min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1))
    if not (np.isfinite(rectangle).all() and x0 != x1 and y0 != y1):
        advice = f"write two corners in m, X0,Y0,X1,Y1, as in {option} -2,-1,8,6"
        raise UsageError(f"{option} {text}: no rectangle; {advice}")
    return rectangle


class EditRequest(Struct, frozen=True):
    """A run directory or the YAML file of a map, what to change on it, and the directory or YAML file to write."""

    path: Path
    edits: MapEdits
    target: Path
    force: bool = False

    @property
    def command(self) -> str:
        """The command line that repeats this from any folder."""
        edits = self.edits
        pairs = [*(("erase", r) for r in edits.erase), *(("unknown", r) for r in edits.unknown)]
        pairs += [("crop", edits.crop)] if edits.crop else []
        words = [f"--{name}={','.join(map(repr, rectangle))}" for name, rectangle in pairs]
        words += ["--keep-largest"] * edits.keep_largest
        return shell_line(["mavnav", "edit", str(self.path.absolute()), *words])


def edit_map(request: EditRequest, progress: Progress) -> dict[str, Any]:
    """Edit a map and return the document; raises UsageError, also where no wall is left, and OutputError."""
    is_run = request.path.is_dir()
    progress("editing", 0, None)
    grid, map_T_grid = read_grid(request.path)
    _check_target(request, is_run=is_run)  # its suffix depends on what the input is
    edited = edit_grid(grid, request.edits, map_T_grid)
    old, new = occupancy(grid), occupancy(edited)
    if not (new == OCCUPIED).any():
        advice = "name other rectangles, in m from the origin of the map"
        raise UsageError(f"{request.path}: no wall would be left; {advice}")
    corner = map_T_grid @ Pose(*edited.origin_xy_m, 0.0)
    if is_run:
        _write_run(request, edited)
    else:
        _write_map(request, edited, corner)
    counts = [{"occupied": int((c == OCCUPIED).sum()), "known": int((c != UNKNOWN).sum())} for c in (old, new)]
    section = plain(map_section(edited, np.nan)) | {"origin_xy_m": [corner.x_m, corner.y_m]}
    return {
        **DOCUMENT_HEAD,
        "input": str(request.path),
        "output": str(request.target),
        "command": request.command,
        "cells": {"before": counts[0], "after": counts[1]},
        "map": {name: section[name] for name in ("cell_mm", "size_m", "origin_xy_m")},
    }


def _check_target(request: EditRequest, *, is_run: bool) -> None:
    """Raise UsageError or OutputError where the result cannot be put; the input is never overwritten."""
    if is_run:
        directory.check_directory(request.target, force=request.force, inputs=[request.path])
        return
    picture = request.target.with_suffix(".pgm")
    directory.check_file(request.target, ".yaml", force=request.force)
    directory.check_file(picture, ".pgm", force=request.force)
    directory.check_apart({"--output": request.target, "its picture": picture}, map_files(request.path))


def _write_map(request: EditRequest, edited: Grid, corner: Pose) -> None:
    """Write YAML file and picture of an edited map; its first lines are the command lines of all edits."""
    earlier = request.path.read_text(encoding="utf-8", errors="replace").splitlines()
    marks = [*(line for line in earlier if line.startswith(MARK)), f"{MARK}{request.command}"]
    picture = request.target.with_suffix(".pgm")
    text = yaml_text(GridMap(replace(edited, origin_xy_m=corner[:2])), picture.name, yaw_rad=corner.yaw_rad)
    content = "\n".join([*marks, text]).encode(errors="backslashreplace")
    directory.write_file(picture, partial(write_pgm, GridMap(edited)), force=request.force)
    directory.write_file(request.target, lambda path: path.write_bytes(content), force=request.force)


def _turn_rad(folder: Path, record: RunRecord | MergeRecord) -> float:
    """Return how far the picture is turned to the walls of a table, which may come from a stranger; 0 without one."""
    origin = record.provenance if isinstance(record, RunRecord) else None
    with suppress(OSError, ValueError), np.errstate(all="ignore"):
        return picture_turn_rad(gridmap.read_cuts(folder / gridmap.WALLS_FILE), origin and origin.options)
    return 0.0


def _write_run(request: EditRequest, edited: Grid) -> None:
    """Write a run or merge with an edited map; its verdict and metrics stay, because an edit does not mend them."""
    run, drawn = finished_run(request.path), GridMap(edited)
    files = [request.path / name for name in (directory.RUN_FILE, directory.MERGE_FILE)]
    documents = {file.name: read_json(file) for file in files if file.is_file()}
    own = documents[directory.RUN_FILE]
    own["map"] = plain(map_section(edited, own["map"]["accepted_share"]))
    own.pop("slices", None)
    with directory.atomic_directory(request.target, force=request.force) as folder:
        for name in run.record.outputs:
            if name.endswith(KEPT) and (request.path / name).exists():
                shutil.copyfile(run.file(name), folder / name)
        write_pgm(drawn, folder / "map.pgm")
        write_yaml(drawn, folder / "map.yaml")
        write_npz(drawn, folder / HITS_FILE)
        paths = {each.name: poses_of(run, each.trajectory) for each in run.record.stored_sessions}
        turn_rad = _turn_rad(folder, run.record)
        write_merged(drawn, paths, Verdict(**own["verdict"]), folder / "map.png", turn_rad)
        if (folder / METRICS_FILE).exists():
            (folder / METRICS_FILE).write_text(to_json({k: own[k] for k in METRICS if k in own}), encoding="utf-8")
        digests = {file.name: directory.file_sha256(file) for file in sorted(folder.iterdir())}
        for name, document in documents.items():
            (folder / name).write_text(to_json(_mark(document, digests, request.command)), encoding="utf-8")


def _mark(document: dict[str, Any], digests: dict[str, str], command: str) -> dict[str, Any]:
    """Return a document with the digests of its files and the command line of the edit."""
    origin = document.get("provenance") or {}
    return document | {
        "provenance": origin | {"edits": [*origin.get("edits", ()), command]},
        "warnings": [*document.get("warnings", ()), f"the map was edited: {command}"],
        "outputs": digests,
    }
