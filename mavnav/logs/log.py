"""A log that can be used: one scan topic, its time, its mounting and odometry, and its scans as often as needed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from mavnav.errors import NoScansError, TopicError
from mavnav.logs.formats import detect
from mavnav.logs.merging import FRAME, Mounted, merged_scans, partners, virtual_laser
from mavnav.logs.messages.decode import decoder, scan_topic, scan_topics
from mavnav.logs.messages.records import DecodeError
from mavnav.logs.odometry import jump
from mavnav.logs.preprocessing import KINDS, ScanFilter
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Damage, Gap, Imu, Odometry, RecordedTruth, ScanCounts, Topic
from mavnav.logs.stamps import KEPT_BYTES, StampSource, period_and_gaps
from mavnav.logs.survey import Survey, survey
from mavnav.logs.topic_choice import chosen_topic, no_usable
from mavnav.logs.transforms import BASE_FRAMES, mounting
from mavnav.logs.truth import laser_truth
from mavnav.memory import trim
from mavnav.pose import Pose
from mavnav.profiling import Stage, each
from mavnav.scan import LaserSpec, Scan
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.logs.messages.records import LaserMessage

_MOST_WAITING: Final = 64
_WAITING_BYTES: Final = 64 << 20


@dataclass(frozen=True)
class Log:
    """One scan topic of a log.

    ``sensor`` and ``frame_id`` are those of the first usable scan, as recorded; the beams of a laser that is mounted
    ``upside_down`` are turned over in ``scans``. ``cleaning`` counts the beams of the usable scans
    by kind (``preprocessing.KINDS``). ``period_s`` is the median; ``stamp_source`` is ``log`` where the scans' stamps
    are unusable. ``base_T_laser`` is projected to the plane.
    """

    path: Path
    format: str
    size_bytes: int
    sha256: str
    topics: tuple[Topic, ...]
    topic: str
    frame_id: str
    sensor: LaserSpec
    counts: ScanCounts
    cleaning: dict[str, int]
    first_ns: int
    last_ns: int
    period_s: float
    gaps: tuple[Gap, ...]
    stamp_source: StampSource
    window_s: tuple[float | None, float | None]
    base_T_laser: Pose | None
    mounting_source: Literal["tf_static", "option"] | None
    base_frame: str | None
    upside_down: bool
    odometry: Odometry | None
    imu: Imu | None
    truth: RecordedTruth | None
    damage: tuple[Damage, ...]
    warnings: tuple[str, ...]
    strict: bool
    _order: NDArray[np.int64] = field(repr=False, compare=False)
    _stamps_ns: NDArray[np.int64] = field(repr=False, compare=False)
    _ranges: list[tuple[LaserSpec, NDArray[np.float64]]] | None = field(default=None, repr=False, compare=False)
    _merged: tuple[Log, ...] = field(default=(), repr=False, compare=False)
    _kept: list[Scan] = field(default_factory=list, repr=False, compare=False)

    @property
    def duration_s(self) -> float:
        """Time from the first usable scan to the last."""
        return (self.last_ns - self.first_ns) * NS

    @property
    def mounted(self) -> Mounted:
        """The laser as it is merged with others."""
        spec = self.sensor.turned_over() if self.upside_down else self.sensor
        return Mounted(spec, self.base_T_laser or Pose(), self._stamps_ns)

    @property
    def is_short(self) -> bool:
        """Whether the scans are read at once, and kept."""
        return 8 * self.sensor.beams * len(self._order) <= KEPT_BYTES

    def __iter__(self) -> Iterator[Scan]:
        """Read the usable scans, as `scans` does."""
        return self.scans()

    def __len__(self) -> int:
        """Count the usable scans."""
        return self.counts.usable

    def scans(self) -> Iterator[Scan]:
        """Read the usable scans again from the file: cleaned, stamps strictly ascending, in bounded memory."""
        if not self.is_short:
            return each("reading", self._scans())
        if not self._kept:
            with Stage("reading"):
                self._kept.extend(self._scans())
        return iter(self._kept)

    def _scans(self) -> Iterator[Scan]:
        """Read the usable scans again from the file, as ``scans`` gives them.

        Scans that come early in the file wait for their turn. Only so many may wait; where more would have to, the file
        is read again.
        """
        if self._merged:
            yield from merged_scans([log.mounted for log in self._merged], [*map(iter, self._merged)], self.sensor)
            return
        ranks = np.full(int(self._order.max()) + 1, -1)
        ranks[self._order] = np.arange(len(self._order))
        most = max(_MOST_WAITING, _WAITING_BYTES // (8 * self.sensor.beams))
        due, before = 0, -1
        while before < due < len(self._order):
            before = due
            waiting: dict[int, Scan] = {}
            for number, (spec, ranges_m) in enumerate(self._admitted()):
                rank = int(ranks[number]) if number < len(ranks) else -1
                if due <= rank < due + most:
                    waiting[rank] = Scan(int(self._stamps_ns[rank]), ranges_m, spec)
                while due in waiting:
                    yield waiting.pop(due)
                    due += 1

    def _admitted(self) -> Iterator[tuple[LaserSpec, NDArray[np.float64]]]:
        """Return the scans that the filter admits, in the order of the file, as seen from above."""
        admitted = self._reread() if self._ranges is None else iter(self._ranges)
        return ((spec.turned_over(), ranges_m) for spec, ranges_m in admitted) if self.upside_down else admitted

    def _reread(self) -> Iterator[tuple[LaserSpec, NDArray[np.float64]]]:
        report = ReadReport()  # the survey reported everything already
        scan_filter = ScanFilter(self.topic, report.warn)
        for message in _laser_messages(self.path, self.topic, report, strict=self.strict):
            admitted = scan_filter.admit(message)
            if not isinstance(admitted, str):
                spec, ranges_m, _ = admitted
                yield spec, ranges_m


def _laser_messages(path: Path, topic: str, report: ReadReport, *, strict: bool) -> Iterator[LaserMessage]:
    decoders: dict[object, Callable[[bytes], LaserMessage] | None] = {}
    for channel, _, data, suspect in detect.read(path, report):
        if scan_topic(channel, topic) is None or (strict and suspect):
            continue
        try:
            if channel not in decoders:
                decoders[channel] = None
                decoders[channel] = decoder(channel, topic=topic)
            decode = decoders[channel]
            if decode is not None:
                yield decode(data)
        except DecodeError:
            continue


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
    upside_down
        The laser is mounted upside down, whatever the log says.

    Raises
    ------
    UsageError
        No such file, or an empty window.
    TopicError
        Several scan topics to choose from, or no such topic; no ground truth, or several.
    NoScansError
        No log, or no usable scan in it.
    """
    window = partial(survey, path, start_s=start_s, end_s=end_s)
    found = window(topic=topic, progress=progress, strict=strict, truth=truth, odom=odom)
    log = choose(found, topic=topic, odom=odom, extrinsic=extrinsic, upside_down=upside_down)
    del found
    if not log.is_short:
        trim()
    return log


