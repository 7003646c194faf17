"""Conversion of a log, damaged or not, to an indexed MCAP file; ROS 1 messages of types known to ROS 2 become CDR."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from msgspec import Struct, field

from mavnav.atomic_files import check_name, replacing
from mavnav.errors import NoScansError, OutputError, UsageError
from mavnav.logs.content import check_file, reading
from mavnav.logs.formats import detect
from mavnav.logs.formats.decompress import DecompressError, unpack_message
from mavnav.logs.messages.definitions import DecodeError
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import LATCHING, QOS, AttachedFile, Channel, Damage, MetadataRecord, RawMessage, Schema, Topic
from mavnav.logs.writing.mcap_writer import CHUNK_BYTES, OutputChannel, qos_text, writable_stamp, write_extra
from mavnav.logs.writing.translation import Translator


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
    added: Iterable[RawMessage] = (),
) -> Conversion:
    """Write a log as MCAP, with ``added`` messages, which are in the order of recording.

    The new file is read back and compared before it is renamed to ``target``. Messages of a known type that do not
    decode are left out, and with ``strict`` also suspect messages, such as those of a chunk whose checksum does not
    match. Messages of unknown types are copied unchanged, and so are the quality of service of topics, times of
    publishing, attachments and metadata records.

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
    with replacing(target, force=force, another="another name", room="another place") as unfinished:
        writing = _Writing(strict, report, Translator(report))
        writing.write(source, unfinished, progress, added)
        topics = writing.topics()
        if not topics:
            raise NoScansError(f"{source}: {_nothing_read(writing)}")
        _compare(unfinished, target, topics)
    for encoding in sorted({topic.encoding for topic in topics} - {"cdr"}):
        copied = [topic.name for topic in topics if topic.encoding == encoding]
        names = ", ".join(copied[:3]) + (f" and {len(copied) - 3} more" if len(copied) > 3 else "")
        report.warn(f"{names}: copied as they are ({encoding}), no messages of ROS 2; 'ros2 bag' refuses the file")
    return Conversion(topics, dict(sorted(writing.left_out.items())), report.damages(), tuple(report.warnings))


def _check(source: Path, target: Path, *, force: bool) -> None:
    check_file(source)
    if target.suffix != ".mcap":
        raise UsageError(f"{target}: a log is written as MCAP; let the name end in .mcap")
    check_name(target)
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
    """State of a conversion: for every channel of the target its number there, and what was written and left out."""

    strict: bool
    report: ReadReport
    translator: Translator
    left_out: Counter[str] = field(default_factory=Counter)
    counts: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    numbers: dict[Channel, int] = field(default_factory=dict)
    schemas: dict[Schema, int] = field(default_factory=dict)

    def write(
        self, source: Path, target: Path, progress: Callable[[int, int], None] | None, added: Iterable[RawMessage]
    ) -> None:
        """Write the messages of a log and the added ones, in the order of recording."""
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415

        from mavnav.version import __version__  # noqa: PLC0415

        report = self.report
        with target.open("wb") as file:
            writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
            writer.start(profile="ros2", library=f"mavnav {__version__}")
            report.take_extra = partial(self.put_extra, writer)
            waiting = deque(added)
            for message in _read(source, report):
                while waiting and waiting[0].log_ns < message.log_ns:
                    self.put(writer, waiting.popleft(), added=True)
                self.put(writer, message)
                if progress:
                    progress(min(report.done_bytes, report.total_bytes), report.total_bytes)
            for message in waiting:
                self.put(writer, message, added=True)
            writer.finish()

    def put(self, writer: Any, message: RawMessage, *, added: bool = False) -> None:  # noqa: ANN401  (mcap is untyped here)
        """Write a message, or count it as left out; an ``added`` one to a channel of its topic and type, if any."""
        if self.strict and message.suspect:
            self.left_out["suspect"] += 1
            return
        try:
            channel, data = self.translator.translate(message.channel, unpack_message(message.data))
        except (DecodeError, DecompressError) as error:
            self.left_out["undecodable"] += 1
            self.report.damage(f"a message does not decode ({error})", f"{message.channel.topic}, {message.log_ns} ns")
            return
        number = self.numbers.get(channel)
        if number is None:
            alike = (n for known, n in self.numbers.items() if added and _kind(known) == _kind(channel))
            number = self.numbers[channel] = next(alike, None) or self._register(writer, channel)
        sent_ns = message.log_ns if message.publish_ns is None else message.publish_ns
        writer.add_message(number, writable_stamp(message.log_ns), data, writable_stamp(sent_ns))
        self.counts[_kind(channel)] += 1

    def put_extra(self, writer: Any, extra: AttachedFile | MetadataRecord | str) -> None:  # noqa: ANN401
        """Write what an MCAP holds besides messages, or count it as left out."""
        if isinstance(extra, str):
            self.left_out["extras"] += 1
            self.report.warn(f"{extra}; it is left out")
        else:
            write_extra(writer, extra)

    def _register(self, writer: Any, channel: Channel) -> int:  # noqa: ANN401
        schema = channel.schema
        if schema.name and schema not in self.schemas:
            self.schemas[schema] = writer.register_schema(schema.name, schema.encoding, schema.data)
        metadata = dict(channel.metadata)
        if channel.encoding == "cdr":
            latched = metadata.pop(LATCHING, "") in ("1", "true") or channel.topic.endswith("tf_static")
            metadata.setdefault(QOS, qos_text(OutputChannel(channel.type, latched=latched)))
        return int(writer.register_channel(channel.topic, channel.encoding, self.schemas.get(schema, 0), metadata))

    def topics(self) -> tuple[Topic, ...]:
        """Return the written topics with their numbers of messages."""
        return tuple(Topic(*key, n) for key, n in sorted(self.counts.items()))


def _kind(channel: Channel) -> tuple[str, str, str]:
    return channel.topic, channel.type, channel.encoding


def _read(source: Path, report: ReadReport) -> Iterator[RawMessage]:
    """Yield the messages of the source; an OSError here is reported as one of the source, not of the target."""
    with reading(source):
        if detect.sniff(source) == detect.UNKNOWN:
            raise NoScansError(f"{source}: {detect.refusal(source)}")
        yield from detect.read(source, report)


def _compare(unfinished: Path, target: Path, topics: tuple[Topic, ...]) -> None:
    """Compare the new file, its messages and its index, with what was written; raises OutputError if they differ."""
    from mcap.reader import make_reader  # noqa: PLC0415

    report, counts = ReadReport(), Counter[str]()
    for message in detect.read(unfinished, report):
        counts[message.channel.topic] += 1
    expected = Counter[str]()
    for topic in topics:
        expected[topic.name] += topic.count
    with unfinished.open("rb") as file:
        summary = make_reader(file).get_summary()
    indexed = summary.statistics.message_count if summary and summary.statistics else -1
    if counts != expected or report.damages() or indexed != sum(expected.values()):
        raise OutputError(f"{target}: what was written reads back differently; is the disk sound? Try another place")
