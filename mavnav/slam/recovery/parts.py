"""Parts of a log that was lost for good: each is tracked on a separate map, and joined to the largest if possible.

A part is joined where what was seen before and after the gap beside it agrees; else if several of its scans are found
in the map of the largest part by the whole-map search, and agree on the transform between the two maps; else by
odometry.
A part that is not joined is neither in the trajectory nor in the map.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from math import ceil, floor

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.pose import Pose
from mavnav.scan import Scan, runs_of
from mavnav.slam.matching.budget import LONG_LOST_SCANS
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.relocalization import AGREEING_SCANS, apart
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import LOST_SCANS, LostInterval, Step, Steps, evenly, lost_intervals
from mavnav.slam.methods.pauses import first_found_late, highest_speeds, pauses
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.recovery.across_gap import LOCAL_SCANS, pose_across_gap, reach_across
from mavnav.slam.recovery.part_by_odometry import neighbours, placed_warning, pose_by_odometry
from mavnav.slam.retries.beginning import LEAST_TRACKED_SHARE, count_accepted, until_missing
from mavnav.slam.track import Track
from mavnav.units import NS, pluralize

MOST_TRACKED = 4
"""Maximum number of stretches of lost scans that are tracked on separate maps."""

SEARCHED_SCANS = 6
"""Number of scans of a part that are searched in the largest map."""

LONG_AGO_NS = 10**18
"""Time since the last pose of a laser that may be anywhere, 32 years."""

MOST_LEFT_OUT = 0.1
"""Largest share of scans in parts that are not joined: beyond, the track is not one of the whole log."""


class Part(Struct, frozen=True):
    """A stretch of the log with a separate map: stamps of its first and last accepted scan, and the number of those.

    ``joined``: the scans are in the map of the run, and their poses in its trajectory.
    """

    start_ns: int
    end_ns: int
    scans: int
    joined: bool


def lost_for_good(
    steps: Steps, lost: Sequence[LostInterval], parts: Sequence[Part] = (), most: float = 1.0, bridged: int = 0
) -> bool:
    """Return whether the track ended before the log, has too few of its scans, or too many are in parts not joined.

    A track with a share ``most`` of the scans or more may end before the log. ``bridged`` scans have poses by odometry.
    """
    share = float(steps.share("tracked")) + bridged / max(len(steps), 1)
    ended = bool(lost) and not lost[-1].recovered and share < most
    left_out = sum(part.scans for part in parts if not part.joined)
    few = share < LEAST_TRACKED_SHARE or left_out > MOST_LEFT_OUT * len(steps)
    return ended or (bool(steps) and few)


def is_lost(steps: Steps) -> bool:
    """Return `lost_for_good` of a track that nothing was joined to."""
    return lost_for_good(steps, list(lost_intervals(steps)))


def join_lost_parts(track: Track, refiner: Refiner) -> Track:
    """Track the lost stretches of a log that was lost for good on separate maps; join them where possible."""
    if not refiner.builds_map:
        return track
    lost = lost_parts(track) if is_lost(track.steps) else []
    largest = max([track, *lost], key=count_accepted)
    others = [accepted_steps(t) for t in [track, *lost] if t is not largest]
    taken = {step.index for part in others for step in part}
    others += [part for part in track.findings.parts if not taken.intersection(step.index for step in part)]
    whole = with_all_scans(replace(largest, findings=replace(track.findings, parts=())), track.steps)
    return join_parts(whole, [part for part in others if part])


def drop_late_poses(track: Track, refiner: Refiner) -> Track:
    """Give up the poses after a pause in the scans after which the laser was found late: one scan is weak evidence.

    Only the scans before it are tracked again; `join_lost_parts` tracks the others, and joins them if several agree. A
    log that is lost for good is left as it is: that is said anyway.
    """
    if not refiner.builds_map or track.motion.odometry is not None:
        return track
    first = None if is_lost(track.steps) else first_found_late(track.steps, track.motion.period_s)
    if first is None:
        return track
    before = track.over(islice(track.log_scans(), first), "track again")
    return with_all_scans(before, track.steps)


def lost_parts(track: Track) -> list[Track]:
    """Track the longest stretches of lost scans, each from an empty map; then the stretches lost in these tracks."""
    parts: list[Track] = []
    waiting = lost_stretches(track.steps, range(len(track.steps)))
    for _ in range(MOST_TRACKED):
        if not waiting:
            break
        stretch = waiting.pop(int(np.argmax([len(some) for some in waiting])))
        part = track_stretch(track, stretch)
        rest = lost_stretches(part.steps, range(stretch.start, len(part.steps)))
        rest += [range(len(part.steps), stretch.stop)] if stretch.stop - len(part.steps) >= LOST_SCANS else []
        waiting += [some for some in rest if len(some) < len(stretch)]
        if count_accepted(part) >= LOST_SCANS:
            parts.append(part)
    return parts


def track_stretch(track: Track, stretch: range) -> Track:
    """Track a stretch of scans from an empty map, until ``LONG_LOST_SCANS`` in a row do not match it."""
    least_points = track.config.robust.min_points
    part = replace(track.with_findings(parts=()), begin=stretch.start)
    scans = islice(track.log_scans(), stretch.stop)
    return part.over(scans, "track again", lambda steps: until_missing(steps, least_points, LONG_LOST_SCANS, np.inf))


def lost_stretches(steps: Steps, within: range) -> list[range]:
    """Return the ranges of ``LOST_SCANS`` or more successive scans without a pose, as scan numbers."""
    runs = runs_of(~steps.column("tracked")[within.start : within.stop], LOST_SCANS)
    return [range(within.start + run.start, within.start + run.stop) for run in runs]


def accepted_steps(track: Track) -> tuple[Step, ...]:
    """Return the steps with a pose."""
    return tuple(step for step in track.steps if step.tracked)


def with_all_scans(track: Track, steps: Steps) -> Track:
    """Return the track of a part of a log with a step for each scan of the log; the other scans have no pose."""
    if track.steps is steps:
        return track
    own = {step.index: step for step in track.steps if step.tracked}
    none = (own.get(s.index) or s._replace(match=no_match(Pose(), s.match.beams_used), tracked=False) for s in steps)
    return replace(track, steps=Steps(none))


def join_parts(track: Track, others: list[tuple[Step, ...]]) -> Track:
    """Join parts to a track where they fit, each extends it for the next: across gaps first, then anywhere in its map.

    A part that shows nothing of the map is placed by odometry if that can be relied on.
    """
    steps, longest_first = Steps(track.steps), sorted(others, key=len, reverse=True)
    waiting = [part for part in longest_first if not all(steps[step.index].tracked for step in part)]
    warnings, errors_m = list(track.findings.warnings), np.zeros(len(steps))
    scans = _scans_near(others, steps, track) if others else {}
    while (placed := _next_placed(waiting, steps, scans, track)) is not None:
        part, map_T_part, error_m = placed
        waiting.remove(part)
        inside = [step for step in part if not steps[step.index].tracked]
        if error_m is not None:
            errors_m[[step.index for step in inside]] = error_m
            warnings.append(placed_warning(inside, steps[0].stamp_ns, error_m))
        for step in insert_part(inside, map_T_part, scans, track):
            steps[step.index] = step
    whole = track.with_findings(parts=tuple(others), warnings=tuple(warnings), by_odometry_m=errors_m)
    return replace(whole, steps=steps)


def _scans_near(parts: Sequence[Sequence[Step]], steps: Steps, track: Track) -> dict[int, Scan]:
    """Return the scans of parts, and those beside them with which they are compared, by number."""
    wanted = {step.index for part in parts for step in part}
    for part in parts:
        wanted.update(step.index for _, beyond in sides_of(part, steps) for step in beyond)
    return {k: scan for k, scan in enumerate(track.log_scans()) if k in wanted}


def _next_placed(
    waiting: Sequence[tuple[Step, ...]], steps: Steps, scans: dict[int, Scan], track: Track
) -> tuple[tuple[Step, ...], Pose, float | None] | None:
    """Return a part that can be joined, its pose, and the error to be expected if odometry alone gives it, m.

    Of the ways to place a part the surest is tried first with every part.
    """
    for part in waiting:
        map_T_part = _pose_across_gaps(part, steps, scans, track)
        if map_T_part is not None:
            return part, map_T_part, None
    for part in waiting:
        map_T_part = part_pose(list(part), scans, track)
        if map_T_part is not None and is_reached(part, map_T_part, steps, track):
            return part, map_T_part, None
    for part in waiting:
        chosen = ((step, scans[step.index]) for step in spread_out(list(part)))
        placed = pose_by_odometry(part, chosen, steps, track)
        if placed is not None and is_reached(part, placed[0], steps, track):
            return part, *placed
    return None


def _pose_across_gaps(part: Sequence[Step], steps: Steps, scans: dict[int, Scan], track: Track) -> Pose | None:
    """Return the pose of a part's map by what was seen beyond the gap before or after it."""
    fastest = usual_speeds(part, track)
    poses = (pose_across_gap(beyond, own, scans, track, fastest) for own, beyond in sides_of(part, steps))
    return next((pose for pose in poses if pose is not None), None)


