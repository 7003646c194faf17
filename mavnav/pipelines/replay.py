"""The pipeline of ``mavnav replay``: log -> slam -> metrics -> outputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import takewhile
from pathlib import Path
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any

from msgspec import Struct, field
from msgspec.structs import replace as changed

from mavnav.config.models import Config, OdometryConfig
from mavnav.config.option_kinds import recorded_topic
from mavnav.config.options import ReplayOptions, paths_of, reference_files
from mavnav.errors import ExitCode, StoppedError, UsageError
from mavnav.ground_truth.references import References, in_time_of_truth, load_references
from mavnav.logs import Log, check_log, open_log
from mavnav.logs.formats.detect import log_name
from mavnav.outputs.directory import check_directory
from mavnav.outputs.documents.provenance import Typed, provenance
from mavnav.outputs.documents.sections import options_section
from mavnav.outputs.run import RunResult, Timing, half_sweep_s
from mavnav.outputs.writers import WITHOUT_MAP, check_groups, write_run
from mavnav.pipelines import maps
from mavnav.pipelines.again import replay_words
from mavnav.pose import Pose, correct_path
from mavnav.profiling import Progress, Stage, as_stage, new_profile, scans_s
from mavnav.slam.findings import TrackedAgain
from mavnav.slam.methods.registry import load_kernels, uses_odometry
from mavnav.slam.pipeline import FINISHING, SMOOTHING, run_slam
from mavnav.slam.retries.levelling import AS_RECORDED
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from mavnav.outputs.documents.run_json import Provenance
    from mavnav.outputs.files.finished_run import FinishedRun
    from mavnav.sessions.group import Session
    from mavnav.slam.matching.prior_map import PriorMap
    from mavnav.slam.result import SlamResult


Stop = Callable[[], ExitCode | None]
"""Called between two scans: returns the exit code to end with, None to go on."""


class ReplayRequest(Struct, frozen=True):
    """One run: the log, which part of it, with what configuration, and where its results go.

    ``report`` writes the page as well; ``outputs`` are the groups of files to write, None for all. With ``gated`` the
    map is measured whatever is written. ``address`` is where the log was fetched from, for run.json; ``log_sha256`` is
    the content that the log must have, if the run is to be known by it. ``typed`` is the command line, ``more`` are the
    further parts of the log.
    """

    log: Path
    directory: Path
    config: Config
    options: ReplayOptions[Path] = field(default_factory=ReplayOptions[Path])
    force: bool = False
    report: bool = False
    outputs: tuple[str, ...] | None = None
    gated: bool = False
    address: str | None = None
    log_sha256: str | None = None
    typed: Typed = field(default_factory=Typed)
    more: tuple[Path, ...] = ()

    @property
    def usual_name(self) -> str:
        """The usual name of the run's directory."""
        return replay_directory(self.log, self.config).name

    @property
    def has_map(self) -> bool:
        """Whether anything that was asked for needs a map, which is drawn and measured then."""
        asked = self.outputs is None or not {*self.outputs} <= WITHOUT_MAP
        return asked or self.report or self.gated or "truth_map" in self.options

    @property
    def recorded_truth(self) -> str | None:
        """The topic or the frames of the log that are its truth, if they are."""
        truth = self.options.get("truth")
        return recorded_topic(truth) if isinstance(truth, str) else None

    @property
    def inputs(self) -> tuple[Path | None, ...]:
        """The paths that the run reads; None for those that are not given."""
        config = Path(self.typed.config) if self.typed.config else None
        named = (self.log, *self.more, *paths_of(self.options), config)
        map_paths = [path for path in (self.options.get("map"), self.options.get("truth_map")) if path]
        if not map_paths:
            return named
        from mavnav.ground_truth.map_file import map_files  # noqa: PLC0415  few runs need it

        return *named, *(file for path in map_paths for file in map_files(path))


class Given(Struct, frozen=True):
    """What is known besides the log: references, the map to localise in (None without one), and the provenance.

    ``run`` is the one to be continued, None without one, and ``earlier`` are its sessions.
    """

    references: References
    known: PriorMap | None
    provenance: Provenance
    run: FinishedRun | None = None
    earlier: tuple[Session, ...] = ()

    @property
    def own_frame(self) -> bool:
        """Whether the map is in a frame of its own, not in that of a map or run that is given."""
        return self.known is None and self.run is None


