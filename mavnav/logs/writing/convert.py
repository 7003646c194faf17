"""Conversion of a log, damaged or not, to an indexed MCAP file; ROS 1 messages of types known to ROS 2 become CDR."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from msgspec import Struct, field

from mavnav.atomic_files import beside
from mavnav.errors import NoScansError, OutputError, UsageError
from mavnav.logs.formats import detect
from mavnav.logs.formats.decompress import DecompressError, unpack_message
from mavnav.logs.messages import ros
from mavnav.logs.messages.carmen import ENCODING
from mavnav.logs.messages.decode import decoder
from mavnav.logs.messages.definitions import TF, TF_ROS1
from mavnav.logs.messages.records import DecodeError
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel, Damage, RawMessage, Schema, Topic
from mavnav.logs.survey import check_file, unreadable
from mavnav.logs.writing.carmen_as_ros import carmen_to_cdr
from mavnav.logs.writing.mcap_writer import CHUNK_BYTES, qos_text
from mavnav.logs.writing.mcap_writer import Channel as Written

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    _Translation = tuple[Channel, Callable[[bytes], bytes], Callable[[bytes], Any]]

_MAX_STAMP_NS = (1 << 63) - 1
_ROS1_ONLY = {TF_ROS1: TF}


class Conversion(Struct, frozen=True):
    """Result of a conversion: written topics, numbers of left-out messages by reason, and damage of the source."""

    topics: tuple[Topic, ...]
    left_out: dict[str, int]
    damage: tuple[Damage, ...]
    warnings: tuple[str, ...]

    @property
    def messages(self) -> int:
        """Number of messages written."""
        return sum(topic.count for topic in self.topics)


def convert_log(
    source: Path,
    target: Path,
    *,
    strict: bool = False,
    force: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Conversion:
    """Write a log as MCAP; the new file is read back and compared before it is renamed to ``target``.

    Messages of a known type that do not decode are left out, and with ``strict`` also suspect messages, such as those
    of a chunk whose checksum does not match. Messages of unknown types are copied unchanged.

    Raises
    ------
    UsageError
        The log does not exist or cannot be opened, or the target does not end in ``.mcap`` or is the log itself.
    NoScansError
        No message of the log can be read.
    OutputError
        The target exists and ``force`` is false, or it cannot be written.
    """
    _check(source, target, force=force)
    report = ReadReport()
    try:
        with beside(target, exclusive=not force) as partial:
            writing = _Writing(strict, report)
            _write(source, partial, writing, progress)
            topics = writing.topics()
            if not topics:
                raise NoScansError(f"{source}: {_nothing_read(writing)}")
            _compare(partial, target, topics)
    except FileExistsError as error:
        raise OutputError(f"{target} exists; choose another name, or --force to replace it") from error
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(f"{target} cannot be written: {reason}; make room or choose another place") from error
    return Conversion(topics, dict(sorted(writing.left_out.items())), report.damages(), tuple(report.warnings))


def _check(source: Path, target: Path, *, force: bool) -> None:
    check_file(source)
    if target.suffix != ".mcap":
        raise UsageError(f"{target}: a log is written as MCAP; let the name end in .mcap")
    if source.resolve() in target.resolve().parents:
        raise UsageError(f"{target} is in the folder of the log; choose another place for the output")
    if target.exists() and target.samefile(source):
        raise UsageError(f"{target} is the log itself; choose another name for the output")
    if target.exists() and not target.is_file():
        raise UsageError(f"{target} is not a file; choose another name for the output")
    if target.exists() and not force:
        raise OutputError(f"{target} exists; choose another name, or --force to replace it")


def _nothing_read(writing: _Writing) -> str:
    """Return why a log of a known format gives no message."""
    if damages := writing.report.damages():
        return f"no message can be read; {damages[0].what} ({damages[0].where})"
    return "the log holds no messages; nothing to convert"


class _Writing(Struct):
    """State of a conversion: for every channel of the source its number in the target and its translation."""

    strict: bool
    report: ReadReport
    left_out: Counter[str] = field(default_factory=Counter)
    counts: Counter[Channel] = field(default_factory=Counter)
    numbers: dict[Channel, int] = field(default_factory=dict)
    schemas: dict[Schema, int] = field(default_factory=dict)
    translations: dict[Channel, _Translation] = field(default_factory=dict)

    def put(self, writer: Any, message: RawMessage) -> None:  # noqa: ANN401  (mcap is untyped here)
        """Write a message, or count it as left out."""
        if self.strict and message.suspect:
            self.left_out["suspect"] += 1
            return
        try:
            data = unpack_message(message.data)
            if message.channel not in self.translations:
                self.translations[message.channel] = _translation(message.channel, data)
            channel, translate, check = self.translations[message.channel]
            check(data)
            data = translate(data)
        except (DecodeError, DecompressError) as error:
            self.left_out["undecodable"] += 1
            self.report.damage(f"a message does not decode ({error})", f"{message.channel.topic}, {message.log_ns} ns")
            return
        number = self.numbers.get(channel)
        if number is None:
            number = self.numbers[channel] = self._register(writer, channel)
        log_ns = min(max(message.log_ns, 0), _MAX_STAMP_NS)
        writer.add_message(number, log_ns, data, log_ns)
        self.counts[channel] += 1

    def _register(self, writer: Any, channel: Channel) -> int:  # noqa: ANN401
        schema = channel.schema
        if schema.name and schema not in self.schemas:
            self.schemas[schema] = writer.register_schema(schema.name, schema.encoding, schema.data)
        qos = {"offered_qos_profiles": qos_text(Written(channel.type, latched=channel.topic.endswith("tf_static")))}
        metadata = qos if channel.encoding == "cdr" else {}
        return int(writer.register_channel(channel.topic, channel.encoding, self.schemas.get(schema, 0), metadata))

    def topics(self) -> tuple[Topic, ...]:
        """Return the written topics with their numbers of messages."""
        return tuple(
            Topic(c.topic, c.type, c.encoding, n)
            for c, n in sorted(self.counts.items(), key=lambda item: (item[0].topic, item[0].type))
        )


def _write(source: Path, partial: Path, writing: _Writing, progress: Callable[[int, int], None] | None) -> None:
    from mcap.writer import CompressionType, Writer  # noqa: PLC0415

    from mavnav import __version__  # noqa: PLC0415

    report = writing.report
    with partial.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library=f"mavnav {__version__}")
        for message in _read(source, report):
            writing.put(writer, message)
            if progress:
                progress(min(report.done_bytes, report.total_bytes), report.total_bytes)
        writer.finish()


def _read(source: Path, report: ReadReport) -> Iterator[RawMessage]:
    """Yield the messages of the source; an OSError here is reported as one of the source, not of the target."""
    try:
        if detect.sniff(source) == detect.UNKNOWN:
            raise NoScansError(f"{source}: {detect.refusal(source)}")
        yield from detect.read(source, report)
    except OSError as error:
        raise unreadable(source, error) from error


def _translation(channel: Channel, data: bytes) -> _Translation:
    """Return the channel to write, the function that translates its messages, and one that raises DecodeError."""
    check = decoder(channel) or _nothing
    name = _ROS1_ONLY.get(channel.type, channel.type)
    if channel.encoding == "ros1" and _is_translatable(name, data):
        return _ros2(channel.topic, name), lambda message: _to_cdr(message, name), check
    if channel.encoding == ENCODING:
        return _ros2(channel.topic, channel.type), carmen_to_cdr(channel), check
    if channel.encoding == "cdr" and not channel.schema.data and name in ros.types_ros2().types:
        return _ros2(channel.topic, name), _identity, check
    return channel, _identity, check


def _ros2(topic: str, name: str) -> Channel:
    return Channel(topic, name, "cdr", Schema(name, "ros2msg", ros.definition(name).encode()))


def _is_translatable(name: str, data: bytes) -> bool:
    if name not in ros.types_ros2().types:
        return False
    try:
        _to_cdr(data, name)
    except DecodeError:
        return False
    return True


def _to_cdr(data: bytes, name: str) -> bytes:
    from rosbags.serde import SerdeError  # noqa: PLC0415

    try:
        return bytes(ros.types_ros2().ros1_to_cdr(data, name))
    except (SerdeError, ValueError, IndexError, AssertionError) as error:
        raise DecodeError(str(error)) from error


def _identity(data: bytes) -> bytes:
    return data


def _nothing(_data: bytes) -> None:
    return None


def _compare(partial: Path, target: Path, topics: tuple[Topic, ...]) -> None:
    """Compare the new file, its messages and its index, with what was written; raises OutputError if they differ."""
    from mcap.reader import make_reader  # noqa: PLC0415

    report, counts = ReadReport(), Counter[str]()
    for message in detect.read(partial, report):
        counts[message.channel.topic] += 1
    expected = _by_name(topics)
    with partial.open("rb") as file:
        summary = make_reader(file).get_summary()
    indexed = summary.statistics.message_count if summary and summary.statistics else -1
    if counts != expected or report.damages() or indexed != sum(expected.values()):
        raise OutputError(f"{target}: what was written reads back differently; is the disk sound? Try another place")


def _by_name(topics: tuple[Topic, ...]) -> Mapping[str, int]:
    counts = Counter[str]()
    for topic in topics:
        counts[topic.name] += topic.count
    return counts
