"""Opening a log: a survey of it, and the choice of scan topic, mounting, odometry and attitude."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from mavnav.errors import NoScansError, SeveralTopicsError, TopicError
from mavnav.logs.attitude import AttitudeTracks, laser_attitude, laser_rotation
from mavnav.logs.derived_scans import FRAME, ceiling_height_m, partners, virtual_laser
from mavnav.logs.false_returns import body_warning, no_return_m, no_return_warning, own_beams, without_value
from mavnav.logs.log import Log
from mavnav.logs.messages.decode import LASER_TYPES, OTHER_TYPES, scan_topics
from mavnav.logs.preprocessing import KINDS
from mavnav.logs.records import LogContents, ScanCounts, topic_and_frame
from mavnav.logs.stamps import comes_in_bursts, period_and_gaps
from mavnav.logs.survey import Survey, survey
from mavnav.logs.topic_scans import REPEATED_SHARE, Timeline, TopicScans
from mavnav.logs.trajectories import laser_odometry, laser_truth
from mavnav.logs.transforms import frame_name, mounting, transforms_for
from mavnav.pose import Pose
from mavnav.units import NS

LEAST_CONSTANT: Final = 10
"""Number of scans of one stamp, besides the first, that make no log."""

MALFORMED: Final = ("empty", "non_finite_angle", "zero_angle_increment", "impossible_geometry")
"""Reasons to skip a scan that no laser gives, only the program that writes the messages."""

_MOST_NAMED: Final = 8


def open_log(
    path: Path,
    *,
    topic: str | None = None,
    odom: str = "auto",
    start_s: float | None = None,
    end_s: float | None = None,
    extrinsic: Pose | None = None,
    progress: Callable[[int, int], None] | None = None,
    strict: bool = False,
    truth: str | None = None,
    attitude: str = "auto",
    upside_down: bool = False,
    more: tuple[Path, ...] = (),
) -> Log:
    """Survey a log and choose what to use of it.

    Parameters
    ----------
    path
        A file, or the folder of a ROS 2 bag; the content decides the format, not the name.
    topic
        The scan topic, by default the only one; several, joined by commas, are merged by their mountings.
    odom
        ``auto``, ``off``, or a topic.
    start_s, end_s
        Window of the scans to use, in seconds from the first usable scan.
    extrinsic
        ``base_T_laser``, in place of the log's.
    progress
        Called now and then with the bytes done and in all.
    strict
        Leave out scans from where a checksum does not match.
    truth
        The topic of the ground truth, ``auto`` to find it by its name, None to leave it out.
    attitude
        Tilt and height of the laser, by which scans are levelled: ``auto``, ``off``, or a topic.
    upside_down
        The laser is mounted upside down, whatever the log says.
    more
        Files that are the further parts of the bag, in any order.

    Raises
    ------
    UsageError
        No such file, files that are no parts of one bag, or an empty window.
    TopicError
        Several scan topics to choose from, or no such topic; no ground truth, or several; no attitude.
    NoScansError
        No log, or no usable scan in it.
    """
    window = partial(survey, path, start_s=start_s, end_s=end_s, more=more)
    surveyed = window(topic=topic, progress=progress, strict=strict, truth=truth, odom=odom, attitude=attitude)
    return choose(surveyed, topic=topic, extrinsic=extrinsic, upside_down=upside_down)


def choose(
    survey: Survey, *, topic: str | None = None, extrinsic: Pose | None = None, upside_down: bool = False
) -> Log:
    """Choose topic, odometry and mounting of a surveyed log; raises TopicError and NoScansError.

    Several topics, joined by commas, are merged by their mountings.
    """
    if topic is not None and topic not in survey.scans and len(names := scan_topics(topic)) > 1:
        if upside_down:
            raise TopicError(
                "upside_down is of one laser; several --topic are merged by /tf_static, which turns them over"
            )
        return _multi_laser_log(survey, names, extrinsic)
    name = _chosen_topic(survey, topic)
    scans = survey.scans[name]
    if doubt := scans.scan_filter.doubt:
        raise NoScansError(f"{survey.path}: {name}: {doubt}")
    timeline = scans.timeline(survey.window_s)
    if timeline.first is None:
        raise NoScansError(_no_usable(survey, name, scans, timeline))
    if timeline.skipped["duplicate_stamp"] >= scans.total - 1 >= LEAST_CONSTANT:
        what = f"all {scans.total} scans on {name} have one stamp and one time of recording"
        advice = "nothing tells when they were taken: record the log again, and check the clock of the driver"
        raise NoScansError(f"{survey.path}: {what}; {advice}")
    sensor, frame_id = timeline.first
    period_s, gaps = period_and_gaps(timeline.stamps_ns)
    skipped = dict(sorted((scans.refused + timeline.skipped).items()))
    sample, none_m = scans.sample, no_return_m(scans.sample)
    if none_m is not None:
        sample = replace(sample, ranges_m=[without_value(ranges_m, none_m) for ranges_m in sample.ranges_m])
    own = own_beams(sample)
    log = Log(
        topic=name,
        frame_id=frame_id,
        sensor=sensor,
        counts=ScanCounts(scans.total, len(timeline.order), skipped, timeline.suspect, timeline.repeated),
        cleaning=dict(zip(KINDS, timeline.cleaning.tolist(), strict=True)),
        first_ns=int(timeline.stamps_ns[0]),
        last_ns=int(timeline.stamps_ns[-1]),
        start_s=timeline.later_ns * NS,
        period_s=period_s,
        gaps=gaps,
        stamp_source=timeline.source,
        clock=timeline.clock,
        none_m=none_m,
        own_beams=own,
        _order=timeline.order,
        stamps_ns=timeline.stamps_ns,
        _ranges=scans.ranges,
        **{name: getattr(survey, name) for name in LogContents.__struct_fields__},
    )
    if timeline.distrust:
        text = f"{name}: the scans' own stamps are unusable ({timeline.distrust}); the times of recording are used"
        log = replace(log, warnings=(*log.warnings, text))
    if none_m is not None:
        log = replace(log, warnings=(*log.warnings, f"{name}: {no_return_warning(none_m)}"))
    if own is not None:
        log = replace(log, warnings=(*log.warnings, f"{name}: {body_warning(own, sensor)}"))
    return _with_motion(log, survey, extrinsic, upside_down=upside_down)


def _chosen_topic(survey: Survey, topic: str | None) -> str:
    """Return the scan topic to use; several to choose from are listed."""
    if topic is not None and any(topic_and_frame(name)[0] == topic != name for name in survey.scans):
        text = f"several lasers on {topic}: {_counts(survey)}; choose one with --topic NAME"
        raise SeveralTopicsError(f"{survey.path}: {text}, or merge them in a replay with both names, joined by a comma")
    if topic is not None and topic not in survey.scans:
        named = [t for t in survey.topics if t.name == topic]
        lasers = {t.name for t in survey.topics if t.type in LASER_TYPES and t.count}
        if not named or survey.scans or (lasers and topic not in lasers):
            raise TopicError(f"{survey.path}: no scans on topic {topic!r}; {_list_topics(survey)}")
    if topic is None and len(survey.scans) > 1:
        text = f"{survey.path}: several scan topics: {_counts(survey)}; choose one with --topic NAME"
        raise SeveralTopicsError(f"{text}, or merge them in a replay with their names, joined by a comma")
    if not survey.scans:
        raise NoScansError(_no_scans(survey))
    return topic if topic is not None else next(iter(survey.scans))


def _counts(survey: Survey) -> str:
    return _some([f"{name} ({scans.total} scans)" for name, scans in sorted(survey.scans.items())])


def _some(names: list[str]) -> str:
    """List names in a line that a person still reads."""
    return ", ".join(names[:_MOST_NAMED]) + (f" and {len(names) - _MOST_NAMED} more" if names[_MOST_NAMED:] else "")


def _list_topics(survey: Survey) -> str:
    lasers = [f"{t.name} ({t.count} scans)" for t in survey.topics if t.type.endswith("LaserScan")]
    return f"scan topics here: {_some(lasers) or 'none'}"


def _no_scans(survey: Survey) -> str:
    lasers = {topic.name for topic in survey.topics if topic.type in LASER_TYPES and topic.count}
    reason = next((d for d in survey.damage if d.where in lasers or not any(t.count for t in survey.topics)), None)
    if reason is not None:
        return f"{survey.path}: no usable scans; {reason.what}{f' ({reason.where})' if reason.where else ''}"
    others = [t.name for t in survey.topics if t.type in OTHER_TYPES and t.count]
    if others:
        advice = f"choose the messages to take scans from with --topic: {_some(others)}"
        return f"{survey.path}: no LaserScan messages; {advice}"
    kinds = [f"{t.name} ({t.type or 'no type'} in {t.encoding or 'no encoding'}, {t.count})" for t in survey.topics]
    return f"{survey.path}: no LaserScan messages; topics here: {_some(kinds) or 'none'}"


def _no_usable(survey: Survey, name: str, scans: TopicScans, timeline: Timeline) -> str:
    """Say why none of a topic's scans is usable."""
    skipped = scans.refused + timeline.skipped
    reasons = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in skipped.items())
    hint = ""
    if any(end is not None for end in survey.window_s) and len(stamps_ns := scans.timeline().stamps_ns):
        hint = f"; the scans last {(stamps_ns[-1] - stamps_ns[0]) * NS:.1f} s: check --start and --end"
    elif scans.refused["no_valid_beam"] * 2 > scans.total:
        hint = f"; {scans.scan_filter.invalid}"
    elif sum(scans.refused[reason] for reason in MALFORMED) * 2 > scans.total:
        hint = "; see what publishes them: each needs ranges, and finite angles with a step between them"
    return f"{survey.path}: none of the {scans.total} scans on {name} is usable ({reasons}){hint}"


