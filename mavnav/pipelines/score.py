"""The pipeline of ``mavnav score``: a log and trajectories of other programs -> a run directory for each of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Final, NamedTuple, cast

from msgspec import Struct
from msgspec.structs import replace

from mavnav.config.loading import to_scalar
from mavnav.config.models import Config
from mavnav.config.options import REFERENCES, ReplayOptions, paths_of, reference_files, words_of
from mavnav.errors import ProgramError, UsageError
from mavnav.ground_truth.references import SWEEPS, References, in_time_of_truth, load_references
from mavnav.ground_truth.tables import read_trajectory
from mavnav.logs import Log
from mavnav.logs.formats.detect import log_name
from mavnav.outputs.directory import check_directory
from mavnav.outputs.documents.provenance import provenance
from mavnav.outputs.documents.run_json import External, StartPose
from mavnav.outputs.documents.sections import PoseJump
from mavnav.outputs.run import RunResult, Timing, half_sweep_s
from mavnav.outputs.writers import write_run
from mavnav.pipelines.again import changed_values
from mavnav.pipelines.maps import check_references, comparison_fields, config_for_log, measured_map, references_in_map
from mavnav.pipelines.replay import ReplayRequest, open_request, with_corrected_odometry
from mavnav.pipelines.trajectory_source import LASER, WHOLE, Program, TrajectorySource, run_program
from mavnav.pose import Pose, Trajectory
from mavnav.profiling import Progress, new_profile
from mavnav.slam.given_poses import draw_at_poses
from mavnav.slam.matching.differences import differences
from mavnav.slam.matching.odometry_fit import FittedOdometry
from mavnav.slam.methods.registry import load_kernels
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries.floor_line import floor_warning
from mavnav.units import DEG, MM, NS

BASE: Final = "base"
PROGRAMS: Final = "programs"
"""Folder of what programs write and print."""


class ScoreRequest(ReplayRequest, frozen=True, kw_only=True):
    """The trajectories to score on a log, and the programs that find some within ``limit_s``; how maps are drawn.

    ``directory`` has a folder for each run, or is that of the only run if that is ``alone``.
    """

    sources: tuple[TrajectorySource, ...] = ()
    programs: tuple[Program, ...] = ()
    limit_s: float = 3600.0
    alone: bool = False

    @property
    def usual_name(self) -> str:
        """The usual name of the directory of a program's run."""
        return f"{log_name(self.log)}-{self.programs[0].name}"

    def directory_of(self, name: str) -> Path:
        """Return the directory of the run of a trajectory."""
        return self.directory if self.alone else self.directory / name


SCORED_OPTIONS: Final = ("topic", "odom", "start_s", "end_s", "attitude", "extrinsic", "strict", *REFERENCES)
"""Options of a replay that hold for given poses, too."""


def scored_options(options: ReplayOptions[Path]) -> ReplayOptions[Path]:
    """Return those of the options of a replay that hold for given poses."""
    return cast("ReplayOptions[Path]", {name: value for name, value in options.items() if name in SCORED_OPTIONS})


class Scored(NamedTuple):
    """A trajectory that was scored: its name, which is that of its directory, and its run.json, or why it has none."""

    name: str
    document: dict[str, Any] | None
    error: str = ""


class _GivenPoses(Struct, frozen=True):
    """A trajectory of the laser, what its poses were of, what a program took to write it, and mavnav's own poses."""

    source: TrajectorySource
    world_T_laser: Trajectory
    frame: str
    warnings: tuple[str, ...] = ()
    program: dict[str, Any] = {}
    own: Trajectory | None = None


def score_log(request: ScoreRequest, progress: Progress) -> list[Scored]:
    """Draw and judge the scans at the poses of every trajectory and every program.

    What can be wrong with log, files and directories is found before the first program is run. Raises UsageError,
    TopicError, NoScansError and OutputError; a program that fails is a result without a document.
    """
    names = check_names(request.sources, request.programs)
    inputs = (request.log, *request.more, *paths_of(request.options))
    files = [source.path for source in request.sources if source.in_log is None]
    for name in names:
        check_directory(request.directory_of(name), force=request.force, inputs=(*inputs, *files))
    references = load_references(**reference_files(request.options))
    progress("reading", 0, None)
    log = open_request(request, progress, odom=request.config.odom, truth=request.recorded_truth)
    log = with_corrected_odometry(log, request.config)
    check_references(references, log, request.options, own_frame=True)
    poses = [_read(source, request, log, progress) for source in request.sources]
    config, warnings = config_for_log(request.config, log)
    load_kernels(config, progress)
    log = replace(log, warnings=(*warnings, *log.warnings))
    request = replace(request, config=config)
    own = cache(partial(own_run, config=config, progress=progress))

    @cache
    def by_odometry() -> tuple[FittedOdometry | None, Log]:
        return confirmed_odometry(log, own(log, whole=True) if log.odometry else None)

    def score(given: _GivenPoses) -> Scored:
        wheels, cut = by_odometry()
        run = own(log, whole=True) if given.source.pose_at == WHOLE else own(cut, whole=False)
        given = replace(given, own=run.trajectory if run else None)
        return Scored(given.source.name, _score(given, request, cut, wheels, references, progress))

    scored = [score(each) for each in poses]
    for program in request.programs:
        progress(program.name, 0, None)
        try:
            given = _poses_of_program(program, request, log, progress)
        except ProgramError as error:
            scored.append(Scored(program.name, None, str(error)))
        else:
            scored.append(score(given))
    return scored


