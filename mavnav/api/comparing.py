"""Comparison of search grids and methods on logs, as ``mavnav compare`` makes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.api.arguments import config_of, count_of, options_of, paths_of, sets_of, values_of
from mavnav.api.results import Comparison, in_directory
from mavnav.config.options import settings_of
from mavnav.errors import UsageError
from mavnav.profiling import silent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from mavnav.config.options import File
    from mavnav.profiling import Progress


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
    grids
        Search grids; 5x5, 10x10 and 20x20 if none is given.
    methods
        SLAM methods.
    azimuths
        Numbers of yaw samples: one for all grids, or one for each.
    config
        Configuration file or preset of all runs.
    settings
        Values over the configuration by dotted key, as for `replay`.
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
    from mavnav.comparison.grids import comparison_settings  # noqa: PLC0415
    from mavnav.jobs import usable_cores  # noqa: PLC0415
    from mavnav.outputs.writers import write_page  # noqa: PLC0415

    names = paths_of(log, "log")
    if not names:
        raise UsageError("no log to compare; name one")
    shared = settings_of(options_of({"online": online}))
    options = values_of(methods, "methods"), values_of(grids, "grids"), values_of(azimuths, "azimuths")
    chosen = comparison_settings(config_of(config), sets_of(settings), *options, shared)
    cores = count_of(workers, "workers") or usable_cores()

    def work(target: Path) -> Comparison:
        request = pipeline.comparison_request(names, chosen, target, {}, workers=cores, force=force)
        plan = pipeline.plan_comparison(request, progress or silent)
        load_kernels(plan, progress or silent)
        document = pipeline.run_comparison(plan, lambda _event: None)
        write_page(document, target)
        return Comparison(target, document)

    return in_directory(work, directory)