def _multi_laser_log(survey: Survey, topics: list[str], extrinsic: Pose | None) -> Log:
    """Merge the scans of several lasers; raises TopicError where a mounting is not known."""
    if extrinsic is not None:
        raise TopicError("--extrinsic is the pose of one laser; several --topic are merged by /tf_static")
    if survey.motion.attitudes.is_named:
        raise TopicError("--attitude is that of one laser; several --topic are merged as they are: name one of them")
    survey = replace(survey, motion=replace(survey.motion, attitudes=AttitudeTracks("off")))
    logs = tuple(choose(_same_window(survey, topics[0], topic), topic=topic) for topic in topics)
    first, bases = logs[0], {log.base_frame for log in logs}
    unmounted = [log.topic for log in logs if log.base_T_laser is None]
    if unmounted or len(bases) > 1:
        of = unmounted[0] if unmounted else first.topic
        text = f"{survey.path}: topics are merged by their mountings on one base, and that of {of} is not known"
        raise TopicError(f"{text}; record /tf_static, or choose one --topic")
    log = replace(
        first,
        topic=",".join(topics),
        frame_id=FRAME,
        sensor=virtual_laser([log.mounting for log in logs]),
        cleaning={kind: sum(log.cleaning[kind] for log in logs) for kind in first.cleaning},
        upside_down=False,
        warnings=(),
        _ranges=None,
        _merged=logs,
        _kept=[],
    )
    warnings = [*(text for log in logs for text in log.warnings), *_unpaired_warnings(logs)]
    log = replace(_with_motion(log, survey, Pose()), warnings=tuple(dict.fromkeys(warnings)))
    return replace(log, base_frame=first.base_frame, mounting_source="tf_static")


