"""Matching scans once more: the rejected ones between their neighbours, and all against the finished map."""

from __future__ import annotations

from array import array
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.degeneracy import UNMEASURED, degeneracy_warning
from mavnav.slam.motion_model import LONGEST_S
from mavnav.slam.scan_matching import with_effort
from mavnav.slam.steps import Step, Steps
from mavnav.slam.track_state import Verdict
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mavnav.scan import Scan
    from mavnav.slam.method import Refiner
    from mavnav.slam.track import Track

SHORT_SCANS = 8
"""Scans between accepted ones so near to each other are searched in wide regions, too."""

NOTHING_SHOWN = (UNMEASURED, *(0.0,) * 7)
"""Observability, visibility conflicts and Hessian of a scan without a pose."""

REFINED_AT_ONCE = 16
"""The same is done for so many scans in a row: it is found in the processor's caches."""


def rematch_rejected(track: Track) -> Track:
    """Match the rejected scans again, now that it is known where the track went on after them.

    From the next accepted pose backwards, each is expected between its neighbours; one that is accepted then enters
    trajectory and map, the others are left out for good.
    """
    steps = track.steps
    before = {} if track.refiner is None or steps.column("tracked").all() else between_accepted(steps)
    if not before:
        return track
    scans = {index: scan for index, scan in enumerate(track.log_scans()) if index in before}
    settled, after = Steps(steps), steps[-1]
    for step in reversed(steps):
        if step.index in scans and (after.stamp_ns - step.stamp_ns) * NS <= LONGEST_S:
            settled[step.index] = rematched(scans[step.index], step, before[step.index], after, track)
        after = settled[step.index] if settled[step.index].tracked else after
    return replace(track, steps=settled)


def between_accepted(steps: Iterable[Step]) -> dict[int, Step]:
    """Return the accepted step before each rejected scan that lies between two accepted ones."""
    before: dict[int, Step] = {}
    between: dict[int, Step] = {}
    last: Step | None = None
    for step in steps:
        if step.tracked:
            before.update(between)
            between, last = {}, step
        elif last:
            between[step.index] = last
    return before


def rematched(scan: Scan, step: Step, before: Step, after: Step, track: Track) -> Step:
    """Match a scan between two accepted ones; return its step, tracked if it fits there."""
    here = track.motion.started_at(after.match.map_T_laser, after.stamp_ns)
    here = here.coming_from(before.match.map_T_laser, before.stamp_ns)
    short = here.elapsed_s(before.stamp_ns) <= SHORT_SCANS * here.period_s
    match_it = track.method.match if short or track.refiner is None else track.refiner.match_between
    match = match_it(scan, here.predict(scan.stamp_ns), here)
    if track.method.gate(match, scan, here) is not Verdict.SURE:
        return step
    track.method.insert(scan, match.map_T_laser, here)
    return step._replace(match=with_effort(match, step.match, match), tracked=True)


def remove_dynamic_cells(track: Track) -> Track:
    """Remove from the map what did not stay where it was seen: people who walked by, and the like."""
    if track.refiner:
        track.refiner.remove_dynamic_cells()
    return track


def refine_against_final_map(track: Track) -> Track:
    """Match every tracked scan against the finished map; without odometry, warn where its geometry is degenerate.

    The steps themselves take what is found: there are many. What the map shows of each scan is kept with the track.
    """
    if track.refiner is None:
        return track
    shown = array("d")
    for step in track.reported(refined(track.log_scans(), track.steps, track.refiner, shown), "final pass"):
        track.steps[step.index] = step
    columns = np.array(shown).reshape(-1, 8)
    observed = columns[:, 0]
    track = replace(track, observed=observed, conflicts=columns[:, 1], hessians=columns[:, 2:])
    if not len(observed) or track.motion.odometry:
        return track
    warning = degeneracy_warning(track.steps, observed, contradicted=track.odometry_contradicts)
    return track.with_warning(warning) if warning else track


def refined(scans: Iterable[Scan], steps: Iterable[Step], refiner: Refiner, shown: array[float]) -> Iterator[Step]:
    """Match every tracked scan once more, against the finished map, close to where it was.

    Steps whose scans do not come, because the run is being stopped, stay as they are. Observability, visibility
    conflicts and Hessian of each of the others are added to ``shown``.
    """
    waiting, coming = iter(steps), iter(scans)
    while some := list(islice(waiting, REFINED_AT_ONCE)):
        points = [refiner.match_points(scan) for scan in islice(coming, len(some))]
        matches = [refiner.refine(p, s.match) if s.tracked else s.match for p, s in zip(points, some, strict=False)]
        for p, step, match in zip(points, some, matches, strict=False):
            if not step.tracked:
                shown.extend(NOTHING_SHOWN)
                continue
            observed, hessian = refiner.observability(p, match)
            shown.extend((observed, refiner.conflicts(p, match), *hessian.tolist()))
        yield from (Step(*step[:2], match, *step[3:]) for step, match in zip(some, matches, strict=False))
        yield from some[len(matches) :]