def sides_of(part: Sequence[Step], steps: Steps) -> Iterator[tuple[Sequence[Step], Sequence[Step]]]:
    """Yield the steps of a part at its beginning and at its end, each with those of the track beyond, nearest first."""
    for own, beyond in ((part, range(part[0].index - 1, -1, -1)), (part[::-1], range(part[-1].index + 1, len(steps)))):
        tracked = (steps[k] for k in beyond if steps[k].tracked)
        near = list(islice(tracked, LOCAL_SCANS))
        if near:
            yield own[:LOCAL_SCANS], near


def is_reached(part: Sequence[Step], map_T_part: Pose, steps: Steps, track: Track) -> bool:
    """Return whether the laser can have moved between a part and the poses next to it.

    Where the scans pause, it moves as before; else it may have been carried, but not faster than any vehicle.
    """
    before_pauses = pauses(steps, track.motion.period_s)
    for end, other in neighbours(part, steps):
        first, last = sorted((end.index, other.index))
        paused = any(first <= k < last for k in before_pauses)
        reach = reach_across(other, end, track, usual_speeds(part, track) if paused else track.motion.fastest)
        if reach.expected.gap(map_T_part @ end.match.map_T_laser)[0] > reach.off_m:
            return False
    return True


def usual_speeds(part: Sequence[Step], track: Track) -> tuple[float, float]:
    """Return the highest usual speeds of a track and a part of its log, m/s and rad/s."""
    (a_m_s, a_rad_s), (b_m_s, b_rad_s) = highest_speeds(part), highest_speeds(accepted_steps(track))
    return max(a_m_s, b_m_s), max(a_rad_s, b_rad_s)