def choose(
    found: Survey,
    *,
    topic: str | None = None,
    odom: str = "auto",
    extrinsic: Pose | None = None,
    upside_down: bool = False,
) -> Log:
    """Choose topic, odometry and mounting of a surveyed log; raises TopicError and NoScansError.

    Several topics, joined by commas, are merged by their mountings.
    """
    if topic is not None and topic not in found.scans and len(names := scan_topics(topic)) > 1:
        return _merged_log(found, names, odom, extrinsic)
    name = chosen_topic(found, topic)
    scans = found.scans[name]
    if scans.doubt:
        raise NoScansError(f"{found.path}: {name}: {scans.doubt}")
    timeline = scans.timeline(found.window_s)
    if timeline.first is None:
        raise NoScansError(no_usable(found, name, scans, timeline))
    sensor, frame_id = timeline.first
    period_s, gaps = period_and_gaps(timeline.stamps_ns)
    skipped = dict(sorted((scans.refused + timeline.skipped).items()))
    log = Log(
        path=found.path,
        format=found.format,
        size_bytes=found.size_bytes,
        sha256=found.sha256,
        topics=found.topics,
        topic=name,
        frame_id=frame_id,
        sensor=sensor,
        counts=ScanCounts(scans.total, len(timeline.order), skipped, timeline.suspect),
        cleaning=dict(zip(KINDS, timeline.cleaning.tolist(), strict=True)),
        first_ns=int(timeline.stamps_ns[0]),
        last_ns=int(timeline.stamps_ns[-1]),
        period_s=period_s,
        gaps=gaps,
        stamp_source=timeline.source,
        window_s=found.window_s,
        base_T_laser=None,
        mounting_source=None,
        base_frame=None,
        upside_down=False,
        odometry=None,
        imu=None,
        truth=None,
        damage=found.damage,
        warnings=found.warnings,
        strict=found.strict,
        _order=timeline.order,
        _stamps_ns=timeline.stamps_ns,
        _ranges=scans.ranges,
    )
    return _with_motion(log, found, odom, extrinsic, upside_down=upside_down)