def _same_window(survey: Survey, first: str, topic: str) -> Survey:
    """Return the survey with the window of topic ``first`` in seconds from the first scan of another ``topic``.

    It is wider by half a period of the first, as far as its scans have partners.
    """
    if topic == first or not (first in survey.scans and topic in survey.scans):
        return survey
    stamps_ns, others_ns = (survey.scans[name].timeline().stamps_ns for name in (first, topic))
    if not (len(stamps_ns) and len(others_ns)):
        return survey
    later_s, half_s = int(stamps_ns[0] - others_ns[0]) * NS, 0.5 * period_and_gaps(stamps_ns)[0]
    start_s, end_s = survey.window_s
    start_s = None if start_s is None else start_s + later_s - half_s
    end_s = None if end_s is None else end_s + later_s + half_s
    return replace(survey, window_s=(start_s, end_s))


def _unpaired_warnings(lasers: Sequence[Log]) -> list[str]:
    """Return a line for every merged laser of which scans are left out, for none of the first is as near."""
    mounted = [log.mounting for log in lasers]
    used = [int((partners(mounted[0].stamps_ns, m.stamps_ns) >= 0).sum()) for m in mounted[1:]]
    return [
        f"{log.topic}: {len(log) - n} of {len(log)} scans are not merged: no scan of {lasers[0].topic} is near in time"
        for log, n in zip(lasers[1:], used, strict=True)
        if n < len(log)
    ]


