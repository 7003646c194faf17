"""Sensor health: what the scans of a log say about the laser, its driver and its clock, each with what to do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from math import ceil, inf
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.logs.false_returns import spread_over
from mavnav.logs.log import Log
from mavnav.scan import LaserSpec, Scan, runs_of
from mavnav.units import DEG, NS, pluralize

MOST_SCANS: Final = 5000
"""The ranges of the first so many scans are examined: 0.1 s for 700 beams."""

LEAST_SHARE, LEAST_BEAMS = 0.25, 60
"""Share of valid beams, and their median number in a scan, below which scans are sparse."""

PARTIAL, NEIGHBOURS = 0.5, 10
"""A scan is partial with fewer valid beams than this share of the median of so many scans on either side."""

FIRST_SCANS, SOME_SHARE = 10, 0.01
"""One partial scan counts among so many at the beginning; later ones from this share on."""

FAR_SHARE, MOST_FAR = 0.05, 0.5
"""Shares of the valid returns above which those that are too far to be used are reported, and used."""

SECTOR_DEG, SECTOR_SCANS = 10, 20
"""The narrowest sector without any return that is reported, deg, and the fewest scans that show it."""

SLOW_HZ, JITTER = 2.0, 0.3
"""The rate below which scans are too far apart for motion between them; the 90th percentile of the errors of the stamp
steps, as a share of the period, above which stamps jitter."""


class Finding(Struct, frozen=True):
    """Something of the sensor to check: its kind, what was found, and what to do."""

    kind: str
    what: str
    advice: str


class SensorHealth(Struct, frozen=True):
    """What was measured on the first ``examined`` scans; ``findings`` are empty for a healthy sensor.

    ``dead_sectors_deg`` are sectors (from, to) without a valid return in any scan, degrees counter-clockwise from the
    laser's x axis. Of all scans ``repeated`` equal the one before. ``jitter_share`` is the 90th percentile of the
    differences between stamp steps and period, gaps left out, as a share of the period.
    """

    healthy: bool
    examined: int
    valid_share: float
    median_valid_beams: float
    partial: int
    repeated: int
    dead_sectors_deg: list[tuple[float, float]]
    jitter_share: float
    findings: list[Finding]


def sensor_health(log: Log, far_m: float = inf) -> SensorHealth:
    """Examine the first ``MOST_SCANS`` scans of a log, and all stamps; returns from ``far_m`` on are not used."""
    seen = _scan_statistics(islice(log.scans(), MOST_SCANS), far_m, log.own_beams)
    share = log.cleaning["valid"] / max(sum(log.cleaning.values()), 1)
    partial, jitter = _partial(seen.valid), _jitter(seen.stamps_ns, log.period_s)
    sectors = _sectors(seen.covered & ~seen.returned) if len(seen.valid) >= SECTOR_SCANS else []
    usual = float(np.median(seen.valid)) if len(seen.valid) else 0.0
    findings = [
        *_missing_returns(share, usual, partial, sectors, seen),
        *_odd_returns(seen, far_m),
        *_times(log, jitter),
    ]
    return SensorHealth(
        healthy=not findings,
        examined=len(seen.valid),
        valid_share=share,
        median_valid_beams=usual,
        partial=len(partial),
        repeated=log.counts.repeated,
        dead_sectors_deg=sectors,
        jitter_share=jitter,
        findings=findings,
    )


class _Seen(Struct, frozen=True):
    """Valid beams and stamps of the scans, (n,), degrees (360,) of beams and of valid returns.

    ``far`` is the number of returns farther than the replay uses, ``farthest_m`` the farthest return.
    """

    valid: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    covered: NDArray[np.bool_]
    returned: NDArray[np.bool_]
    far: int
    farthest_m: float


def _scan_statistics(scans: Iterable[Scan], far_m: float, own: NDArray[np.bool_] | None) -> _Seen:
    valid, stamps_ns, farthest_m, far = [], [], 0.0, 0
    covered, returned = np.zeros(360, np.bool_), np.zeros(360, np.bool_)
    spec: LaserSpec | None = None
    degrees = np.zeros((0, 1), np.intp)
    for scan in scans:
        if spec is not scan.spec:
            spec = scan.spec
            degrees = _degrees(spec)
            covered[degrees] = True
        good = np.isfinite(scan.ranges_m)
        returned[degrees[good if own is None else good | spread_over(own, len(good))]] = True  # the robot is no news
        farthest_m = float(np.max(scan.ranges_m, initial=farthest_m, where=good))
        far += int(np.count_nonzero(scan.ranges_m >= far_m))
        valid.append(int(np.count_nonzero(good)))
        stamps_ns.append(scan.stamp_ns)
    return _Seen(np.array(valid), np.array(stamps_ns, np.int64), covered, returned, far, farthest_m)


def _degrees(spec: LaserSpec) -> NDArray[np.intp]:
    """Return the degrees (beams, k) of the full turn that each beam stands for."""
    wide = np.arange(max(ceil(abs(spec.angle_step_rad) / DEG), 1))
    return (np.floor(spec.angles_rad / DEG).astype(np.intp)[:, None] + wide) % 360


def _partial(valid: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the numbers of the scans with far fewer valid beams than their neighbors."""
    if len(valid) <= NEIGHBOURS:
        return np.zeros(0, np.intp)
    padded = np.pad(valid, NEIGHBOURS, mode="reflect")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1), axis=1)
    return np.flatnonzero(valid < PARTIAL * usual)


