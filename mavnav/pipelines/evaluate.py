"""The pipeline of ``mavnav metrics``: a run directory or a map file -> metrics, references -> document."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.errors import MavnavError, UsageError, missing, reason_of
from mavnav.ground_truth.map_file import read_map
from mavnav.ground_truth.references import References, check_times, compare_to, in_time_of_truth
from mavnav.kernels.machine.building import prepare
from mavnav.logs import open_log
from mavnav.logs.formats.detect import is_named_like_a_log
from mavnav.mapping.occupancy_grid import Grid, occupied_xy_m
from mavnav.metrics.fields import ABSENT
from mavnav.metrics.gates import stored_verdict
from mavnav.metrics.ghost_walls import GhostWall
from mavnav.metrics.journey import Journey, one_after_another
from mavnav.metrics.map_quality import MapQuality, measure_map
from mavnav.metrics.wall_spread import wall_report
from mavnav.metrics.walls import StraightWall, half_turn
from mavnav.outputs.directory import MERGE_FILE, RUN_FILE, WHOLE_AGAIN
from mavnav.outputs.files.document import plain
from mavnav.outputs.files.finished_run import FinishedRun, RunRecord, finished_run
from mavnav.outputs.files.gridmap import HITS_FILE, read_npz
from mavnav.pipelines.maps import with_true_map_placed, with_walls_moved
from mavnav.pipelines.sessions import mapped_share, poses_of
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.profiling import Progress
from mavnav.slam.findings import NOT_PLANAR
from mavnav.units import DEG, MM, NS
from mavnav.version import DOCUMENT_HEAD

NEEDED_FILES: Final = (HITS_FILE, "trajectory.tum", "result.mcap")
"""Files of a run that are measured, besides its document."""
LATE_S: Final = 1e-3
"""Times are written in s to about 1 us."""

Place = TypeVar("Place", GhostWall, StraightWall)


class Subject(Struct, frozen=True):
    """What is measured: a map, where its cells lie in the map frame, and the scans behind it where they are known.

    ``verdict`` is that of the run, if it has one. ``begins_late`` is set where the map frame is that of a later scan
    than the first one of the log; ``map_T_begin`` is where that scan was put, if not at the origin. The poses hold
    ``holds_s`` after their stamps, and a true pose with the stamp of a scan at its beam ``truth_at``.
    """

    kind: str
    grid: Grid
    map_T_grid: Pose
    journey: Journey | None = None
    begins_late: bool = False
    map_T_begin: Pose | None = None
    verdict: dict[str, str] | None = None
    holds_s: float = 0.0
    truth_at: str = "first"

    @property
    def has_counts(self) -> bool:
        """Whether hits and crossings are counts; a map file only separates occupied from free."""
        return self.kind != "map"

    @property
    def trajectory(self) -> Trajectory | None:
        """The tracked poses of the laser, map_T_laser, where they are known; those of a merge are of several tracks."""
        return self.journey.map_T_laser if self.journey and self.kind == "run" else None


def evaluate(paths: list[Path], references: References, progress: Progress) -> dict[str, Any]:
    """Measure run directories and map files.

    Raises UsageError for what is neither, for references of poses without a run, and if no run has a pose.
    """
    subjects = [subject(path) for path in paths]
    if all(what.trajectory is not None and not len(what.trajectory) for what in subjects):
        named = ", ".join(map(str, paths))
        raise UsageError(f"no scan of {named} has a pose: nothing to measure; examine the log with 'mavnav info'")
    if references.of_poses and all(what.trajectory is None for what in subjects):
        raise UsageError(f"{paths[0]}: a map has no poses; --truth and --relations need a run directory")
    prepare(progress)
    documents = []
    for number, (path, what) in enumerate(zip(paths, subjects, strict=True)):
        progress("measuring", number, len(paths))
        documents.append(_document(path, what, references))
    return {**DOCUMENT_HEAD, "maps": documents}


def subject(path: Path) -> Subject:
    """Read a run directory, or the map that a map_server YAML file describes; raises UsageError."""
    if path.is_dir():
        return _run(path)
    if not path.exists():
        raise UsageError(missing(path, "name a run directory, or the YAML file of a map"))
    if is_named_like_a_log(path):
        raise UsageError(f"{path} is a log; map it with 'mavnav replay {path}', and name that run")
    file = read_map(path)
    return Subject("map", file.grid, file.map_T_grid)


def _run(directory: Path) -> Subject:
    if not (directory / RUN_FILE).is_file():
        raise UsageError(f"{directory} holds no run (no {RUN_FILE}); name a run directory, or the YAML file of a map")
    if (directory / MERGE_FILE).is_file():
        return _merge(finished_run(directory))
    if missing_files := [name for name in NEEDED_FILES if not (directory / name).exists()]:
        raise UsageError(f"{directory} is no whole run: it has no {', '.join(missing_files)}; {WHOLE_AGAIN}")
    run = finished_run(directory)
    if not isinstance(run.record, RunRecord):
        raise UsageError(f"{directory} is no whole run: its {RUN_FILE} is of a merge; make it again")
    record, tracking = run.record, run.record.tracking
    hits, poses, recording = (run.file(name) for name in NEEDED_FILES)
    map_T_laser = poses_of(run, poses.name)
    if record.scans.accepted and not len(map_T_laser):
        reason = f"{poses.name} is empty; make it again with mavnav replay --force"
        raise UsageError(f"{directory} is no whole run: {reason}")
    with _reading(directory, "replay"):
        grid = read_npz(hits)
        journey = Journey(
            map_T_laser=map_T_laser,
            scans=open_log(recording, odom="off").scans if len(map_T_laser) else tuple,
            mapped_share=record.scans.accepted / max(record.scans.processed, 1),
            lost_for_good=tracking.lost,
            planar=NOT_PLANAR not in (tracking.reasons or ()),
        )
    late, verdict = _begins_late(record, map_T_laser), stored_verdict(run.document)
    at = record.alignment
    begin = Pose(at.x_m, at.y_m, at.yaw_deg * DEG) if at else None
    return Subject("run", grid, Pose(), journey, late, begin, verdict, tracking.holds_s, record.config.truth_at)


@contextmanager
def _reading(directory: Path, command: str) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError, ZeroDivisionError, MavnavError) as error:
        reason, again = reason_of(error), f"make it again with mavnav {command} --force"
        raise UsageError(f"{directory} is no whole run: {reason}; {again}") from error


def _merge(run: FinishedRun) -> Subject:
    """Read a merge, whose frame is that of one of its sessions."""
    files = [(poses_of(run, each.trajectory), run.file(each.recording)) for each in run.record.stored_sessions]
    with _reading(run.directory, "merge"):
        tracks = [(poses, open_log(recording, odom="off").scans) for poses, recording in files]
        journey = one_after_another(tracks, mapped_share(run.document["sessions"]))
        grid = read_npz(run.file(HITS_FILE))
    return Subject("merge", grid, Pose(), journey, begins_late=True, verdict=stored_verdict(run.document))


def _begins_late(record: RunRecord, map_T_laser: Trajectory) -> bool:
    """Return whether the map of a run begins with a later scan than the first one of its log."""
    options, first_s = record.provenance and record.provenance.options, record.input.first_stamp_s
    if first_s is None or (options and (options.map or options.continue_from)) or not len(map_T_laser):
        return False
    return bool(options and options.start_s) or map_T_laser.stamps_ns[0] * NS - first_s > LATE_S


def _document(path: Path, what: Subject, references: References) -> dict[str, Any]:
    grid = what.grid
    if what.trajectory is not None and len(what.trajectory):
        check_times(references, *(int(what.trajectory.stamps_ns[k]) for k in (0, -1)))
    measured = measure_map(grid, what.journey, counted=what.has_counts)
    if references.of_first_scan and what.begins_late:
        reason = "its map begins after the first scan of the mission, to which the walls of a scenario are relative"
        raise UsageError(f"{path}: {reason}; give the true walls as a map file in the frame of the map")
    sections = measured.sections if what.has_counts else {}  # a map file has no counts
    references = with_walls_moved(references, what.map_T_begin)
    held = what.trajectory and in_time_of_truth(what.trajectory, what.holds_s, what.truth_at)
    references = with_true_map_placed(references, grid, Config(), None if what.has_counts else what.map_T_grid)
    reference = compare_to(references, held, transform_points(what.map_T_grid, occupied_xy_m(grid)))
    document: dict[str, Any] = plain(
        {
            "path": str(path),
            "kind": what.kind,
            "verdict": what.verdict or ABSENT,
            "cell_mm": grid.cell_m / MM,
            "wall_thickness": wall_report(sections, measured.published, measured.cuts, grid.cell_m),
            "map_quality": _to_map_frame(measured.quality, what.map_T_grid),
            "reference": reference or ABSENT,
        }
    )
    return document


def _to_map_frame(quality: MapQuality, map_T_grid: Pose) -> MapQuality:
    """Bring the places of a map file's walls to the map frame."""
    ghosts = quality.ghost_walls
    places = tuple(_transform_place(place, map_T_grid) for place in ghosts.places)
    walls = tuple(_transform_place(wall, map_T_grid) for wall in quality.walls)
    return replace(quality, ghost_walls=replace(ghosts, places=places), walls=walls)


def _transform_place(place: Place, a_T_b: Pose) -> Place:
    turned = a_T_b @ Pose(place.x_m, place.y_m, place.direction_deg * DEG)
    return replace(place, x_m=turned.x_m, y_m=turned.y_m, direction_deg=half_turn(turned.yaw_rad) / DEG)
