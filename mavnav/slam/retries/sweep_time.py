"""Sweep time: how long the beams of a scan take, where a log states nothing of it, or what no laser does.

Drivers leave the time between two beams out, or state it a thousand times too short, a third, or double. A laser that
turns once between two scans takes a period for a turn; de-skewed by that, scans must fit better.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import islice
from typing import Final

from msgspec.structs import replace

from mavnav.scan import Scan
from mavnav.slam.retries.attempt import Attempt, is_sharper
from mavnav.slam.retries.beam_order import BETTER, LISTED_RATIO, cost_ratio_in_map, cost_ratios, turning_stretch
from mavnav.slam.track import LogScans, Track


def time_sweeps(track: Track) -> Track | None:
    """Return a track with a turn of the laser per period where the stated sweep is another, and the scans fit worse."""
    if track.refiner is None or track.config.robust.deskew != "auto":
        return None
    period_s = track.motion.period_s
    stretch = turning_stretch(track.steps.column("map_T_laser")[:, 2])
    scans = list(islice(track.log_scans(), stretch.start, stretch.stop))
    if not scans or any(scan.times_s is not None or scan.spec.has_plausible_sweep(period_s) for scan in scans):
        return None
    turn_s = scans[0].spec.usual_turn_s(period_s)
    turns_s = turn_s, -turn_s
    changes = [partial(timed_scan, turn_s=each_s) for each_s in turns_s]
    if all(cost_ratio_in_map(scans, stretch, track, change) > LISTED_RATIO for change in changes):
        return None
    ratios = dict(zip(turns_s, cost_ratios(scans, stretch, track, changes), strict=True))
    best_s = min(ratios, key=ratios.__getitem__)
    if not ratios[best_s] < BETTER:
        return None
    timed = replace(track, log_scans=partial(timed_scans, track.log_scans, best_s))
    sweep_s = timed_scan(scans[0], best_s).sweep_s
    return timed.with_warning(warning(scans[0], best_s)).with_findings(sweep_s=sweep_s)


def warning(scan: Scan, turn_s: float) -> str:
    """Say what the log states of the sweep, and what fits better."""
    stated = f"time_increment {scan.spec.time_increment_s:.3g} s" if scan.spec.time_increment_s else "no time_increment"
    beam_s = abs(timed_scan(scan, turn_s).spec.time_increment_s)
    order = ", in the reverse of the listed order" if turn_s < 0.0 else ""
    return (
        f"the scans have {stated}, but fit better with {beam_s:.3g} s{order} (a turn in {abs(turn_s):.3f} s), and are "
        "de-skewed so: set it in the driver"
    )


def timed_scans(log_scans: LogScans, turn_s: float) -> Iterator[Scan]:
    """Yield all scans of a log as of a laser that takes ``turn_s`` for a turn."""
    return (timed_scan(scan, turn_s) for scan in log_scans())


def timed_scan(scan: Scan, turn_s: float) -> Scan:
    """Return the scan as of a laser that takes ``turn_s`` for a turn; beams are fired in reverse if it is negative."""
    return replace(scan, spec=scan.spec.turning_in(turn_s))


TIMED_SWEEPS: Final = Attempt("timed sweeps", time_sweeps, is_sharper)