def part_pose(part: list[Step], scans: dict[int, Scan], track: Track) -> Pose | None:
    """Return the pose of a part's map in the map of a track; None unless several of its scans agree on it.

    More than half of the scans that are found must agree.
    """
    refiner = track.refiner
    chosen = spread_out(part)
    if refiner is None or len(chosen) < AGREEING_SCANS:
        return None
    anywhere = track.motion._replace(odometry=None).started_at(Pose(), part[0].stamp_ns - LONG_AGO_NS)
    pairs: list[tuple[Pose, Pose]] = []
    for left, step in zip(reversed(range(len(chosen))), chosen, strict=True):
        match = refiner.relocalize(scans[step.index], no_match(Pose()), anywhere)
        if match:
            pairs.append((step.match.map_T_laser, match.map_T_laser))
        if len(pairs) + left < AGREEING_SCANS:
            return None
    return consensus(pairs)


def spread_out(part: list[Step], most: int = SEARCHED_SCANS) -> list[Step]:
    """Choose up to ``most`` steps of a part at different poses; all scans of a laser at rest count as one."""
    places: list[Step] = []
    for step in part:
        if all(apart(step.match.map_T_laser, other.match.map_T_laser) for other in places):
            places.append(step)
    return [places[k] for k in evenly(len(places), most)]


def consensus(pairs: list[tuple[Pose, Pose]]) -> Pose | None:
    """Return the transform from the first to the second poses of most pairs; None if too few agree."""
    transforms = [after @ before.inverse() for before, after in pairs]
    agreeing = [sum(not apart(moved @ a, b) for a, b in pairs) for moved in transforms]
    most = max(agreeing, default=0)
    return transforms[agreeing.index(most)] if most >= AGREEING_SCANS and 2 * most > len(pairs) else None


def insert_part(part: Sequence[Step], map_T_part: Pose, scans: dict[int, Scan], track: Track) -> Iterator[Step]:
    """Insert the scans of a part into the map of the track at their transformed poses; yield their steps."""
    here: Motion | None = None
    for step in part:
        pose = map_T_part @ step.match.map_T_laser
        here = here or track.motion.started_at(pose, step.stamp_ns)
        track.method.insert(scans[step.index], pose, here)
        here = here.moved_to(pose, step.stamp_ns)
        yield step._replace(match=step.match._replace(map_T_laser=pose))


def parts_of(track: Track) -> tuple[Part, ...]:
    """Return the parts of a log in order of time; none if it was tracked as a whole."""
    parted = track.findings.parts
    if not parted:
        return ()
    tracked, elsewhere = track.steps.column("tracked"), {step.index for part in parted for step in part}
    own = tuple(step for step in track.steps if step.tracked and step.index not in elsewhere)
    parts = [(own, True), *((p, bool(2 * tracked[[step.index for step in p]].sum() > len(p))) for p in parted)]
    records = (Part(part[0].stamp_ns, part[-1].stamp_ns, len(part), whole) for part, whole in parts if part)
    return tuple(sorted(records, key=lambda part: part.start_ns))


def part_warnings(parts: Sequence[Part], first_ns: int, log_start_s: float = 0.0) -> Iterator[str]:
    """Yield a warning for every part that could not be joined.

    Advice counts from the first scan of the log, ``log_start_s`` before the first of the run.
    """
    for k, part in enumerate(parts):
        from_s, to_s = ((stamp - first_ns) * NS for stamp in (part.start_ns, part.end_ns))
        what = f"{pluralize(part.scans, 'scan')} from {from_s:.1f} to {to_s:.1f} s"
        if not part.joined and k == 0:
            yield f"{what} do not match the later ones and are left out; the map begins after them"
        elif not part.joined:
            start_s = floor((log_start_s + from_s) * 100.0) / 100.0  # so that no scan is cut off
            end_s = ceil((log_start_s + to_s) * 100.0) / 100.0
            yield (
                f"{what} do not match the map of the others and are left out; "
                f"replay them alone with --start {start_s:.2f} --end {end_s:.2f}"
            )
