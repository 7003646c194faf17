"""Parts of a log that was lost for good: each is tracked on a separate map, and joined to the largest if possible.

A part is joined if several of its scans are found in the map of the largest part by the whole-map search, and agree on
the transform between the two maps. A part that is not joined is neither in the trajectory nor in the map.
"""

from __future__ import annotations

from itertools import islice
from math import ceil, floor
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.pose import Pose
from mavnav.slam.matching.relocalization import apart
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import LOST_SCANS, Step, Steps, lost_intervals, runs_of
from mavnav.slam.methods.pauses import first_found_late, highest_speed, is_too_far, pauses
from mavnav.slam.recovery.part_by_odometry import neighbours, placed_warning, pose_by_odometry
from mavnav.slam.retries.beginning import count_accepted, until_missing
from mavnav.units import NS, pluralize

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mavnav.scan import Scan
    from mavnav.slam.matching.motion_model import Motion
    from mavnav.slam.matching.steps import LostInterval
    from mavnav.slam.methods.registry import Refiner
    from mavnav.slam.track import Track

LEAST_SCANS, MOST_TRACKED = 20, 4
"""Minimum number of scans of a stretch that is tracked on a separate map, and maximum number of such stretches.

Each may take seconds.
"""

GIVE_UP_SCANS = 16
"""Number of successive usable scans without a match that ends the track of a part."""

SEARCHED_SCANS, SEARCHED_AFTER_PAUSE, LEAST_AGREEING = 6, 24, 3
"""Number of scans of a part that are searched in the largest map, and minimum number of them that must agree.

More are searched where the scans pause beside the part: it may have only few places in common with that map.
"""

LONG_AGO_NS = 10**18
"""Time since the last pose of a laser that may be anywhere, 32 years."""

LEAST_TRACKED_SHARE, MOST_LEFT_OUT = 0.5, 0.1
"""Minimum share of scans with a pose, and maximum share of scans in parts that are not joined.

Beyond either bound a log is lost for good: a short track at its end, recovered by chance, is no track of the log.
"""


class Part(Struct, frozen=True):
    """A stretch of the log with a separate map: stamps of its first and last accepted scan, and the number of those.

    ``joined``: the scans are in the map of the run, and their poses in its trajectory.
    """

    start_ns: int
    end_ns: int
    scans: int
    joined: bool


LEAST_BEFORE_END = 0.9
"""Share of scans with a pose from which a log whose end does not match is not lost: the robot was lifted, say."""


def lost_for_good(steps: Steps, lost: Sequence[LostInterval], parts: Sequence[Part] = (), most: float = 1.0) -> bool:
    """Return whether the track ended before the log, has too few of its scans, or too many are in parts not joined.

    A track with a share ``most`` of the scans or more may end before the log.
    """
    share = float(steps.share("tracked"))
    ended = bool(lost) and not lost[-1].recovered and share < most
    left_out = sum(part.scans for part in parts if not part.joined)
    few = share < LEAST_TRACKED_SHARE or left_out > MOST_LEFT_OUT * len(steps)
    return ended or (bool(steps) and few)


def join_lost_parts(track: Track, refiner: Refiner) -> Track:
    """Track the lost stretches of a log that was lost for good on separate maps; join them where possible."""
    if not refiner.builds_map:
        return track
    lost = lost_parts(track) if lost_for_good(track.steps, list(lost_intervals(track.steps))) else []
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
    lost = lost_for_good(track.steps, list(lost_intervals(track.steps)))
    first = None if lost else first_found_late(track.steps, track.motion.period_s)
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
        rest += [range(len(part.steps), stretch.stop)] if stretch.stop - len(part.steps) >= LEAST_SCANS else []
        waiting += [some for some in rest if len(some) < len(stretch)]
        if count_accepted(part) >= LEAST_SCANS:
            parts.append(part)
    return parts


def track_stretch(track: Track, stretch: range) -> Track:
    """Track a stretch of scans from an empty map, until ``GIVE_UP_SCANS`` in a row do not match it."""
    least_points = track.config.robust.min_points
    part = replace(track.with_findings(parts=()), begin=stretch.start)
    scans = islice(track.log_scans(), stretch.stop)
    return part.over(scans, "track again", lambda steps: until_missing(steps, least_points, GIVE_UP_SCANS, np.inf))


