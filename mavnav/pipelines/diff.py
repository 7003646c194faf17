"""The pipeline of ``mavnav diff``: two maps -> alignment -> what changed between them -> document and picture."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from msgspec import Struct

from mavnav.config.models import Config
from mavnav.config.named_files import read_json
from mavnav.errors import ExitCode, UsageError, missing
from mavnav.ground_truth.map_file import map_files, read_map
from mavnav.kernels.machine.building import prepare
from mavnav.kernels.maps import raycast  # noqa: F401  it is compiled with the others
from mavnav.mapping.occupancy_grid import Grid, known_area, occupied_xy_m
from mavnav.metrics.gates import stored_verdict
from mavnav.metrics.map_difference import Difference, View, difference
from mavnav.outputs.directory import check_apart, check_file, checked_file, digests_of, document_of, write_file
from mavnav.outputs.files.gridmap import HITS_FILE, read_npz
from mavnav.outputs.pictures import difference_picture
from mavnav.outputs.report.summary_page import diff_summary, draw_png, write_summary
from mavnav.pipelines.maps import rounded_pose
from mavnav.pose import Pose
from mavnav.profiling import Progress
from mavnav.sessions.map_alignment import Alignment, align
from mavnav.slam.matching.prior_map import PriorMap, prior_map_of
from mavnav.units import MM, pluralize
from mavnav.version import DOCUMENT_HEAD

NUMBERS: Final = ("compared_m2", "same_share", "gone_m2", "new_m2", "changed_m2", "gone", "new", "moved")
"""Numbers of the document that gates may name; null where the maps cannot be aligned."""


LEAST_SAME: Final = 0.5
"""Least share of the walls that is the same in maps of one place of which all places agree; 1 if none did."""


class DiffRequest(Struct, frozen=True):
    """The two maps, run directories or map_server YAML files, and the picture and the page to write, if any."""

    a: Path
    b: Path
    picture: Path | None = None
    report: Path | None = None
    force: bool = False


def diff_maps(request: DiffRequest, progress: Progress) -> dict[str, Any]:
    """Compare two maps and return the document; raises UsageError for what is no map, and OutputError.

    The exit code in it is 1 where the maps cannot be aligned; then all numbers are null, and there is no picture.
    """
    check_file(request.picture, ".png", force=request.force)
    check_file(request.report, ".html", force=request.force)
    a, b = read_walls(request.a), read_walls(request.b)
    files = {"--output": request.picture, "--report": request.report}
    check_apart(files, (*map_files(request.a), *map_files(request.b)))
    prepare(progress)
    progress("aligning", 0, None)
    alignment, searched_all = align(a, b, Config())
    view_a, view_b = View(a.grid), View(b.grid)
    result = alignment and difference(view_a, view_b, alignment.a_T_b)
    if alignment is None or result is None or not are_of_one_place(alignment, result):
        document, picture = _document(request, None, None, searched_all=searched_all), None
    else:
        document = _document(request, alignment, result, searched_all=searched_all)
        title = f"{request.a} -> {request.b}"
        picture = partial(difference_picture.write, view_a, view_b, alignment.a_T_b, result, title)
    if request.picture or request.report:
        progress("writing", 0, None)
    if request.picture and picture:
        write_file(request.picture, picture, force=request.force)
    if request.report:
        summary = diff_summary(document, draw_png(picture) if picture else None)
        write_file(request.report, partial(write_summary, summary), force=request.force)
    return document


def are_of_one_place(alignment: Alignment, result: Difference) -> bool:
    """Return whether so many walls are the same as must be: the more, the fewer places agree on the alignment."""
    return result.same_share >= 1.0 - (1.0 - LEAST_SAME) * alignment.agreeing / alignment.taken


def read_grid(path: Path) -> tuple[Grid, Pose]:
    """Return the map of a run directory or a map_server YAML file and its pose in the map frame; raises UsageError."""
    if path.is_dir() or not path.exists():
        return read_walls(path).grid, Pose()
    file = read_map(path)
    return file.grid, file.map_T_grid


def read_walls(path: Path) -> PriorMap:
    """Read the map of a run directory, or the one that a map_server YAML file describes; raises UsageError."""
    if not path.exists():
        raise UsageError(missing(path, "name a run directory, or the YAML file of a map"))
    if path.is_dir():
        try:
            hits = path / HITS_FILE
            grid = known_area(read_npz(checked_file(path, HITS_FILE, digests_of(path)) if hits.is_file() else hits))
        except (OSError, ValueError) as error:
            reason = f"hits.npz: {error.strerror}" if isinstance(error, OSError) else error
            raise UsageError(f"{path} holds no map of a run ({reason}); name a run directory, or a map.yaml") from error
        known = PriorMap(grid, occupied_xy_m(grid))
    elif path.suffix.lower() not in {".yaml", ".yml"}:
        raise UsageError(f"{path} is no map; name a run directory (mavnav replay makes one from a log), or a map.yaml")
    else:
        file = read_map(path)
        known = prior_map_of(file.grid, file.map_T_grid)
    if not len(known.walls_xy_m):
        raise UsageError(f"{path}: the map has no occupied cell; name a map with walls")
    return known


def _document(
    request: DiffRequest, alignment: Alignment | None, result: Difference | None, *, searched_all: bool
) -> dict[str, Any]:
    numbers = _numbers(result) if result else dict.fromkeys(NUMBERS)
    return {
        **DOCUMENT_HEAD,
        "a": str(request.a),
        "b": str(request.b),
        "headline": diff_headline(numbers),
        "verdicts": {"a": run_verdict_at(request.a), "b": run_verdict_at(request.b)},
        "alignment": alignment
        and {
            **rounded_pose(alignment.a_T_b),
            "places": alignment.taken,
            "agreeing": alignment.agreeing,
            "rms_mm": round(alignment.cost_m2**0.5 / MM, 1),
        },
        "searched_all": searched_all,
        **numbers,
        "changes": [
            {
                "number": number,
                "kind": change.kind,
                "x_m": round(change.x_m, 3) + 0.0,
                "y_m": round(change.y_m, 3) + 0.0,
                "m2": round(change.m2, 4),
                "length_m": round(change.length_m, 3),
                "moved_with": None if change.moved_with is None else change.moved_with + 1,
            }
            for number, change in enumerate(result.changes if result else (), start=1)
        ],
        "exit_code": int(ExitCode.DONE if result else ExitCode.GATE_FAILED),
    }


def run_verdict_at(path: Path) -> dict[str, str] | None:
    """Return the verdict on the run or merge in a directory, None for a map file and for earlier versions."""
    with suppress(OSError, ValueError, AttributeError):
        return stored_verdict(read_json(file)) if (file := document_of(path)) else None
    return None


def diff_headline(numbers: Mapping[str, Any]) -> str:
    """Say first what changed, or that nothing did."""
    if numbers["compared_m2"] is None:
        return "The maps cannot be aligned: too few places of one fit the other."
    compared = f"{100 * numbers['same_share']:.1f} % of the walls are the same on {numbers['compared_m2']:.1f} m²."
    kinds = [(kind, numbers[kind], numbers[f"{kind}_m2"]) for kind in ("gone", "new")]
    changed = [f"{pluralize(count, 'place')} {kind} ({m2:.3f} m²)" for kind, count, m2 in kinds if count]
    moved = [f"{pluralize(numbers['moved'], 'object')} moved"] if numbers["moved"] else []
    return f"{', '.join([*changed, *moved]) or 'No change'}; {compared}"


def _numbers(result: Difference) -> dict[str, float]:
    gone_m2, new_m2 = result.m2("gone"), result.m2("new")
    areas_m2 = [round(m2, 4) for m2 in (gone_m2, new_m2, gone_m2 + new_m2)]
    kinds = [change.kind for change in result.changes]
    counts = kinds.count("gone"), kinds.count("new"), sum(c.moved_with is not None for c in result.changes) // 2
    values = round(result.compared_m2, 3), round(result.same_share, 4), *areas_m2, *counts
    return dict(zip(NUMBERS, values, strict=True))