def _to_continue(request: ReplayRequest) -> tuple[FinishedRun | None, tuple[Session, ...]]:
    """Read the run to be continued, and its sessions; raises UsageError for what is none."""
    directory = request.options.get("continue_from")
    if directory is None:
        return None, ()
    if "map" in request.options:
        raise UsageError("--continue and --map both give a map; leave one of them out")
    if request.config.method != "robust":
        raise UsageError(f"--continue: method {request.config.method} cannot search whole maps; use the robust method")
    target = request.directory.resolve()
    if directory.resolve() in {target, *target.parents}:
        raise UsageError(f"{request.directory} is the run to continue, or inside of it; choose another one with -o")
    from mavnav.pipelines.sessions import earlier_sessions, run_to_continue  # noqa: PLC0415  few runs need it

    run = run_to_continue(directory)
    return run, tuple(earlier_sessions(run, request.config))


def _check_alignment(request: ReplayRequest) -> None:
    """Raise UsageError where the map cannot be aligned."""
    if maps.placement_of(request.options.get("align")) is None:
        return
    if {"map", "continue_from"} & request.options.keys():
        raise UsageError("--align: the map is in the frame of the one given by --map or --continue; leave out --align")
    if not request.config.final_pass or request.config.method != "robust":
        raise UsageError("--align draws the finished map again; leave out --online, and use --method robust")


def replay_directory(log: Path, config: Config) -> Path:
    """Return ``runs/<log>-<method>-<yaw samples>-<grid>``."""
    return Path("runs") / f"{log_name(log)}-{config.method}-{config.azimuth}-{config.grid}"


def replay_log(
    request: ReplayRequest,
    progress: Progress,
    compile_s: float,
    stoppable: Callable[[], AbstractContextManager[Stop]] = lambda: nullcontext(lambda: None),
    startup_s: float = 0.0,
) -> tuple[RunResult, dict[str, Any]]:
    """Run the whole job and return the run with its document (run.json).

    ``compile_s`` is what it took to import this module, ``startup_s`` what the process took before, for the profile.
    What can be wrong with the request is found before kernels are compiled. Within ``stoppable`` there are results to
    keep: when its function returns a code, the run ends there, and is written and marked as partial. Raises what the
    packages raise: TopicError, NoScansError, UsageError, OutputError; and StoppedError where nothing was tracked yet.
    """
    options = request.options
    check_log(request.log, options.get("start_s"), options.get("end_s"), request.more)
    check_groups(request.outputs or ())
    _check_alignment(request)
    check_directory(request.directory, force=True, inputs=request.inputs)
    references = load_references(**reference_files(options))
    known = maps.known_map(options.get("map"), _pose(options.get("start_pose")), request.config.method)
    given = Given(references, known, replay_provenance(request), *_to_continue(request))
    wall_s, cpu_s, stages = perf_counter(), process_time(), new_profile(loading=compile_s, starting=startup_s)
    odom = request.config.odom if uses_odometry(request.config) else "off"
    log = open_request(request, progress, odom=odom, truth=request.recorded_truth)
    log = with_corrected_odometry(log, request.config)
    if request.log_sha256 not in {None, log.sha256}:
        raise UsageError(f"{request.log}: changed since it was first read; run again once it is complete")
    maps.check_references(given.references, log, options, own_frame=given.own_frame)
    check_directory(request.directory, force=request.force)  # that it exists is said last
    compiled_s, compiled_cpu_s = _compile(request.config, progress, rare=not given.own_frame)
    began = Timing(wall_s + compiled_s, cpu_s + compiled_cpu_s, compile_s + compiled_s, stages, scans_s())
    with stoppable() as stop:
        return _track_and_write(request, log, given, progress, stop, began)


@as_stage("loading")
def _compile(config: Config, progress: Progress, *, rare: bool) -> tuple[float, float]:
    """Compile the kernels the first time; returns what that took, by the clock and of the processor, s."""
    wall_s, cpu_s = perf_counter(), process_time()
    load_kernels(config, progress, rare=rare)
    return perf_counter() - wall_s, process_time() - cpu_s


def replay_provenance(request: ReplayRequest) -> Provenance:
    """Describe a replay that starts now."""
    logs = [request.address or str(request.log.absolute()), *(str(part.absolute()) for part in request.more)]
    again = replay_words(logs, request.options, request.config)
    options = options_section(request.options, request.config, request.typed.config, request.typed.sets)
    return provenance(request.typed, again, options)


def _pose(values: Sequence[float] | None) -> Pose | None:
    return Pose(*values) if values else None


