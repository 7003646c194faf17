"""A log that can be used: one scan topic, its time, its mounting and odometry, and its scans as often as needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Final, Literal

import numpy as np
from msgspec import field
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.logs.derived_scans import Mounted, RecordedAttitude, virtual_scans
from mavnav.logs.false_returns import without_beams, without_value
from mavnav.logs.formats import detect
from mavnav.logs.messages.decode import decoder, scan_topic
from mavnav.logs.messages.definitions import DecodeError, LaserMessage
from mavnav.logs.preprocessing import ScanFilter
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel, Gap, Imu, LogContents, Odometry, RecordedTruth, ScanCounts, topic_and_frame
from mavnav.logs.segments import Recorded, SweepJoiners
from mavnav.logs.stamps import Clock, StampSource
from mavnav.logs.topic_scans import KEPT_BYTES
from mavnav.pose import Pose, Trajectory, correct_path
from mavnav.profiling import Stage, each
from mavnav.scan import LONGEST_SWEEP, LaserSpec, Line, Scan, scan_before
from mavnav.units import NS

_MOST_WAITING: Final = 64
_WAITING_BYTES: Final = 64 << 20


class Log(LogContents, frozen=True, eq=False, kw_only=True):
    """One scan topic of a log. Iterate it for its scans, as often as needed.

    Attributes
    ----------
    path
        The file, or the folder of a ROS 2 bag.
    format
        Name of the container, such as ``mcap``.
    size_bytes
        Size of all files of the log, in bytes.
    sha256
        Digest of their content, in hexadecimal digits.
    topics
        All topics of the log, with the number of messages read.
    damage
        What of the log could not be read, or is suspect, and where.
    warnings
        What is odd about the log, a line each.
    window_s
        Start and end of the window in s from the first usable scan; None where it is open.
    strict
        Whether scans from where a checksum does not match are left out.
    more
        Files that are the further parts of the bag.
    topic
        The scan topic.
    frame_id
        Frame of the laser in the first usable scan.
    sensor
        Geometry of the first usable scan as recorded, angles in rad, ranges in m, times in s.
    counts
        Numbers of scans: in the log, usable, and skipped by reason.
    cleaning
        Number of beams of the usable scans by kind: valid, zero, nan and others.
    first_ns
        Stamp of the first usable scan, in ns.
    last_ns
        Stamp of the last usable scan, in ns.
    start_s
        Time from the first usable scan of the log, before the window too, to the first in it, in s.
    period_s
        Median time between usable scans, in s.
    gaps
        Pauses much longer than the period: start in ns, duration in s.
    stamp_source
        ``header``, or ``log`` if the stamps of the scans are unusable and the times of recording are taken.
    clock
        The stamps of the scans beside their times of recording; None where these are used.
    base_T_laser
        Pose of the laser on its base, projected to the plane, m, m, rad; None if it is unknown.
    mounting_source
        Where that pose comes from; None if it is unknown.
    base_frame
        Name of the frame of the base, if there is one.
    upside_down
        Whether the laser is mounted upside down; the beams of `scans` are turned over then.
    none_m
        Range in m that stands for no return, and is left out of `scans`; None if none does.
    floor_m
        Nearest point of a line, m, laser frame, from which on returns are left out of `scans`; None if none are.
    own_beams
        Which beams (n,) see the robot itself, and are left out of `scans`; None if none do.
    odometry
        Poses of base and laser in the odometry frame: stamps in ns, m, m, rad.
    imu
        Rotation of the laser, as an inertial sensor measured it.
    attitude
        Roll and pitch in rad and height in m of the laser, by which `scans` are levelled.
    truth
        Recorded poses of the laser in a fixed frame: stamps in ns, m, m, rad.
    stamps_ns
        Stamps (n,) of the usable scans, in ns.
    """

    topic: str
    frame_id: str
    sensor: LaserSpec
    counts: ScanCounts
    cleaning: dict[str, int]
    first_ns: int
    last_ns: int
    start_s: float = 0.0
    period_s: float
    gaps: tuple[Gap, ...]
    stamp_source: StampSource
    clock: Clock | None = None
    base_T_laser: Pose | None = None
    mounting_source: Literal["tf_static", "option"] | None = None
    base_frame: str | None = None
    upside_down: bool = False
    none_m: float | None = None
    floor_m: Line | None = None
    own_beams: NDArray[np.bool_] | None = None
    odometry: Odometry | None = None
    imu: Imu | None = None
    attitude: RecordedAttitude | None = None
    truth: RecordedTruth | None = None
    _order: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    _ranges: list[tuple[LaserSpec, NDArray[np.float64]]] | None = None
    _merged: tuple[Log, ...] = ()
    _kept: list[Scan] = field(default_factory=list)

    @property
    def mid_sweep_s(self) -> float:
        """Time from the stamp of a scan to the middle of its sweep, where its pose holds; 0 if it cannot be right."""
        sweep_s = self.sensor.sweep_s
        return 0.5 * sweep_s if sweep_s <= LONGEST_SWEEP * self.period_s else 0.0

    @property
    def odom_T_laser(self) -> Trajectory | None:
        """Odometry of the laser, with the stamp of a scan at the middle of its sweep; None without odometry."""
        return correct_path(self.odometry.odom_T_laser, -round(self.mid_sweep_s / NS)) if self.odometry else None

    @property
    def duration_s(self) -> float:
        """Time from the first usable scan to the last, in s."""
        return (self.last_ns - self.first_ns) * NS

    @property
    def mounting(self) -> Mounted:
        """The laser as it is merged with others."""
        spec = self.sensor.turned_over() if self.upside_down else self.sensor
        return Mounted(spec, self.base_T_laser or Pose(), self.stamps_ns)

    def shares_time(self, stamps_ns: NDArray[np.int64]) -> bool:
        """Return whether some time between the first stamp and the last, (n,), is one of the scans."""
        return len(stamps_ns) > 0 and bool(stamps_ns[0] <= self.last_ns and stamps_ns[-1] >= self.first_ns)

    def __iter__(self) -> Iterator[Scan]:
        """Read the usable scans, as `scans` does."""
        return self.scans()

    def __repr__(self) -> str:
        """Return what the log is, in a line."""
        return f"Log({str(self.path)!r}, topic={self.topic!r}, scans={len(self)}, duration_s={self.duration_s:.1f})"

    def __len__(self) -> int:
        """Count the usable scans."""
        return self.counts.usable

    def scans(self) -> Iterator[Scan]:
        """Read the usable scans again from the file: cleaned, stamps strictly ascending, in bounded memory.

        They are levelled by the attitude, if there is one.
        """
        if 8 * self.sensor.beams * len(self._order) > KEPT_BYTES:
            return each("reading", self._prepared_scans())
        if not self._kept:
            with Stage("reading"):
                self._kept.extend(self._prepared_scans())
        return iter(self._kept)

    def as_recorded(self) -> Log:
        """Return the log with scans that are not levelled."""
        return replace(self, attitude=None, _kept=[])

    def without_floor(self, floor_m: Line) -> Log:
        """Return the log without returns at a line and past it (`scan_before`)."""
        return replace(self, floor_m=floor_m, _kept=[])

    def _prepared_scans(self) -> Iterator[Scan]:
        scans = self._scans() if self.attitude is None else map(self.attitude.level, self._scans())
        return scans if self.floor_m is None else map(partial(scan_before, line_m=self.floor_m), scans)

    def _scans(self) -> Iterator[Scan]:
        """Read the usable scans again from the file, as ``scans`` gives them.

        Scans that come early in the file wait for their turn. Only so many may wait; where more would have to, the file
        is read again.
        """
        if self._merged:
            yield from virtual_scans([log.mounting for log in self._merged], [*map(iter, self._merged)], self.sensor)
            return
        ranks = np.full(int(self._order.max()) + 1, -1)
        ranks[self._order] = np.arange(len(self._order))
        most = max(_MOST_WAITING, _WAITING_BYTES // (8 * self.sensor.beams))
        due, before = 0, -1
        while before < due < len(self._order):
            before = due
            waiting: dict[int, Scan] = {}
            for number, (spec, ranges_m) in enumerate(self._admitted_scans()):
                rank = int(ranks[number]) if number < len(ranks) else -1
                if due <= rank < due + most:
                    waiting[rank] = Scan(int(self.stamps_ns[rank]), ranges_m, spec)
                while due in waiting:
                    yield waiting.pop(due)
                    due += 1

    def _admitted_scans(self) -> Iterator[tuple[LaserSpec, NDArray[np.float64]]]:
        """Return the scans that the filter admits, in the order of the file, as seen from above."""
        admitted = self._reread() if self._ranges is None else iter(self._ranges)
        if self.none_m is not None:
            admitted = ((spec, without_value(ranges_m, self.none_m)) for spec, ranges_m in admitted)
        if (own := self.own_beams) is not None:
            admitted = ((spec, without_beams(ranges_m, own)) for spec, ranges_m in admitted)
        return ((spec.turned_over(), ranges_m) for spec, ranges_m in admitted) if self.upside_down else admitted

    def _reread(self) -> Iterator[tuple[LaserSpec, NDArray[np.float64]]]:
        report = ReadReport()  # the survey reported everything already
        scan_filter = ScanFilter(self.topic, report.warn)
        for scan in self._messages(report):
            admitted = scan_filter.admit(scan)
            if not isinstance(admitted, str):
                yield admitted[:2]

    def _messages(self, report: ReadReport) -> Iterator[LaserMessage]:
        """Yield the scan messages of the topic and the frame again, segments joined as the survey did."""
        topic, frame = topic_and_frame(self.topic)
        joiners: dict[Channel, SweepJoiners] = {}
        decoders: dict[Channel, Callable[[bytes], LaserMessage] | None] = {}
        for message in detect.read(self.path, report, self.more):
            channel = message.channel
            if scan_topic(channel, self.topic) is None or (self.strict and message.suspect):
                continue
            try:
                if channel not in decoders:
                    decoders[channel], joiners[channel] = None, SweepJoiners(topic, report.warn)
                    decoders[channel] = decoder(channel, topic=topic)
                decode = decoders[channel]
                scan = decode(message.data) if decode else None
            except DecodeError:
                continue
            if scan and frame in {None, scan.frame_id}:
                yield from (sweep.message for sweep in joiners[channel].push(Recorded(scan, message.log_ns)))
        for waiting in joiners.values():
            yield from (sweep.message for sweep in waiting.finish())
