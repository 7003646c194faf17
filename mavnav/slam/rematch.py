"""Second matching: rejected scans between their accepted neighbours, and all scans against the finished map."""

from __future__ import annotations

from array import array
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from mavnav.slam.degeneracy import UNMEASURED, degeneracy_warning
from mavnav.slam.motion_model import LONGEST_S
from mavnav.slam.redraw import motions_along
from mavnav.slam.scan_matching import with_effort
from mavnav.slam.steps import Step, Steps, tracked_trajectory
from mavnav.slam.track_state import Verdict
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mavnav.scan import Scan
    from mavnav.slam.method import Refiner
    from mavnav.slam.motion_model import Motion
    from mavnav.slam.scan_matching import Match
    from mavnav.slam.track import Track

SHORT_SCANS = 8
"""Longest interval between accepted scans, in periods, within which rejected ones are searched in wide regions."""

MOST_FAILED = 5
"""Number of successive scans without a match that ends the rematching of a gap: the laser was elsewhere or blocked."""

NO_EVIDENCE = (UNMEASURED, *(0.0,) * 7)
"""Observability, visibility conflicts and Hessian of a scan without a pose."""

BATCH_SCANS = 16
"""Number of scans for which each operation runs in turn: its code and data stay in the processor's caches."""


NOTABLE_CONFLICTS, SKEWED_RAD = 0.01, 2 * DEG
"""Visibility conflicts that raise doubt, and turn during a sweep from which they may be due to the turn alone."""


def rematch_rejected(track: Track) -> Track:
    """Match the rejected scans again between their accepted neighbours.

    The scans of a gap are matched backwards from the next accepted pose. Those accepted enter trajectory and map; the
    others stay without a pose.
    """
    steps = track.steps
    before = {} if track.refiner is None or steps.column("tracked").all() else between_accepted(steps)
    if not before:
        return track
    scans = {index: scan for index, scan in enumerate(track.log_scans()) if index in before}
    updated, after, failed = Steps(steps), steps[-1], 0
    for step in reversed(steps):
        if step.index in scans and failed < MOST_FAILED and (after.stamp_ns - step.stamp_ns) * NS <= LONGEST_S:
            updated[step.index] = rematched(scans[step.index], step, before[step.index], after, track)
            failed += 1
        if updated[step.index].tracked:
            after, failed = updated[step.index], 0
    return replace(track, steps=updated)


def between_accepted(steps: Iterable[Step]) -> dict[int, Step]:
    """Return the last accepted step before each rejected scan that has accepted scans on both sides, by scan number."""
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
    """Match a scan between two accepted ones; return its step, tracked if the match is accepted."""
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
    """Remove the hits of people and other moving things from the map."""
    if track.refiner:
        track.refiner.remove_dynamic_cells()
    return track


def refine_against_final_map(track: Track) -> Track:
    """Match every tracked scan against the finished map; without odometry, warn where its geometry is degenerate.

    The steps are changed in place, because there may be many. Observability, visibility conflicts and Hessians of the
    scans are stored in the track.
    """
    if track.refiner is None:
        return track
    evidence = array("d")
    motions = motions_along(tracked_trajectory(track.steps), track.motion)
    coming = refined(track.log_scans(), track.steps, track.refiner, evidence, motions)
    for step in track.reported(coming, "final pass"):
        track.steps[step.index] = step
    columns = np.array(evidence).reshape(-1, 8)
    observed = columns[:, 0]
    track = replace(track, observed=observed, conflicts=columns[:, 1], hessians=columns[:, 2:])
    if not len(observed):
        return track
    stamps_ns = track.steps.column("stamp_ns")[: len(observed)]  # fewer where the run is stopped
    alone = np.where(track.motion.odometry_at(stamps_ns), UNMEASURED, observed)
    warning = degeneracy_warning(track.steps, alone, contradicted=track.odometry_contradicts)
    return track.with_warning(warning) if warning else track


def refined(
    scans: Iterable[Scan],
    steps: Iterable[Step],
    refiner: Refiner,
    evidence: array[float],
    motions: Iterable[Motion] = (),
) -> Iterator[Step]:
    """Match every tracked scan once more against the finished map, close to its pose; yield the steps.

    If the run is stopped and the scans end early, the remaining steps are yielded unchanged. Observability, visibility
    conflicts and Hessian of each of the others are appended to ``evidence``. ``motions`` are those at the tracked
    scans: the map is made of de-skewed scans, with which a scan as recorded conflicts in a turn.
    """
    moving = iter(motions)
    waiting, coming = iter(steps), iter(scans)
    while some := list(islice(waiting, BATCH_SCANS)):
        batch = list(islice(coming, len(some)))
        points = [refiner.match_points(scan) for scan in batch]
        matches = [refiner.refine(p, s.match) if s.tracked else s.match for p, s in zip(points, some, strict=False)]
        for scan, p, step, match in zip(batch, points, some, matches, strict=False):
            if not step.tracked:
                evidence.extend(NO_EVIDENCE)
                continue
            observed, hessian = refiner.observability(p, match)
            conflicts, motion = refiner.conflicts(p, match), next(moving, None)
            if motion and conflicts >= NOTABLE_CONFLICTS and abs(motion.twist[2]) * scan.sweep_s >= SKEWED_RAD:
                conflicts = min(conflicts, conflicts_deskewed(scan, match, motion, refiner))
            evidence.extend((observed, conflicts, *hessian.tolist()))
        yield from (Step(*step[:2], match, *step[3:]) for step, match in zip(some, matches, strict=False))
        yield from some[len(matches) :]


def conflicts_deskewed(scan: Scan, match: Match, motion: Motion, refiner: Refiner) -> float:
    """Return the visibility conflicts of a scan that is de-skewed by its motion, with the finished map."""
    points = refiner.match_points(scan, motion)
    return refiner.conflicts(points, refiner.refine(points, match))