def _track_and_write(
    request: ReplayRequest, log: Log, given: Given, progress: Progress, stop: Stop, began: Timing
) -> tuple[RunResult, dict[str, Any]]:
    """Track, measure and write; ``began`` holds the clocks as they stood at the start."""
    config, warnings = maps.config_for_log(request.config, log)
    outcome = _track(request, log, config, given.known, progress, stop)
    outcome = changed(outcome, warnings=(*warnings, *outcome.warnings))
    log = log.as_recorded() if TrackedAgain(AS_RECORDED, kept=True) in outcome.attempts else log
    log = log.without_floor(outcome.floor_m) if outcome.floor_m else log
    stopped = stop()
    if stopped is not None and not len(outcome.trajectory):
        raise StoppedError(f"{request.log}: stopped before the first pose; nothing is written", stopped)
    continuation, is_stopped = None, stopped is not None
    if given.run:
        from mavnav.pipelines.sessions import continue_run  # noqa: PLC0415  few runs need it

        with Stage("joining"):
            continuation = continue_run(given.run, given.earlier, outcome, log, config, progress, stopped=is_stopped)
        outcome = continuation.outcome
    if request.has_map:
        progress("measuring", 0, None)
    held = in_time_of_truth(outcome.trajectory, half_sweep_s(log, outcome), config.truth_at)
    later_ns = held.stamps_ns[:1].sum() - outcome.trajectory.stamps_ns[:1].sum()
    begin_ns = outcome.begin_ns + int(later_ns) if given.own_frame and outcome.begin_ns is not None else None
    references, warnings = maps.references_in_map(given.references, log, begin_ns, outcome.map_T_begin)
    outcome = changed(outcome, warnings=(*outcome.warnings, *warnings))
    comparison = maps.comparison_fields(references, held, outcome, config)
    metrics = maps.measured_map(outcome, log) if request.has_map else None
    timing = changed(began, wall_s=perf_counter() - began.wall_s, cpu_s=process_time() - began.cpu_s)
    known = request.options.get("map")
    run = RunResult(
        log=log,
        config=config,
        slam=outcome,
        metrics=metrics,
        timing=timing,
        stopped=stopped,
        localisation=maps.localisation(known, _pose(request.options.get("start_pose")), outcome) if known else None,
        address=request.address,
        provenance=given.provenance,
        slices=maps.slices_of(outcome, log, config) if request.has_map else None,
        continued=continuation.section if continuation else None,
        earlier=continuation.earlier if continuation else (),
        **comparison,
    )
    progress("writing", 0, None)
    document = write_run(run, request.directory, force=request.force, report=request.report, groups=request.outputs)
    return run, document


def open_request(request: ReplayRequest, progress: Progress, *, odom: str, truth: str | None) -> Log:
    """Survey the log of a request, with the poses of a topic or a frame as its ``truth``."""
    options, config = request.options, request.config
    return open_log(
        request.log,
        topic=options.get("topic"),
        odom=odom,
        start_s=options.get("start_s"),
        end_s=options.get("end_s"),
        extrinsic=_pose(options.get("extrinsic")),
        strict=options.get("strict", False),
        truth=truth,
        attitude=config.attitude,
        upside_down=config.upside_down,
        more=request.more,
        progress=lambda done, total: progress("reading", done, total),
    )


def with_corrected_odometry(log: Log, config: Config) -> Log:
    """Return a log with its odometry corrected as the configuration says."""
    given, odometry = config.odometry, log.odometry
    if odometry is None or given == OdometryConfig():
        return log
    scales = given.distance_scale, given.turn_scale, given.veer_deg_per_m * DEG
    offset_s = given.offset_s - odometry.clock_s if given.offset_s else 0.0  # it replaces what the log adds
    odom_T_base = correct_path(odometry.odom_T_base, round(offset_s / NS), *scales)
    odom_T_laser = odom_T_base.compose(log.base_T_laser or Pose())
    return changed(log, odometry=changed(odometry, odom_T_base=odom_T_base, odom_T_laser=odom_T_laser))


def _track(
    request: ReplayRequest, log: Log, config: Config, known: PriorMap | None, progress: Progress, stop: Stop
) -> SlamResult:
    """Run the method; odometry is taken at the middle of the sweeps, where the poses hold."""
    going, plain = lambda _: stop() is None, log.as_recorded()
    return run_slam(
        lambda: takewhile(going, log.scans()),
        config,
        log.period_s,
        log.odom_T_laser,
        rotation=log.imu.rotation if log.imu else None,
        on_step=lambda phase, done: progress(phase, done, log.counts.usable),
        prior_map=known,
        last=FINISHING if request.has_map else SMOOTHING,
        base_T_laser=log.base_T_laser or Pose(),
        scans_ns=log.stamps_ns,
        placement=maps.placement_of(request.options.get("align")),
        start_s=log.start_s,
        recorded_ns=log.odometry.recorded_ns if log.odometry else None,
        recorded=(lambda: takewhile(going, plain.scans())) if log.attitude and config.attitude == "auto" else None,
    )