def lost_stretches(steps: Steps, within: range) -> list[range]:
    """Return the ranges of ``LEAST_SCANS`` or more successive scans without a pose, as scan numbers."""
    runs = runs_of(~steps.column("tracked")[within.start : within.stop], LEAST_SCANS)
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
    """Join parts to a track where they fit its map, the longest first; each one extends the map for the next.

    A part that shows nothing of the map is placed by odometry if that can be relied on.
    """
    steps, parts = Steps(track.steps), sorted(others, key=len, reverse=True)
    warnings, errors_m = list(track.findings.warnings), np.zeros(len(steps))
    for part in parts:
        wanted = {step.index for step in part if not steps[step.index].tracked}
        log_scans = track.log_scans() if len(wanted) >= LOST_SCANS else ()
        scans = {k: scan for k, scan in enumerate(log_scans) if k in wanted}
        inside = [step for step in part if step.index in scans]
        part_T = part_pose(inside, scans, track, _most_searched(part, track))
        if part_T is None and inside:
            chosen = ((step, scans[step.index]) for step in spread_out(inside, SEARCHED_AFTER_PAUSE))
            placed = pose_by_odometry(inside, chosen, steps, track)
            if placed:
                part_T, error_m = placed
                errors_m[[step.index for step in inside]] = error_m
                warnings.append(placed_warning(inside, steps[0].stamp_ns, error_m))
        if part_T is not None and is_reached(part, part_T, steps, track):
            for step in insert_part(inside, part_T, scans, track):
                steps[step.index] = step
    whole = track.with_findings(parts=tuple(parts), warnings=tuple(warnings), by_odometry_m=errors_m)
    return replace(whole, steps=steps)


def is_reached(part: Sequence[Step], map_T_part: Pose, steps: Steps, track: Track) -> bool:
    """Return whether the laser can have moved between a part and the poses next to it where the scans pause there."""
    before_pauses = [] if track.motion.odometry is not None else pauses(steps, track.motion.period_s)
    for end, other in neighbours(part, steps):
        if not any(min(end.index, other.index) <= k < max(end.index, other.index) for k in before_pauses):
            continue
        elapsed_s = abs(other.stamp_ns - end.stamp_ns) * NS
        fastest_m_s = max(highest_speed(part), highest_speed(accepted_steps(track)))
        if is_too_far(map_T_part @ end.match.map_T_laser, other.match.map_T_laser, elapsed_s, fastest_m_s):
            return False
    return True


def _most_searched(part: Sequence[Step], track: Track) -> int:
    """Return how many scans of a part are searched: more where the scans pause before or after it."""
    ends, before_pauses = (part[0].index - 1, part[-1].index), pauses(track.steps, track.motion.period_s)
    return SEARCHED_AFTER_PAUSE if any(end in before_pauses for end in ends) else SEARCHED_SCANS


def part_pose(part: list[Step], scans: dict[int, Scan], track: Track, most: int = SEARCHED_SCANS) -> Pose | None:
    """Return the pose of a part's map in the map of a track; None unless several of its scans agree on it.

    More than half of the scans that are found must agree.
    """
    refiner = track.refiner
    chosen = spread_out(part, most)
    if refiner is None or len(chosen) < LEAST_AGREEING:
        return None
    anywhere = track.motion._replace(odometry=None).started_at(Pose(), part[0].stamp_ns - LONG_AGO_NS)
    pairs: list[tuple[Pose, Pose]] = []
    for left, step in zip(reversed(range(len(chosen))), chosen, strict=True):
        match = refiner.relocalize(scans[step.index], no_match(Pose()), anywhere)
        if match:
            pairs.append((step.match.map_T_laser, match.map_T_laser))
        if len(pairs) + left < LEAST_AGREEING:
            return None
    return consensus(pairs)


def spread_out(part: list[Step], most: int = SEARCHED_SCANS) -> list[Step]:
    """Choose up to ``most`` steps of a part at different poses; all scans of a laser at rest count as one."""
    places: list[Step] = []
    for step in part:
        if all(apart(step.match.map_T_laser, other.match.map_T_laser) for other in places):
            places.append(step)
    return [places[k] for k in evenly(len(places), most)]


def evenly(count: int, most: int) -> list[int]:
    """Choose numbers below a count, so many at most, at even distances."""
    numbers: list[int] = np.unique(np.linspace(0, count - 1, most).astype(int)).tolist()
    return numbers if count else []


def consensus(pairs: list[tuple[Pose, Pose]]) -> Pose | None:
    """Return the transform from the first to the second poses of most pairs; None if too few agree."""
    transforms = [after @ before.inverse() for before, after in pairs]
    agreeing = [sum(not apart(moved @ a, b) for a, b in pairs) for moved in transforms]
    most = max(agreeing, default=0)
    return transforms[agreeing.index(most)] if most >= LEAST_AGREEING and 2 * most > len(pairs) else None


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


def part_warnings(parts: Sequence[Part], first_ns: int) -> Iterator[str]:
    """Yield a warning for every part that could not be joined."""
    for k, part in enumerate(parts):
        from_s, to_s = ((stamp - first_ns) * NS for stamp in (part.start_ns, part.end_ns))
        what = f"{pluralize(part.scans, 'scan')} from {from_s:.1f} to {to_s:.1f} s"
        if not part.joined and k == 0:
            yield f"{what} do not match the later ones and are left out; the map begins after them"
        elif not part.joined:
            start_s, end_s = floor(from_s * 100.0) / 100.0, ceil(to_s * 100.0) / 100.0  # so that no scan is cut off
            yield (
                f"{what} do not match the map of the others and are left out; "
                f"replay them alone with --start {start_s:.2f} --end {end_s:.2f}"
            )