def score_program(request: ScoreRequest, progress: Progress) -> None:
    """Run the only program of a request on a log, and judge its poses.

    Raises as `score_log`, and ProgramError for a program without poses.
    """
    (scored,) = score_log(request, progress)
    if scored.document is None:
        raise ProgramError(scored.error)


def check_names(sources: Sequence[TrajectorySource], programs: Sequence[Program]) -> list[str]:
    """Return the names of trajectories and programs; raises UsageError for none, and for names that cannot be used."""
    names = [*(source.name for source in sources), *(program.name for program in programs)]
    if not names:
        raise UsageError("no trajectory; name one with --trajectory, or a program with --external")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UsageError(f"two trajectories are named {twice[0]}; write NAME=FILE with another name for one of them")
    if PROGRAMS in names:
        raise UsageError(f"{PROGRAMS} is the folder of what programs write; give the trajectory another name")
    return names


def _poses_of_program(program: Program, request: ScoreRequest, log: Log, progress: Progress) -> _GivenPoses:
    """Run a program on the log and return what it wrote; raises ProgramError where that cannot be used."""
    run = request.directory_of(program.name)
    file = run.parent / PROGRAMS / f"{run.name}.tum"
    cost = run_program(program, request.log, file, request.limit_s)
    if cost.problem:
        raise ProgramError(cost.problem)
    try:
        poses = _read(TrajectorySource(program.name, str(file), LASER), request, log, progress)
    except UsageError as error:
        raise ProgramError(str(error)) from error
    measured = {"wall_s": cost.wall_s, "cpu_s": cost.cpu_s, "peak_memory_mb": cost.peak_memory_mb}
    return replace(poses, program={"source": program.command, **measured})


def _read(source: TrajectorySource, request: ScoreRequest, log: Log, progress: Progress) -> _GivenPoses:
    """Read the poses of the laser; raises UsageError for those of another time, and for a frame without a mounting."""
    warnings: tuple[str, ...] = ()
    if source.in_log is not None:
        truth = open_request(request, progress, odom="off", truth=source.in_log).truth
        path, frame = (truth.world_T_laser, truth.body_frame or BASE) if truth else (None, "")
    else:
        poses, several = read_trajectory(source.path)
        of_laser = source.frame in {LASER, log.frame_id.lstrip("/")}
        on_any_base = log if of_laser else open_request(request, progress, odom="off", truth=None)
        path, frame = poses.compose(_mounting(source, on_any_base)), source.frame
        if several:
            stamps = f"{several} of {len(poses)} stamps have poses that differ"
            warnings = (f"{source.text}: {stamps}; the last of each is used; leave one row of each stamp",)
    if path is None or not log.shares_time(path.stamps_ns):
        ends = "no poses" if not path else "{:.1f} to {:.1f} s".format(*(path.stamps_ns[[0, -1]] * NS))
        span = f"{log.first_ns * NS:.1f} to {log.last_ns * NS:.1f} s"
        advice = "give poses with the clock of the scans"
        raise UsageError(f"{source.text}: its poses ({ends}) and the scans ({span}) share no time; {advice}")
    return _GivenPoses(source, path, frame, warnings)


def _mounting(source: TrajectorySource, log: Log) -> Pose:
    """Return the pose of the laser on the body of a file's poses."""
    if source.frame in {LASER, log.frame_id.lstrip("/")}:
        return Pose()
    if source.frame not in {BASE, log.base_frame}:
        known = ", ".join(filter(None, (LASER, BASE, log.frame_id.lstrip("/"), log.base_frame)))
        raise UsageError(f"{source.text},{source.frame}: no frame of the laser or its base; known are {known}")
    if log.base_T_laser is None:
        advice = "give it with --extrinsic x,y,yaw"
        raise UsageError(f"{source.text},{source.frame}: the log has no mounting of the laser; {advice}")
    return log.base_T_laser


