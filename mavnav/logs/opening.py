"""Opening a log: a survey of it, and the choice of scan topic, mounting, odometry and attitude."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Literal

from msgspec.structs import replace

from mavnav.errors import NoScansError, TopicError
from mavnav.logs.attitude import AttitudeTracks
from mavnav.logs.ceiling import with_ceiling
from mavnav.logs.levelling import laser_attitude
from mavnav.logs.log import Log
from mavnav.logs.merging import FRAME, partners, virtual_laser
from mavnav.logs.messages.decode import scan_topics
from mavnav.logs.odometry import jump, without_resets
from mavnav.logs.preprocessing import KINDS
from mavnav.logs.records import Imu, Odometry, ScanCounts
from mavnav.logs.stamps import REPEATED_SHARE, comes_in_bursts, period_and_gaps
from mavnav.logs.survey import Survey, survey
from mavnav.logs.topic_choice import chosen_topic, no_usable
from mavnav.logs.transforms import frame_name, mounting
from mavnav.logs.truth import laser_truth
from mavnav.pose import Pose
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from mavnav.logs.odometry import OdometryTrack

LEAST_CONSTANT = 10
"""Number of scans of one stamp, besides the first, that make no log."""


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

    Raises
    ------
    UsageError
        No such file, or an empty window.
    TopicError
        Several scan topics to choose from, or no such topic; no ground truth, or several; no attitude.
    NoScansError
        No log, or no usable scan in it.
    """
    window = partial(survey, path, start_s=start_s, end_s=end_s)
    surveyed = window(topic=topic, progress=progress, strict=strict, truth=truth, odom=odom, attitude=attitude)
    return choose(surveyed, topic=topic, odom=odom, extrinsic=extrinsic, upside_down=upside_down)


def choose(
    survey: Survey,
    *,
    topic: str | None = None,
    odom: str = "auto",
    extrinsic: Pose | None = None,
    upside_down: bool = False,
) -> Log:
    """Choose topic, odometry and mounting of a surveyed log; raises TopicError and NoScansError.

    Several topics, joined by commas, are merged by their mountings.
    """
    if topic is not None and topic not in survey.scans and len(names := scan_topics(topic)) > 1:
        if upside_down:
            raise TopicError(
                "upside_down is of one laser; several --topic are merged by /tf_static, which turns them over"
            )
        return _multi_laser_log(survey, names, odom, extrinsic)
    name = chosen_topic(survey, topic)
    scans = survey.scans[name]
    if doubt := scans.scan_filter.doubt:
        raise NoScansError(f"{survey.path}: {name}: {doubt}")
    timeline = scans.timeline(survey.window_s)
    if timeline.first is None:
        raise NoScansError(no_usable(survey, name, scans, timeline))
    if timeline.skipped["duplicate_stamp"] >= scans.total - 1 >= LEAST_CONSTANT:
        raise NoScansError(
            f"{survey.path}: all {scans.total} scans on {name} have one stamp and one time of recording; nothing "
            "tells when they were taken: record the log again, and check the clock of the driver"
        )
    sensor, frame_id = timeline.first
    period_s, gaps = period_and_gaps(timeline.stamps_ns)
    skipped = dict(sorted((scans.refused + timeline.skipped).items()))
    log = Log(
        topic=name,
        frame_id=frame_id,
        sensor=sensor,
        counts=ScanCounts(scans.total, len(timeline.order), skipped, timeline.suspect, timeline.repeated),
        cleaning=dict(zip(KINDS, timeline.cleaning.tolist(), strict=True)),
        first_ns=int(timeline.stamps_ns[0]),
        last_ns=int(timeline.stamps_ns[-1]),
        period_s=period_s,
        gaps=gaps,
        stamp_source=timeline.source,
        _order=timeline.order,
        _stamps_ns=timeline.stamps_ns,
        _ranges=scans.ranges,
        **{name: getattr(survey, name) for name in Survey.__struct_fields__ if name in Log.__struct_fields__},
    )
    return _with_motion(log, survey, odom, extrinsic, upside_down=upside_down)


def _multi_laser_log(survey: Survey, topics: list[str], odom: str, extrinsic: Pose | None) -> Log:
    """Merge the scans of several lasers; raises TopicError where a mounting is not known."""
    if extrinsic is not None:
        raise TopicError("--extrinsic is the pose of one laser; several --topic are merged by /tf_static")
    if survey.motion.attitudes.is_named:
        raise TopicError("--attitude is that of one laser; several --topic are merged as they are: name one of them")
    survey = replace(survey, motion=replace(survey.motion, attitudes=AttitudeTracks("off")))
    logs = tuple(choose(_same_window(survey, topics[0], topic), topic=topic, odom=odom) for topic in topics)
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
    log = _with_motion(log, survey, odom, Pose())
    return replace(
        log, base_frame=first.base_frame, mounting_source="tf_static", warnings=tuple(dict.fromkeys(warnings))
    )


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
    return replace(
        survey,
        window_s=(
            None if start_s is None else start_s + later_s - half_s,
            None if end_s is None else end_s + later_s + half_s,
        ),
    )


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
    if log.stamp_source == "log":
        yield f"{log.topic}: the scans' own stamps are unusable; the times of recording are used"
    for reason, count in counts.skipped.items():
        if reason != "outside_window":
            yield f"{log.topic}: {count} of {counts.total} scans skipped: {reason.replace('_', ' ')}"
    if counts.repeated > REPEATED_SHARE * counts.usable:
        yield (
            f"{log.topic}: {counts.repeated} of {counts.usable} scans repeat the one before; where the laser moved "
            "meanwhile the track is wrong: check the driver, or cut the log with --start and --end"
        )
    if comes_in_bursts(log._stamps_ns):  # noqa: SLF001  the log is made here
        yield (
            f"{log.topic}: the stamps come in bursts, less than 5 ms apart, of scans that were taken every "
            f"{log.period_s * 1e3:.0f} ms: velocities are uncertain; stamp scans by the laser's clock"
        )