def _merged_log(found: Survey, topics: list[str], odom: str, extrinsic: Pose | None) -> Log:
    """Merge the scans of several lasers; raises TopicError where a mounting is not known."""
    if extrinsic is not None:
        raise TopicError("--extrinsic is the pose of one laser; several --topic are merged by /tf_static")
    logs = tuple(choose(found, topic=topic, odom=odom) for topic in topics)
    first, bases = logs[0], {log.base_frame for log in logs}
    unmounted = [log.topic for log in logs if log.base_T_laser is None]
    if unmounted or len(bases) > 1:
        of = unmounted[0] if unmounted else first.topic
        text = f"{found.path}: topics are merged by their mountings on one base, and that of {of} is not known"
        raise TopicError(f"{text}; record /tf_static, or choose one --topic")
    log = replace(
        first,
        topic=",".join(topics),
        frame_id=FRAME,
        sensor=virtual_laser([log.mounted for log in logs]),
        cleaning={kind: sum(log.cleaning[kind] for log in logs) for kind in first.cleaning},
        upside_down=False,
        warnings=(),
        _ranges=None,
        _merged=logs,
        _kept=[],
    )
    warnings = [*(text for log in logs for text in log.warnings), *_unpaired(logs)]
    log = _with_motion(log, found, odom, Pose())
    return replace(
        log, base_frame=first.base_frame, mounting_source="tf_static", warnings=tuple(dict.fromkeys(warnings))
    )


def _unpaired(lasers: Sequence[Log]) -> list[str]:
    """Return a line for every merged laser of which scans are left out, for none of the first is as near."""
    mounted = [log.mounted for log in lasers]
    used = [int((partners(mounted[0].stamps_ns, m.stamps_ns) >= 0).sum()) for m in mounted[1:]]
    return [
        f"{log.topic}: {len(log) - n} of {len(log)} scans are not merged: no scan of {lasers[0].topic} is near in time"
        for log, n in zip(lasers[1:], used, strict=True)
        if n < len(log)
    ]


def _with_motion(log: Log, found: Survey, odom: str, extrinsic: Pose | None, *, upside_down: bool = False) -> Log:
    """Add mounting and odometry, and what there is to warn about time."""
    warnings = list(log.warnings)
    if log.stamp_source == "log":
        warnings.append(f"{log.topic}: the scans' own stamps are unusable; the times of recording are used")
    for reason, count in log.counts.skipped.items():
        if reason != "outside_window":
            warnings.append(f"{log.topic}: {count} of {log.counts.total} scans skipped: {reason.replace('_', ' ')}")
    track = found.odometry.choose(odom, warnings.append)
    bases = [track.base_frame] if track and track.base_frame else list(BASE_FRAMES)
    mounted = mounting(found.frames, log.frame_id, bases, warnings.append)
    base_frame, base_T_laser, overhead = mounted or (bases[0] if track else None, None, False)
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
    odometry = None
    odom_T_base = track.trajectory(log.stamp_source) if track else None
    if track and odom_T_base and not _meet(odom_T_base.stamps_ns, log):
        warnings.append(f"{track.topic}: odometry and scans share no time; it is not used, check its clock")
    elif track and odom_T_base and (text := jump(odom_T_base)):
        warnings.append(f"{track.topic}: the odometry {text}; it is not used, check it or write --odom off")
    elif track and odom_T_base:
        if base_T_laser is None:
            text = f"no transform from {base_frame!r} to {log.frame_id!r}; the odometry is taken as the laser's own"
            warnings.append(f"{text} (give the mounting with --extrinsic x,y,yaw)")
        odometry = Odometry(track.topic, track.source, odom_T_base, odom_T_base.compose(base_T_laser or Pose()))
    known = found.truth.choose(found.topics)
    sources = (log.stamp_source, log.frame_id, found.frames, base_T_laser, extrinsic, warnings.append)
    return replace(
        log,
        truth=laser_truth(known, *sources) if known else None,
        base_T_laser=base_T_laser,
        mounting_source="option" if extrinsic else source,
        base_frame=base_frame,
        upside_down=upside_down or (overhead and extrinsic is None),
        odometry=odometry,
        imu=_imu(log, found, odom, warnings.append),
        warnings=tuple(warnings),
    )


def _imu(log: Log, found: Survey, odom: str, warn: Callable[[str], None]) -> Imu | None:
    """Return the inertial sensor of a log, seen at mid-sweep; None without one."""
    half_sweep_ns = round(0.5 * abs(log.sensor.time_increment_s) * log.sensor.beams / NS)
    imu = found.imus.choose(odom, log.stamp_source, half_sweep_ns, warn)
    if imu and not _meet(imu.rotation.stamps_ns, log):
        warn(f"{imu.topic}: inertial sensor and scans share no time; it is not used, check its clock")
        return None
    return imu


def _meet(stamps_ns: NDArray[np.int64], log: Log) -> bool:
    """Tell whether some time between the first stamp and the last is one of the log's scans."""
    return len(stamps_ns) > 0 and bool(stamps_ns[0] <= log.last_ns and stamps_ns[-1] >= log.first_ns)
