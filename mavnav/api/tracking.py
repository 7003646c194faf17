"""Tracking in Python, scan by scan: the scans may come from a sensor of the user's, so that they are checked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, islice
from math import isfinite
from typing import TYPE_CHECKING, Any, SupportsFloat, Unpack

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.api.arguments import config_of, options_of, sets_of, with_options, with_python_names
from mavnav.config.loading import load_config
from mavnav.config.options import SEARCHING, File, SearchOptions, settings_of
from mavnav.errors import UsageError
from mavnav.scan import LaserSpec, Scan
from mavnav.units import NS

if TYPE_CHECKING:
    from mavnav.slam.matching.steps import Step


@with_python_names
@with_options(*SEARCHING)
def track(
    scans: Iterable[Scan],
    *,
    period_s: float | None = None,
    config: File | None = None,
    settings: Mapping[str, object] | None = None,
    **options: Unpack[SearchOptions],
) -> Iterator[Step]:
    """Track scans one by one, as they come: the causal part of a method, as with ``--online``.

    Parameters
    ----------
    scans
        In the order of their stamps: of `open_log`, or of your own sensor. Ranges that are infinite, 0 or negative are
        no returns.
    **options
        Method and search grid.
    period_s
        Time between scans; that of the first two scans if not given.
    config
        Configuration file or preset.
    settings
        Values over the configuration by dotted key: ``{"robust.cell_mm": 25}``.

    Yields
    ------
    Step
        One for every scan: ``index``, ``stamp_ns``, ``tracked`` (whether the scan was accepted and is in the map), and
        ``match`` with ``map_T_laser``, ``cost_m2``, ``inliers`` (0 to 1) and more.

    Raises
    ------
    MavnavError
        ConfigError; UsageError for scans that do not fit their `LaserSpec`, or whose stamps do not ascend.
    """
    from mavnav.slam.matching.motion_model import USUAL_PERIOD_S, Motion  # noqa: PLC0415  heavy
    from mavnav.slam.methods.registry import load_kernels, make_method  # noqa: PLC0415
    from mavnav.slam.tracker import track as tracked  # noqa: PLC0415

    overrides = settings_of(options_of({**options, "online": True}))
    chosen = load_config(config_of(config), sets_of(settings), overrides)
    load_kernels(chosen, lambda _phase, _done, _total: None)
    if period_s is not None and not (isfinite(period_s) and period_s > 0.0):
        raise UsageError(f"period_s is {period_s!r}; give the time between scans in s")
    coming = valid_scans(scans)
    first = list(islice(coming, 0 if period_s else 2))
    if period_s is None:
        period_s = (first[1].stamp_ns - first[0].stamp_ns) * NS if len(first) > 1 else USUAL_PERIOD_S
    slam = make_method(chosen)
    return tracked(chain(first, coming), slam, Motion(period_s, None, slam.expects_rest))


def valid_scans(scans: Iterable[Scan]) -> Iterator[Scan]:
    """Yield scans that fit their geometry and follow each other in time.

    Ranges of other number types are converted; those that are infinite, 0 or negative are no returns.
    """
    before: Scan | None = None
    for number, scan in enumerate(scans):
        if not isinstance(scan, Scan):
            raise UsageError(f"scan {number} is a {type(scan).__name__}; give mavnav.Scan objects")
        if not _is_stamp(scan.stamp_ns):
            raise UsageError(f"scan {number} has stamp_ns {scan.stamp_ns!r}; give whole ns")
        if before is None or scan.spec is not before.spec:
            _check_geometry(scan.spec, f"scan {number}")
        if before is not None and scan.stamp_ns <= before.stamp_ns:
            what = f"scan {number} has stamp_ns {scan.stamp_ns}, no later than the scan before"
            raise UsageError(f"{what}; give the scans in the order of their stamps, each once")
        before = scan
        yield _fitting(scan, number)


def _is_stamp(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        return False
    return abs(int(value)) <= np.iinfo(np.int64).max


def _check_geometry(spec: LaserSpec, where: str) -> None:
    numbers = spec.angle_min_rad, spec.angle_step_rad, spec.range_min_m, spec.time_increment_s, spec.scan_time_s
    if not all(isinstance(each, SupportsFloat) and isfinite(each) for each in numbers) or spec.angle_step_rad == 0.0:
        raise UsageError(f"{where}: its spec has angles, a least range or times that are not finite, or a step of 0")
    if not (isinstance(spec.beams, int | np.integer) and spec.beams > 0):
        raise UsageError(f"{where}: its spec has beams={spec.beams!r}; give the number of ranges of a scan")
    if not 0.0 <= spec.range_min_m < spec.range_max_m:
        limits = f"range_min_m={spec.range_min_m:g} and range_max_m={spec.range_max_m:g}"
        raise UsageError(f"{where}: its spec has {limits}; the first must be 0 or more, the second larger")


def _fitting(scan: Scan, number: int) -> Scan:
    """Return a scan with one range a beam in the type that the kernels take; itself if it is that already."""
    ranges_m, times_s = _per_beam(scan.ranges_m, scan, f"scan {number}: ranges_m"), scan.times_s
    if times_s is not None:
        times_s = _per_beam(times_s, scan, f"scan {number}: times_s")
        if not np.isfinite(times_s).all():
            raise UsageError(f"scan {number}: times_s are not all finite; give the time of every beam")
    no_return = ~np.isnan(ranges_m) & ~((ranges_m > 0.0) & (ranges_m < np.inf))
    if no_return.any():
        ranges_m = np.where(no_return, np.nan, ranges_m)
    same = ranges_m is scan.ranges_m and times_s is scan.times_s
    return scan if same else replace(scan, ranges_m=ranges_m, times_s=times_s)


def _per_beam(values: Any, scan: Scan, what: str) -> NDArray[np.float64]:  # noqa: ANN401
    try:
        array = np.ascontiguousarray(values)
        array = array.astype(np.float64, casting="safe" if array.dtype.kind in "mMc" else "unsafe", copy=False)
    except (TypeError, ValueError):
        raise UsageError(f"{what} are no numbers; give an array with one number a beam") from None
    if array.shape != (scan.spec.beams,):
        raise UsageError(f"{what} has shape {array.shape}, but its spec has {scan.spec.beams} beams; give one a beam")
    return array
