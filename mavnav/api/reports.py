"""Logs and finished runs examined, and batches: what the commands of these names print with ``--json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

from msgspec.structs import replace

from mavnav.api import arguments
from mavnav.api.results import Comparison, in_directory
from mavnav.config.options import READING, REFERENCES, File, ReplayOptions, reference_files
from mavnav.profiling import Progress, silent


@arguments.with_python_names
def info(log: File, *, topic: str | Sequence[str] | None = None, strict: bool = False) -> dict[str, Any]:
    """Examine a log: topics, sensor, scans, rate, odometry, and everything that is damaged.

    Parameters
    ----------
    log
        The log, as for `open_log`.
    topic
        The scan topic, all if not given.
    strict
        Leave out scans from where a checksum does not match.

    Returns
    -------
    dict
        The document of ``mavnav info --json``; ``exit_code`` is 4 where no scan can be used.

    Raises
    ------
    MavnavError
        UsageError or NoScansError where there is no log.
    """
    from mavnav.pipelines.info import info_document  # noqa: PLC0415  heavy

    return info_document(arguments.path_of(log, "log"), arguments.topics_of(topic, "topic"), strict=strict)[0]


@arguments.with_python_names
def convert(
    log: File, target: File, *, run: File | None = None, strict: bool = False, force: bool = False
) -> dict[str, Any]:
    """Convert a log, as far as it can be read, to an indexed MCAP with ROS 2 messages.

    Parameters
    ----------
    log
        The log, as for `open_log`.
    target
        The file to write, .mcap.
    run
        Add the result of this run of the log: /tf from the map, /map, /pose and markers.
    strict
        Leave out messages from where a checksum does not match.
    force
        Whether to replace an earlier file.

    Returns
    -------
    dict
        The document of ``mavnav convert --json``.

    Raises
    ------
    MavnavError
        UsageError, NoScansError or OutputError.
    """
    from mavnav.pipelines.convert import convert_to  # noqa: PLC0415  heavy

    files = arguments.path_of(log, "log"), arguments.path_of(target, "target"), arguments.optional_path(run, "run")
    return convert_to(*files, strict=strict, force=force, progress=lambda _done, _total: None)


@arguments.with_python_names
@arguments.with_options(*REFERENCES)
def metrics(
    maps: File | Sequence[File], *, progress: Progress | None = None, **options: Unpack[ReplayOptions[File]]
) -> list[dict[str, Any]]:
    """Measure maps: wall thickness, ghost walls, crispness, support, errors against a reference.

    Parameters
    ----------
    maps
        Runs, merges, or YAML files of maps; one or several.
    **options
        What they are compared with.
    progress
        Called as ``progress(phase, done, total)`` while work goes on; ``total`` is None if it is unknown.

    Returns
    -------
    list of dict
        ``maps`` of the document of ``mavnav metrics --json``, one for each.

    Raises
    ------
    MavnavError
        UsageError.
    """
    from mavnav.ground_truth.references import load_references  # noqa: PLC0415  heavy
    from mavnav.pipelines.evaluate import evaluate  # noqa: PLC0415

    references = load_references(**reference_files(arguments.options_of(options)))
    measured: list[dict[str, Any]] = evaluate(arguments.paths_of(maps, "maps"), references, progress or silent)["maps"]
    return measured


@arguments.with_python_names
def check(
    runs: File | Sequence[File], *, gates: str | Sequence[str] = (), accept: str | int | Sequence[str | int] = ()
) -> list[dict[str, Any]]:
    """Check finished runs: their verdicts, and quality gates.

    Parameters
    ----------
    runs
        Runs, merges, comparisons or batches; one or several.
    gates
        Bounds such as ``"wall_thickness.p95_mm<=150"``.
    accept
        Worst verdict that passes, and exit codes that count as done; suspect if none is given.

    Returns
    -------
    list of dict
        ``runs`` of the document of ``mavnav check --json``: ``exit_code`` is 0 for what passed.

    Raises
    ------
    MavnavError
        UsageError for what is no finished run, and for gates that cannot be read.
    """
    from mavnav.batch.check import check_runs  # noqa: PLC0415  heavy
    from mavnav.metrics.gates import parse_gate, read_accept  # noqa: PLC0415

    bounds = [parse_gate(text) for text in arguments.values_of(gates, "gates")]
    accepted = frozenset(map(read_accept, arguments.values_of(accept, "accept")))
    return check_runs(arguments.paths_of(runs, "runs"), bounds, accepted)[0]


@arguments.with_python_names
@arguments.with_options(*READING, "strict", "resolution_m", "online")
def batch(
    sources: File | Sequence[File],
    *,
    grids: Sequence[str | tuple[int, int]] = (),
    methods: Sequence[str] = (),
    azimuths: Sequence[int] = (),
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    gates: str | Sequence[str] = (),
    accept: str | int | Sequence[str | int] = (),
    directory: File | None = None,
    force: bool = False,
    report: bool = False,
    workers: int | None = None,
    progress: Progress | None = None,
    **options: Unpack[ReplayOptions[File]],
) -> Comparison:
    """Replay many logs with many settings, as ``mavnav batch`` does; finished runs are used again.

    Parameters
    ----------
    sources
        A manifest, logs, folders and patterns; one or several.
    **options
        Options of every replay.
    grids
        Search grids.
    methods
        SLAM methods.
    azimuths
        Numbers of yaw samples: one for all grids, or one for each.
    config
        Configuration file or preset of all runs.
    settings
        Values over the configuration by dotted key, as for `replay`; lists are swept.
    gates
        Bounds that every run must hold.
    accept
        Worst verdict that passes, and exit codes that count as done.
    directory
        Where to write the batch; by default it is kept as long as the object that is returned.
    force
        Whether to make finished runs again.
    report
        Whether to write report.html of every run, too.
    workers
        How many runs at a time, by default one for each core.
    progress
        Called as ``progress(phase, done, total)`` while work goes on; ``total`` is None if it is unknown.

    Returns
    -------
    Comparison
        ``runs`` by name; ``document`` is batch.json, with the gates of each run and one ``exit_code``.

    Raises
    ------
    MavnavError
        UsageError, ConfigError or OutputError. A run that fails stops no other.
    """
    from mavnav.batch.options import BatchOptions, request_of  # noqa: PLC0415  heavy
    from mavnav.batch.runner import load_kernels, plan_batch, run_batch  # noqa: PLC0415

    given = BatchOptions(
        sources=[str(path) for path in arguments.paths_of(sources, "sources")],
        methods=arguments.values_of(methods, "methods"),
        grids=[arguments.grid_of(grid) for grid in arguments.values_of(grids, "grids")],
        azimuths=arguments.values_of(azimuths, "azimuths"),
        config=arguments.config_of(config),
        sets=arguments.sets_of(settings),
        options=arguments.options_of(options),
        gates=arguments.values_of(gates, "gates"),
        accept=arguments.values_of(accept, "accept"),
        jobs=arguments.count_of(workers, "workers"),
        force=force,
        report=report,
    )

    def work(target: Path) -> Comparison:
        plan = plan_batch(request_of(replace(given, directory=target)), progress or silent)
        load_kernels(plan, progress or silent)
        return Comparison(target, run_batch(plan, lambda _event: None, lambda _row: None))

    return in_directory(work, directory)