def _with_motion(log: Log, survey: Survey, odom: str, extrinsic: Pose | None, *, upside_down: bool = False) -> Log:
    """Add mounting and odometry, and what there is to warn about time."""
    warnings = [*log.warnings, *_scan_warnings(log)]
    laser = frame_name((log._merged or (log,))[0].frame_id)  # noqa: SLF001  the log is made here
    track = survey.motion.odometry.choose(
        odom, warnings.append, lambda base: bool(base) and survey.motion.frames.find(base, laser) is not None
    )
    bases = [track.base_frame] if track and track.base_frame else survey.motion.frames.bases(laser)
    place, of_mounting = len(warnings), list[str]()
    mounted = mounting(survey.motion.frames, log.frame_id, bases, of_mounting.append)
    base_frame, base_T_laser, overhead = mounted or (bases[0] if track else None, None, False)
    if mounted and not extrinsic and survey.motion.frames.contradicts(mounted.base_frame, laser):
        warnings.append(
            f"/tf_static gives several transforms from {base_frame!r} to {log.frame_id!r}; the last is used: see what "
            "publishes them, or give the mounting with --extrinsic x,y,yaw"
        )
    if overhead and not upside_down:
        done = (
            "used as recorded, as --extrinsic knows the plane alone"
            if extrinsic
            else "turned over (not with --extrinsic x,y,yaw)"
        )
        warnings.append(
            f"the transforms say that the laser ({log.frame_id}) is mounted upside down; its scans are {done}"
        )
    base_T_laser = extrinsic or base_T_laser
    source: Literal["tf_static", "option"] | None = "tf_static" if mounted else None
    odometry = _odometry(track, log, base_frame, base_T_laser, warnings.append) if track else None
    upside_down = upside_down or (overhead and extrinsic is None)
    attitude = laser_attitude(
        survey.motion.attitudes.sources(survey.motion.imus, survey.topics),
        survey.motion.frames,
        log.frame_id,
        log.mounting.stamps_ns,
        log.stamp_source,
        named=survey.motion.attitudes.is_named,
        upside_down=upside_down,
        warn=warnings.append,
    )
    if attitude is None:  # else a tilted mounting is levelled as well
        warnings[place:place] = of_mounting
    imu = _imu(log, survey, odom, warnings.append)
    known = survey.motion.truth.choose(survey.topics)
    sources = (log.stamp_source, log.frame_id, survey.motion.frames, base_T_laser, extrinsic, warnings.append)
    log = replace(
        log,
        truth=laser_truth(known, *sources) if known else None,
        base_T_laser=base_T_laser,
        mounting_source="option" if extrinsic else source,
        base_frame=base_frame,
        upside_down=upside_down,
        odometry=odometry,
        imu=imu.without_tilt() if imu and attitude else imu,
        warnings=tuple(dict.fromkeys(warnings)),
    )
    return log if attitude is None else replace(log, attitude=with_ceiling(attitude, log), _kept=[])


def _odometry(
    track: OdometryTrack, log: Log, base_frame: str | None, base_T_laser: Pose | None, warn: Callable[[str], None]
) -> Odometry | None:
    """Return the odometry of a track, without resets; None, with a warning, where it does not fit the scans."""
    odom_T_base = track.trajectory(log.stamp_source, warn)
    if not len(odom_T_base):
        return None
    if not _share_time(odom_T_base.stamps_ns, log):
        warn(f"{track.topic}: odometry and scans share no time; it is not used, check its clock")
        return None
    if text := jump(odom_T_base):
        warn(f"{track.topic}: the odometry {text}; it is not used, check it or write --odom off")
        return None
    if base_T_laser is None:
        text = f"no transform from {base_frame!r} to {log.frame_id!r}; the odometry is taken as the laser's own"
        warn(f"{text} (give the mounting with --extrinsic x,y,yaw)")
    odom_T_base = without_resets(odom_T_base, track.topic, warn)
    return Odometry(track.topic, track.source, odom_T_base, odom_T_base.compose(base_T_laser or Pose()))


def _imu(log: Log, survey: Survey, odom: str, warn: Callable[[str], None]) -> Imu | None:
    """Return the inertial sensor of a log, seen at mid-sweep; None without one."""
    half_sweep_ns = round(0.5 * log.sensor.sweep_s / NS)
    imu = survey.motion.imus.choose(odom, log.stamp_source, half_sweep_ns, warn)
    if imu and not _share_time(imu.rotation.stamps_ns, log):
        warn(f"{imu.topic}: inertial sensor and scans share no time; it is not used, check its clock")
        return None
    return imu


def _share_time(stamps_ns: NDArray[np.int64], log: Log) -> bool:
    """Return whether some time between the first stamp and the last is one of the log's scans."""
    return len(stamps_ns) > 0 and bool(stamps_ns[0] <= log.last_ns and stamps_ns[-1] >= log.first_ns)
