"""The Python interface: what the commands do, as functions; ``import mavnav`` has them all.

Lengths are in m, angles in rad, times in ns or s, as the suffix of a name says. ``map`` is the frame of the first laser
pose, or of the given map (REP-103 axes). Every function raises subclasses of `mavnav.MavnavError`: one line that says
what is wrong, where, and what to do next.
"""

from __future__ import annotations

import json
import shutil
import weakref
from itertools import chain, islice
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, TypeVar

from msgspec.structs import replace as changed

from mavnav import logs
from mavnav.api.results import Comparison, Run
from mavnav.config.loading import load_config
from mavnav.errors import UsageError
from mavnav.ground_truth.topics import truth_fields
from mavnav.pose import Pose
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from mavnav.config.models import Config
    from mavnav.outputs.provenance import Typed
    from mavnav.scan import Scan
    from mavnav.slam.steps import Step

    File = str | Path
    Progress = Callable[[str, int, int | None], None]
    """Called with what is being done, how much of it is done, and how much there is, None if unknown."""

Result = TypeVar("Result", Run, Comparison)


def silent(_phase: str, _done: int, _total: int | None) -> None:
    """Report nothing."""


def open_log(
    path: File,
    *,
    topic: str | None = None,
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
        The scan topic, if there are several; several, joined by commas, are merged by their mountings.
    odom
        ``auto``, ``off`` or a topic.
    start_s, end_s
        Window in seconds from the first usable scan.
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
        Path(path),
        topic=topic,
        odom=odom,
        start_s=start_s,
        end_s=end_s,
        extrinsic=_pose(extrinsic),
        strict=strict,
        truth=truth,
        attitude=attitude,
    )


def replay(
    log: File,
    *,
    method: str | None = None,
    grid: str | None = None,
    azimuth: int | None = None,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    online: bool = False,
    topic: str | None = None,
    odom: str | None = None,
    attitude: str | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    extrinsic: Sequence[float] | None = None,
    strict: bool = False,
    map: File | None = None,  # noqa: A002  as the option
    start_pose: Sequence[float] | None = None,
    continue_from: File | None = None,
    truth: File | None = None,
    truth_map: File | None = None,
    relations: File | None = None,
    directory: File | None = None,
    force: bool = False,
    report: bool = False,
    progress: Progress | None = None,
) -> Run:
    """Map a recorded log, as ``mavnav replay`` does; docs/cli.md describes the options.

    Parameters
    ----------
    log
        The log, as for `open_log`.
    method, grid, azimuth
        SLAM method, ``"20x20"``, and number of yaw samples.
    config, settings
        Configuration file or preset, and values over it by dotted key: ``{"robust.cell_mm": 25}``.
    online
        Causal mode: no loop closure, no final pass.
    topic, odom, attitude, start_s, end_s, extrinsic, strict
        As for `open_log`.
    map, start_pose
        Localize in this map (a map_server YAML file or a run), from about this pose, m, m, rad.
    continue_from
        Directory of a finished replay, merge or continued run: the log is added to its map, in its frame, and with its
        configuration where none is given. ``metrics["continued"]`` says whether it joined.
    truth, truth_map, relations
        References to compare with; ``truth`` is a file, ``"auto"`` or ``"topic:/name"``.
    directory, force, report
        Where to write the run, whether to replace it, whether to write its page; by default the run is kept as
        long as the object that is returned.
    progress
        Called as work goes on.

    Raises
    ------
    MavnavError
        UsageError, ConfigError, TopicError, NoScansError or OutputError. A run whose track was lost for good is
        returned: see `Run.lost`.
    """
    from mavnav.pipelines.again import run_layer  # noqa: PLC0415  heavy
    from mavnav.pipelines.replay import ReplayRequest, replay_log  # noqa: PLC0415

    base = run_layer(continue_from) if continue_from and config is None else None
    options = {"method": method, "grid": grid, "azimuth": azimuth, "odom": odom, "attitude": attitude}
    chosen = load_config(config, sets_of(settings), options | ({"final_pass": False} if online else {}), base)
    request = ReplayRequest(
        log=Path(log),
        directory=Path(directory or ""),
        config=chosen,
        topic=topic,
        start_s=start_s,
        end_s=end_s,
        extrinsic=_pose(extrinsic),
        force=force,
        report=report,
        **truth_fields(truth),
        truth_map=_path(truth_map),
        relations=_path(relations),
        strict=strict,
        map=_path(map),
        start_pose=_pose(start_pose),
        continue_from=_path(continue_from),
        typed=_typed(config),
    )

    def work(target: Path) -> Run:
        replay_log(changed(request, directory=target), progress or silent, 0.0)
        return Run(target)

    return _finished(work, directory)


