"""The Python interface: what the commands do, as functions; ``import mavnav`` has them all.

Lengths are in m, angles in rad, times in ns or s, as the suffix of a name says. ``map`` is the frame of the first laser
pose, or of the given map (REP-103 axes). Every function raises subclasses of `mavnav.MavnavError`: one line that says
what is wrong, where, and what to do next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Unpack

from msgspec.structs import replace as changed

from mavnav import logs
from mavnav.api import arguments
from mavnav.api.results import Comparison, Run, in_directory
from mavnav.config.loading import load_config
from mavnav.config.options import OPTIONS, SEARCHING, File, ReplayOptions, SearchOptions, fields_of_outputs, settings_of
from mavnav.errors import UsageError
from mavnav.profiling import Progress, silent


@arguments.with_python_names
def open_log(
    path: File,
    *,
    topic: str | Sequence[str] | None = None,
    odom: str = "auto",
    start_s: float | None = None,
    end_s: float | None = None,
    extrinsic: Sequence[float] | None = None,
    strict: bool = False,
    truth: str | None = None,
    attitude: str = "auto",
) -> logs.Log:
    """Open a log: MCAP, ROS 1 bag, ROS 2 bag or CARMEN log. Iterate it for the scans, as often as needed.

    Parameters
    ----------
    path
        A file, or the folder of a ROS 2 bag.
    topic
        The scan topic, if there are several; a list of topics is merged by their mountings.
    odom
        ``auto``, ``off`` or a topic.
    start_s
        Start of the window in seconds from the first usable scan.
    end_s
        End of the window in seconds from the first usable scan.
    extrinsic
        Pose of the laser on its base, x, y (m), yaw (rad), in place of the log's.
    strict
        Leave out scans from where a checksum does not match.
    truth
        Topic of the ground truth, ``auto`` to find it by its name.
    attitude
        Tilt and height of the laser, by which the scans are levelled: ``auto``, ``off`` or a topic.

    Raises
    ------
    MavnavError
        UsageError, TopicError or NoScansError.
    """
    return logs.open_log(
        arguments.path_of(path, "path"),
        topic=arguments.topics_of(topic, "topic"),
        odom=odom,
        start_s=start_s,
        end_s=end_s,
        extrinsic=arguments.pose_of(extrinsic, "extrinsic"),
        strict=strict,
        truth=arguments.topic_of(truth),
        attitude=attitude,
    )


@arguments.with_python_names
@arguments.with_options(*OPTIONS)
def replay(
    log: File,
    *,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    directory: File | None = None,
    force: bool = False,
    report: bool = False,
    outputs: str | Sequence[str] | None = None,
    progress: Progress | None = None,
    **options: Unpack[ReplayOptions[File]],
) -> Run:
    """Map a recorded log, as ``mavnav replay`` does; docs/cli.md describes the options.

    Parameters
    ----------
    log
        The log, as for `open_log`.
    **options
        The options of ``mavnav replay``.
    config
        Configuration file or preset.
    settings
        Values over the configuration by dotted key: ``{"robust.cell_mm": 25}``.
    directory
        Where to write the run; by default it is kept as long as the object that is returned.
    force
        Whether to replace an earlier run there.
    report
        Whether to write report.html, too.
    outputs
        Groups of files to write, as of ``--outputs``: ``["trajectory", "map"]``; by default all but some.
    progress
        Called as ``progress(phase, done, total)`` while work goes on; ``total`` is None if it is unknown.

    Raises
    ------
    MavnavError
        UsageError, ConfigError, TopicError, NoScansError or OutputError. A run whose track was lost for good is
        returned: see `Run.lost`.
    """
    from mavnav.outputs.documents.provenance import Typed  # noqa: PLC0415  heavy
    from mavnav.pipelines.again import run_layer  # noqa: PLC0415
    from mavnav.pipelines.replay import ReplayRequest, replay_log  # noqa: PLC0415

    given = arguments.options_of(options)
    if "start_pose" in given and "map" not in given:
        raise UsageError("start_pose is a pose in a known map; give that with map, or leave it out")
    continued = given.get("continue_from")
    base = run_layer(continued) if continued and config is None else None
    chosen = load_config(arguments.config_of(config), arguments.sets_of(settings), settings_of(given), base)
    path, typed = arguments.path_of(log, "log"), Typed(config=arguments.config_of(config))
    request = ReplayRequest(path, Path(), chosen, given, force, report, typed=typed)
    if outputs is not None:
        request = changed(request, **fields_of_outputs(arguments.values_of(outputs, "outputs"), report=report))

    def work(target: Path) -> Run:
        replay_log(changed(request, directory=target), progress or silent, 0.0)
        return Run(target)

    return in_directory(work, directory)


@arguments.with_python_names
@arguments.with_options(*SEARCHING)
def simulate(
    scenario: File,
    *,
    seed: int | None = None,
    planner: str | None = None,
    attitude: str | None = None,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    record: File | None = None,
    directory: File | None = None,
    force: bool = False,
    report: bool = False,
    progress: Progress | None = None,
    **options: Unpack[SearchOptions],
) -> Run:
    """Simulate a mission in closed loop, as ``mavnav simulate`` does.

    Parameters
    ----------
    scenario
        YAML file, or the name of a shipped scenario.
    **options
        Method and search grid.
    seed
        Seed of all random numbers.
    planner
        Planning technique.
    attitude
        Whether scans of a vehicle that tilts are levelled by its measured attitude: ``auto`` or ``off``.
    config
        Configuration file or preset.
    settings
        Values of the scenario by dotted key: ``{"slam.robust.cell_mm": 25}``.
    record
        Also record the mission as a log: .mcap, .bag, or a folder.
    directory
        Where to write the run; by default it is kept as long as the object that is returned.
    force
        Whether to replace an earlier run there.
    report
        Whether to write report.html, too.
    progress
        Called as ``progress(phase, done, total)`` while work goes on; ``total`` is None if it is unknown.

    Raises
    ------
    MavnavError
        UsageError, ConfigError, NoScansError or OutputError. ``metrics["mission"]`` says how the mission ended.
    """
    from mavnav.outputs.documents.provenance import Typed  # noqa: PLC0415  heavy
    from mavnav.pipelines.simulate import SimulationRequest, simulate_mission  # noqa: PLC0415
    from mavnav.simulation.world.scenario_file import load_scenario, scenario_path  # noqa: PLC0415

    overrides = {f"slam.{key}": value for key, value in settings_of(arguments.options_of(options)).items()}
    overrides |= {"seed": seed, "planner.technique": planner, "slam.attitude": attitude}
    name, log = arguments.name_or_path(scenario, "scenario"), arguments.optional_path(record, "record")
    chosen = load_scenario(name, arguments.sets_of(settings), overrides, arguments.config_of(config))
    path, typed = scenario_path(name), Typed(config=arguments.config_of(config))

    def work(target: Path) -> Run:
        request = SimulationRequest(chosen, path, target, log, force=force, report=report, typed=typed)
        simulate_mission(request, progress or silent, 0.0)
        return Run(target)

    return in_directory(work, directory)


@arguments.with_python_names
def compare(
    log: File | Sequence[File],
    *,
    grids: Sequence[str | tuple[int, int]] = (),
    methods: Sequence[str] = (),
    azimuths: Sequence[int] = (),
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    online: bool = False,
    directory: File | None = None,
    force: bool = False,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Replay one or more logs with several search grids or methods, as ``mavnav compare`` does.

    Parameters
    ----------
    log
        A log, or several.
    grids
        Search grids, ``"10x10"`` or ``(10, 10)``; 5x5, 10x10 and 20x20 if none is given.
    methods
        SLAM methods.
    azimuths
        Numbers of yaw samples: one for all grids, or one for each.
    config
        Configuration file or preset of all runs.
    settings
        Values over the configuration by dotted key, as for `replay`; a list of values is compared.
    online
        Causal mode: no loop closure, no final pass.
    directory
        Where to write the comparison; by default it is kept as long as the object that is returned.
    force
        Whether to make finished runs again.
    workers
        How many runs at a time, by default one for each core.
    progress
        Called as ``progress(phase, done, total)`` while work goes on; ``total`` is None if it is unknown.

    Raises
    ------
    MavnavError
        UsageError, ConfigError or OutputError. A run that fails stops no other.
    """
    from mavnav.batch.runner import load_kernels  # noqa: PLC0415  heavy
    from mavnav.comparison import pipeline  # noqa: PLC0415
    from mavnav.jobs.pool import usable_cores  # noqa: PLC0415
    from mavnav.outputs.writers import write_page  # noqa: PLC0415

    names = arguments.paths_of(log, "log")
    shared = settings_of(arguments.options_of({"online": online}))
    points = [arguments.grid_of(grid, "grids") for grid in arguments.values_of(grids, "grids")]
    options = arguments.values_of(methods, "methods"), points, arguments.values_of(azimuths, "azimuths")
    chosen = pipeline.comparison_settings(arguments.config_of(config), arguments.sets_of(settings), *options, shared)
    cores = arguments.count_of(workers, "workers") or usable_cores()

    def work(target: Path) -> Comparison:
        request = pipeline.comparison_request(names, chosen, target, {}, workers=cores, force=force)
        plan = pipeline.plan_comparison(request, progress or silent)
        load_kernels(plan, progress or silent)
        document = pipeline.run_comparison(plan, lambda _event: None)
        write_page(document, target)
        return Comparison(target, document)

    return in_directory(work, directory)