def _scan_warnings(log: Log) -> Iterator[str]:
    """Say what there is to warn about the scans and their time."""
    counts = log.counts
    for reason, count in counts.skipped.items():
        if reason != "outside_window":
            yield f"{log.topic}: {count} of {counts.total} scans skipped: {reason.replace('_', ' ')}"
    if counts.repeated > REPEATED_SHARE * counts.usable:
        text = f"{log.topic}: {counts.repeated} of {counts.usable} scans repeat the one before"
        meaning = "right at rest in a simulation without noise; else the track is wrong there without odometry"
        yield f"{text}: {meaning}: check the driver, or cut the log with --start and --end"
    if comes_in_bursts(log.stamps_ns):
        text = f"less than 5 ms apart, of scans that were taken every {log.period_s * 1e3:.0f} ms"
        advice = "velocities are uncertain; stamp scans by the laser's clock"
        yield f"{log.topic}: the stamps come in bursts, {text}: {advice}"


def _with_motion(log: Log, survey: Survey, extrinsic: Pose | None, *, upside_down: bool = False) -> Log:
    """Add mounting and odometry, and what there is to warn about time."""
    motion, warnings = survey.motion, [*log.warnings, *_scan_warnings(log)]
    laser = frame_name((log._merged or (log,))[0].frame_id)  # noqa: SLF001  the log is made here
    frames = transforms_for(motion.frames, log.topic, survey.lasers)

    def leads_to_laser(base: str) -> bool:
        return bool(base) and frames.find(base, laser) is not None

    track = motion.odometry.choose(warnings.append, leads_to_laser, log.topic, survey.lasers)
    bases = [track.frame] if track and track.frame else frames.bases(laser)
    place, of_mounting = len(warnings), list[str]()
    mounted = mounting(frames, log.frame_id, bases, of_mounting.append)
    base_frame, base_T_laser, overhead = mounted or (bases[0] if track else None, None, False)
    if mounted and not extrinsic and frames.contradicts(mounted.base_frame, laser):
        text = f"/tf_static gives several transforms from {base_frame!r} to {log.frame_id!r}; the last is used"
        warnings.append(f"{text}: see what publishes them, or give the mounting with --extrinsic x,y,yaw")
    if overhead and not upside_down:
        done = "turned over (not with --extrinsic x,y,yaw)"
        if extrinsic:
            done = "used as recorded, as --extrinsic knows the plane alone"
        text = f"the transforms say that the laser ({log.frame_id}) is mounted upside down"
        warnings.append(f"{text}; its scans are {done}")
    base_T_laser = extrinsic or base_T_laser
    if base_frame and base_T_laser is None and frames.moves(base_frame, laser):
        text = f"the transform from {base_frame!r} to {log.frame_id!r} moves"
        warnings.append(f"{text}; give where the laser mostly is with --extrinsic x,y,yaw")
    odometry = laser_odometry(track, log, base_frame, base_T_laser, warnings.append) if track else None
    log = replace(log, upside_down=upside_down or (overhead and extrinsic is None))
    attitude = laser_attitude(motion.attitudes, motion.imus, frames, log, warnings.append)
    if attitude is None:  # else a tilted mounting is levelled as well
        warnings[place:place] = of_mounting
    imu = laser_rotation(motion.imus, log, motion.odometry.wanted, warnings.append)
    known = motion.truth.choose(survey.topics, log.topic, frames, laser)
    placing = (log, frames, base_T_laser, extrinsic, warnings.append)
    log = replace(
        log,
        truth=laser_truth(known, *placing) if known else None,
        base_T_laser=base_T_laser,
        mounting_source="option" if extrinsic else "tf_static" if mounted else None,
        base_frame=base_frame,
        odometry=odometry,
        imu=imu.without_tilt() if imu and attitude else imu,
        warnings=tuple(dict.fromkeys(warnings)),
    )
    if attitude is None:
        return log
    return replace(log, attitude=replace(attitude, ceiling_m=ceiling_height_m(log, attitude)), _kept=[])
