"""Several sessions of one building: one map of all, and what changed between two."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavnav.api.functions import sets_of, silent
from mavnav.config.loading import load_config

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mavnav.api.functions import File, Progress


def merge(
    inputs: Sequence[File],
    directory: File,
    *,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Join logs and runs of one building to one map, as ``mavnav merge`` does (docs/merge.md).

    Parameters
    ----------
    inputs
        Logs and run directories, in any order.
    directory, force
        Where to write the result, and whether to replace an earlier one.
    config, settings
        As for `replay`.
    progress
        Called as work goes on.

    Returns
    -------
    The document merge.json: which session joined which, and why others did not.

    Raises
    ------
    MavnavError
        UsageError, ConfigError, NoScansError or OutputError.
    """
    from mavnav.pipelines.merge import MergeRequest  # noqa: PLC0415  heavy
    from mavnav.pipelines.merge import merge as merged  # noqa: PLC0415

    paths = tuple(Path(each) for each in inputs)
    chosen = load_config(config, sets_of(settings), {})
    return merged(MergeRequest(paths, Path(directory), chosen, force=force), progress or silent)


def diff(
    a: File, b: File, *, picture: File | None = None, force: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Find what changed between two maps of one place, as ``mavnav diff`` does (docs/diff.md).

    Parameters
    ----------
    a, b
        Run directories or map_server YAML files, before and after.
    picture, force
        PNG file to write, and whether to replace it.
    progress
        Called as work goes on.

    Returns
    -------
    The document that ``mavnav diff --json`` prints. ``alignment`` is None where the maps cannot be aligned.

    Raises
    ------
    MavnavError
        UsageError or OutputError.
    """
    from mavnav.pipelines.diff import DiffRequest, diff_maps  # noqa: PLC0415  heavy

    return diff_maps(
        DiffRequest(Path(a), Path(b), None if picture is None else Path(picture), force=force), progress or silent
    )