def _score(
    poses: _GivenPoses,
    request: ScoreRequest,
    log: Log,
    wheels: FittedOdometry | None,
    references: References,
    progress: Progress,
) -> dict[str, Any]:
    """Draw, judge, measure and write one trajectory; return its run.json."""
    wall_s, cpu_s, stages = perf_counter(), process_time(), new_profile(loading=0.0, starting=0.0)
    source, config = poses.source, request.config
    instant = SWEEPS.get(source.pose_at, 0.0)
    draw = partial(
        draw_at_poses,
        log.scans,
        config,
        log.period_s,
        poses.world_T_laser,
        log.stamps_ns,
        whole=source.pose_at == WHOLE,
        of_run=source.in_log is None and Path(source.text).is_dir(),
        wheels=wheels,
        on_step=lambda _, done: progress(source.name, done, log.counts.usable),
    )
    outcome, world_T_map, misfit_m = draw(holds_ns=round(instant * log.mid_sweep_s / NS))
    half_s = half_sweep_s(log, outcome)
    if instant and half_s != log.mid_sweep_s:  # the scans show a sweep that the log does not state
        outcome, world_T_map, misfit_m = draw(holds_ns=round(instant * half_s / NS))
    held = in_time_of_truth(outcome.trajectory, half_s, config.truth_at)
    references, warnings = references_in_map(references, log, int(held.stamps_ns[0]) if len(held) else None)
    left_out = (floor_warning(log.floor_m),) if log.floor_m else ()
    outcome = replace(outcome, warnings=(*outcome.warnings, *poses.warnings, *left_out, *warnings))
    comparison = comparison_fields(references, held, outcome, config)
    run = RunResult(
        log=log,
        config=config,
        slam=outcome,
        metrics=measured_map(outcome, log),
        timing=Timing(perf_counter() - wall_s, process_time() - cpu_s, 0.0, stages),
        provenance=provenance(request.typed, [*_again(request, source)]),
        external=External(
            name=source.name,
            frame=poses.frame,
            pose_at=source.pose_at,
            poses=len(poses.world_T_laser),
            origin=StartPose(world_T_map.x_m, world_T_map.y_m, world_T_map.yaw_rad / DEG),
            misfit_mm=misfit_m / MM,
            **{"source": source.text, **poses.program, **difference_section(outcome.trajectory, poses.own, log)},
        ),
        **comparison,
    )
    return write_run(run, request.directory_of(source.name), force=request.force, report=request.report)


def _again(request: ScoreRequest, source: TrajectorySource) -> Iterator[str]:
    """Yield the words of a command line that scores a trajectory once more."""
    yield from ("mavnav", "score", *(str(path.absolute()) for path in (request.log, *request.more)))
    text = source.text if source.in_log is not None else str(Path(source.text).absolute())
    frame = f",{source.frame}" if source.frame else ""
    yield f"--trajectory={source.name}={text}{frame}@{source.pose_at}"
    yield from words_of(request.options)
    changed = changed_values(request.config, Config())
    yield from (f"--set={key}={to_scalar(value)}" for key, value in changed.items() if key != "method")


def own_run(log: Log, *, whole: bool, config: Config, progress: Progress) -> SlamResult | None:
    """Return mavnav's own run, with poses of the scans as recorded, or of the laser at mid-sweep; None if doubtful."""
    config = replace(config, method="robust", final_pass=whole)
    own = run_slam(
        log.scans,
        config,
        log.period_s,
        log.odom_T_laser,
        rotation=log.imu.rotation if log.imu else None,
        on_step=lambda phase, done: progress(phase, done, log.counts.usable),
        last=(),
        base_T_laser=log.base_T_laser,
        scans_ns=log.stamps_ns,
    )
    return own if own.doubt and not own.doubt.high and not own.lost_for_good else None


def confirmed_odometry(log: Log, own: SlamResult | None) -> tuple[FittedOdometry | None, Log]:
    """Return the odometry that mavnav's own run confirms, and the log without the floor that it shows, if any."""
    if own is None or own.wheels is None:
        return None, log
    return own.wheels, log.without_floor(own.floor_m) if own.floor_m else log


def difference_section(path: Trajectory, own: Trajectory | None, log: Log) -> dict[str, Any]:
    """Return how given poses differ from mavnav's own, as `External` has it; nothing without those."""
    if own is None:
        return {}
    late_s, scale, jumps = differences(path, own)
    seen = [PoseJump((jump.stamp_ns - log.first_ns) * NS, jump.moved_m, jump.turned_rad / DEG) for jump in jumps]
    return {"late_s": late_s, "distance_scale": scale, "jumps": seen}