def simulate(
    scenario: File,
    *,
    seed: int | None = None,
    planner: str | None = None,
    attitude: str | None = None,
    method: str | None = None,
    grid: str | None = None,
    azimuth: int | None = None,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    record: File | None = None,
    directory: File | None = None,
    force: bool = False,
    report: bool = False,
    progress: Progress | None = None,
) -> Run:
    """Simulate a mission in closed loop, as ``mavnav simulate`` does.

    Parameters
    ----------
    scenario
        YAML file, or the name of a shipped scenario.
    seed, planner
        Seed of all random numbers; planning technique.
    attitude
        Whether scans of a vehicle that tilts are levelled by its measured attitude: ``auto`` or ``off``.
    method, grid, azimuth, config
        As for `replay`.
    settings
        Values of the scenario by dotted key: ``{"slam.robust.cell_mm": 25}``.
    record
        Also record the mission as a log: .mcap, .bag, or a folder.
    directory, force, report, progress
        As for `replay`.

    Raises
    ------
    MavnavError
        UsageError, ConfigError, NoScansError or OutputError. ``metrics["mission"]`` says how the mission ended.
    """
    from mavnav.pipelines.simulate import SimulationRequest, simulate_mission  # noqa: PLC0415  heavy
    from mavnav.simulation.world import load_scenario  # noqa: PLC0415
    from mavnav.simulation.world.scenario_file import scenario_path  # noqa: PLC0415

    options = {"slam.method": method, "slam.grid": grid, "slam.azimuth": azimuth}
    options |= {"seed": seed, "planner.technique": planner, "slam.attitude": attitude}
    chosen = load_scenario(scenario, sets_of(settings), options, config)
    path = scenario_path(scenario)

    def work(target: Path) -> Run:
        request = SimulationRequest(
            chosen, path, target, _path(record), force=force, report=report, typed=_typed(config)
        )
        simulate_mission(request, progress or silent, 0.0)
        return Run(target)

    return _finished(work, directory)


def compare(
    log: File | Sequence[File],
    *,
    grids: Sequence[str] = (),
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
    grids, methods, azimuths
        Search grids (5x5, 10x10 and 20x20 if none is given), methods and numbers of yaw samples.
    config, settings, online
        What all runs share, as for `replay`.
    directory, force
        Where to write the comparison, whether to make finished runs again.
    workers
        How many runs at a time, by default one for each core.
    progress
        Called as work goes on.

    Raises
    ------
    MavnavError
        UsageError, ConfigError or OutputError. A run that fails stops no other.
    """
    from mavnav.batch.plan import load_kernels  # noqa: PLC0415  heavy
    from mavnav.comparison import pipeline  # noqa: PLC0415
    from mavnav.comparison.grids import comparison_settings  # noqa: PLC0415
    from mavnav.jobs import usable_cores  # noqa: PLC0415
    from mavnav.outputs.writers import write_page  # noqa: PLC0415

    names = [Path(log)] if isinstance(log, str | Path) else [Path(each) for each in log]
    if not names:
        raise UsageError("no log to compare; name one")
    shared: dict[str, object] = {"final_pass": False} if online else {}
    file = None if config is None else str(config)
    chosen = comparison_settings(file, sets_of(settings), methods, grids, azimuths, shared)

    def work(target: Path) -> Comparison:
        cores = workers or usable_cores()
        request = pipeline.comparison_request(names, chosen, target, {}, workers=cores, force=force)
        plan = pipeline.plan_comparison(request, progress or silent)
        load_kernels(plan, progress or silent)
        document = pipeline.run_comparison(plan, lambda _event: None)
        write_page(document, target)
        return Comparison(target, document)

    return _finished(work, directory)


def track(
    scans: Iterable[Scan],
    *,
    period_s: float | None = None,
    method: str | None = None,
    grid: str | None = None,
    azimuth: int | None = None,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
) -> Iterator[Step]:
    """Track scans one by one, as they come: the causal part of a method, as with ``--online``.

    Parameters
    ----------
    scans
        In the order of their stamps: of `open_log`, or of your own sensor.
    period_s
        Time between scans; that of the first two scans if not given.
    method, grid, azimuth, config, settings
        As for `replay`.

    Yields
    ------
    A step for every scan: ``index``, ``stamp_ns``, ``tracked`` (whether the scan was accepted and is in the map), and
    ``match`` with ``map_T_laser``, ``cost_m2``, ``inliers`` (0 to 1) and more.

    Raises
    ------
    MavnavError
        ConfigError.
    """
    from mavnav.slam.motion_model import USUAL_PERIOD_S, Motion  # noqa: PLC0415  heavy
    from mavnav.slam.registry import load_kernels, make_method  # noqa: PLC0415
    from mavnav.slam.tracker import track as tracked  # noqa: PLC0415

    chosen = _config(config, settings, method=method, grid=grid, azimuth=azimuth, online=True)
    load_kernels(chosen, silent)
    coming = iter(scans)
    first = list(islice(coming, 0 if period_s else 2))
    if period_s is None:
        period_s = (first[1].stamp_ns - first[0].stamp_ns) * NS if len(first) > 1 else USUAL_PERIOD_S
    slam = make_method(chosen)
    return tracked(chain(first, coming), slam, Motion(period_s, None, slam.expects_rest))


def _config(file: File | None, settings: Mapping[str, object] | None, *, online: bool, **options: object) -> Config:
    return load_config(file, sets_of(settings), options | {"final_pass": False if online else None})


def sets_of(settings: Mapping[str, object] | None) -> list[str]:
    """Return settings as ``--set`` has them: JSON is YAML."""
    return [f"{key}={json.dumps(value)}" for key, value in (settings or {}).items()]


def _finished(work: Callable[[Path], Result], directory: File | None) -> Result:
    """Return the result of work that writes to a directory; a temporary one goes with the result."""
    if directory is not None:
        return work(Path(directory))
    folder = mkdtemp(prefix="mavnav-")
    try:
        result = work(Path(folder) / "run")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(result, shutil.rmtree, folder, ignore_errors=True)
    return result


def _path(file: File | None) -> Path | None:
    return None if file is None else Path(file)


def _typed(config: File | None) -> Typed:
    from mavnav.outputs.provenance import Typed  # noqa: PLC0415  heavy

    return Typed(config=None if config is None else str(config))


def _pose(values: Sequence[float] | None) -> Pose | None:
    if values is None:
        return None
    x_m, y_m, yaw_rad = values
    return Pose(x_m, y_m, yaw_rad)