def _jitter(stamps_ns: NDArray[np.int64], period_s: float) -> float:
    steps_s = np.diff(stamps_ns) * NS
    steps_s = steps_s[steps_s <= 3.0 * period_s]
    return float(np.quantile(np.abs(steps_s - period_s), 0.9)) / period_s if len(steps_s) and period_s else 0.0


def _sectors(dead: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the runs of dead degrees (360,) that are wide enough; one across 0 deg begins below it."""
    if dead.all():
        return [(0.0, 360.0)]
    turn = int(np.argmin(dead))  # begin at a degree that is not dead
    sectors = (((run.start + turn) % 360, len(run)) for run in runs_of(np.roll(dead, -turn), SECTOR_DEG))
    return [(float(start_deg), float(start_deg + wide_deg)) for start_deg, wide_deg in sectors]


def _missing_returns(
    share: float, median: float, partial: NDArray[np.intp], sectors: list[tuple[float, float]], seen: _Seen
) -> Iterator[Finding]:
    if share < LEAST_SHARE or median < LEAST_BEAMS:
        what = f"{100 * share:.0f} % of the beams are valid, {median:.0f} a scan in the median"
        advice = "clean the window, see that walls are in range, and check range_min and range_max; turn slowly"
        yield Finding("sparse", what, advice)
    early = partial[partial < FIRST_SCANS]
    if len(early) or len(partial) > SOME_SHARE * len(seen.stamps_ns):
        where = ", at the beginning" if len(early) == len(partial) else ""
        what = f"less than half of the valid beams of their neighbors in {pluralize(len(partial), 'scan')}{where}"
        until_s = (seen.stamps_ns[partial[-1]] - seen.stamps_ns[0]) * NS
        advice = "keep the view of the laser free, and check its power and cable"
        if len(early):
            advice = (
                "record once the laser turns at full speed, and keep its view free; a replay begins its map after them"
            )
        yield Finding("partial", f"{what}, the last after {until_s:.1f} s", advice)
    if sectors:
        named = [f"{a:.0f} to {b if b <= 360.0 else b - 360.0:.0f} deg" for a, b in sectors[:4]]
        what = f"no valid return in any scan at {', '.join(named)}" + ", ..." * (len(sectors) > 4)
        advice = (
            "see what hides them or whether nothing is in range there; if the robot hides them, nothing is to be done"
        )
        yield Finding("dead_sectors", what, advice)


def _odd_returns(seen: _Seen, far_m: float) -> Iterator[Finding]:
    share = seen.far / max(int(seen.valid.sum()), 1)
    what = f"{100 * share:.0f} % of the returns are farther than {far_m:g} m, up to {seen.farthest_m:.0f} m"
    if share > MOST_FAR:
        yield Finding("far", what, "a replay uses them, too, up to range_max")
    elif share > FAR_SHARE:
        advice = "if they are walls, replay with a larger robust.far_mm, in mm (--set)"
        yield Finding("far", f"{what}, and not used", advice)


def _times(log: Log, jitter: float) -> Iterator[Finding]:
    if log.gaps:
        longest = max(gap.duration_s for gap in log.gaps)
        what = f"{pluralize(len(log.gaps), 'gap')} between scans, the longest {longest:.2f} s"
        advice = "see whether the recorder or the network drops scans: record on the robot, with a larger buffer"
        yield Finding("gaps", what, advice)
    if log.period_s * SLOW_HZ > 1.0:
        yield Finding("slow", f"only {1.0 / log.period_s:.2f} scans a second", "record odometry, or move slowly")
    kinds = ("backward_stamp", "duplicate_stamp", "impossible_stamp")
    odd = {kind: log.counts.skipped[kind] for kind in kinds if log.counts.skipped.get(kind)}
    if odd or log.stamp_source == "log":
        what = ", ".join(pluralize(count, kind.replace("_", " ")) for kind, count in odd.items())
        what = what or "the stamps of the scans are unusable, the times of recording are used"
        advice = "check the clock of the driver: it jumps, stands still, or two drivers publish on the topic"
        yield Finding("stamps", what, advice)
    sensor, turn_s = log.sensor, log.sensor.usual_turn_s(log.period_s)
    if sensor.time_increment_s and log.period_s and not sensor.has_plausible_sweep(log.period_s):
        what = f"time_increment is {sensor.time_increment_s:.3g} s, a turn in {sensor.stated_turn_s:.3g} s"
        advice = f"set time_increment to {sensor.turning_in(turn_s).time_increment_s:.3g} s in the driver"
        yield Finding(
            "sweep",
            f"{what}, but the scans come every {log.period_s:.3g} s",
            f"if the laser turns once a scan, {advice}; a replay tries that",
        )
    if jitter > JITTER:
        what = f"stamps jitter by {100 * jitter:.0f} % of the period (90th percentile)"
        yield Finding("jitter", what, "stamp scans by the laser's clock instead of on arrival")
