"""One map of several sessions, what changed between two, and the calibration of the robot that recorded one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mavnav.api.arguments import config_of, optional_path, options_of, path_of, paths_of, sets_of, with_python_names
from mavnav.config.loading import load_config
from mavnav.config.options import File, settings_of
from mavnav.profiling import Progress, silent


@with_python_names
def merge(
    inputs: Sequence[File],
    directory: File,
    *,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    report: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Join logs and runs of one building to one map, as ``mavnav merge`` does (docs/merge.md).

    Parameters
    ----------
    inputs
        Logs and run directories, in any order.
    directory
        Where to write the result.
    config
        Configuration file or preset.
    settings
        Values over the configuration by dotted key: ``{"robust.cell_mm": 25}``.
    report
        Whether to write report.html, too.
    force
        Whether to replace an earlier result.
    progress
        Called as ``progress(phase, done, total)`` while work goes on; ``total`` is None if it is unknown.

    Returns
    -------
    dict
        The document merge.json: which session joined which, and why others did not.

    Raises
    ------
    MavnavError
        UsageError, ConfigError, NoScansError or OutputError.
    """
    from mavnav.pipelines import merge as pipeline  # noqa: PLC0415  heavy

    paths, target = tuple(paths_of(inputs, "inputs")), path_of(directory, "directory")
    chosen = load_config(config_of(config), sets_of(settings), {})
    request = pipeline.MergeRequest(paths, target, chosen, force, report, optional_path(config, "config"))
    return pipeline.merge(request, progress or silent)


@with_python_names
def diff(
    a: File,
    b: File,
    *,
    picture: File | None = None,
    report: File | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Find what changed between two maps of one place, as ``mavnav diff`` does (docs/diff.md).

    Parameters
    ----------
    a
        Run directory or map_server YAML file from before the changes.
    b
        The same from after the changes.
    picture
        PNG file to write.
    report
        HTML file to write.
    force
        Whether to replace these files.
    progress
        Called as ``progress(phase, done, total)`` while work goes on; ``total`` is None if it is unknown.

    Returns
    -------
    dict
        The document that ``mavnav diff --json`` prints. ``alignment`` is None where the maps cannot be aligned.

    Raises
    ------
    MavnavError
        UsageError or OutputError.
    """
    from mavnav.pipelines.diff import DiffRequest, diff_maps  # noqa: PLC0415  heavy

    files = optional_path(picture, "picture"), optional_path(report, "report")
    request = DiffRequest(path_of(a, "a"), path_of(b, "b"), *files, force=force)
    return diff_maps(request, progress or silent)


@with_python_names
def calibrate(
    log: File,
    *,
    topic: str | None = None,
    odom: str | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    strict: bool = False,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    document: File | None = None,
    picture: File | None = None,
    report: File | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Calibrate laser and odometry of a log, as ``mavnav calibrate`` does (docs/calibrate.md).

    Parameters
    ----------
    log
        A file, or the folder of a ROS 2 bag.
    topic
        The scan topic, if there are several.
    odom
        ``auto`` or the topic of the odometry.
    start_s
        Start of the window in seconds from the first usable scan.
    end_s
        End of the window in seconds from the first usable scan.
    strict
        Leave out scans from where a checksum does not match.
    config
        Configuration file or preset.
    settings
        Values over the configuration by dotted key: ``{"robust.cell_mm": 25}``.
    document
        JSON file to write.
    picture
        PNG file to write.
    report
        HTML file to write.
    force
        Whether to replace these files.
    progress
        Called as ``progress(phase, done, total)`` while work goes on; ``total`` is None if it is unknown.

    Returns
    -------
    dict
        The document of ``mavnav calibrate --json``: ``quantities`` have ``value`` and ``ci95``, or ``refused``.

    Raises
    ------
    MavnavError
        UsageError, ConfigError, TopicError (without odometry, too), NoScansError or OutputError.
    """
    from mavnav.pipelines import calibrate as pipeline  # noqa: PLC0415  heavy

    options = options_of({"topic": topic, "start_s": start_s, "end_s": end_s, "odom": odom, "strict": strict})
    chosen = load_config(config_of(config), sets_of(settings), settings_of(options))
    files = optional_path(document, "document"), optional_path(picture, "picture"), optional_path(report, "report")
    config_file = optional_path(config, "config")
    request = pipeline.CalibrationRequest(path_of(log, "log"), chosen, options, *files, force, config_file)
    return pipeline.calibrate(request, progress or silent)
