"""Writer of MCAP: messages in chunks compressed with zstd, each with its index, and the summary at the end.

The output does not depend on the clock: equal messages give equal bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from string import Template
from typing import Any, Final

from msgspec import Struct

from mavnav.logs.messages.definitions import definition
from mavnav.logs.records import AttachedFile, MetadataRecord
from mavnav.version import __version__

CHUNK_BYTES: Final = 128 * 1024
"""Size of a chunk before compression, in bytes, about 4 s of scans; a cut file loses no chunk before the cut."""

_LATEST_NS: Final = (1 << 63) - 1
_QOS: Final = Template(Path(__file__).with_name("qos.yaml").read_text("ascii"))


class OutputChannel(Struct, frozen=True):
    """The type of a topic's messages, and whether a late subscriber gets the last one (latched, transient local)."""

    type: str
    latched: bool = False


def qos_text(channel: OutputChannel) -> str:
    """Return the quality of service of a channel in the format of rosbag2's metadata."""
    depth, durability = (1, "transient_local") if channel.latched else (10, "volatile")
    return _QOS.substitute(depth=depth, durability=durability)


def writable_stamp(time_ns: int) -> int:
    """Return a time within the range that readers accept."""
    return min(max(time_ns, 0), _LATEST_NS)


def write_extra(writer: Any, extra: AttachedFile | MetadataRecord) -> None:  # noqa: ANN401  mcap is untyped here
    """Write an attached file, or a record of texts by name."""
    if isinstance(extra, MetadataRecord):
        writer.add_metadata(extra.name, extra.values)
    else:
        created_ns, log_ns = writable_stamp(extra.created_ns), writable_stamp(extra.log_ns)
        writer.add_attachment(created_ns, log_ns, extra.name, extra.media_type, extra.data)


@contextmanager
def write_serialized(
    path: Path,
    channels: Mapping[str, OutputChannel],
    chunk_bytes: int = CHUNK_BYTES,
    extras: Iterable[AttachedFile | MetadataRecord] = (),
) -> Iterator[Callable[[str, int, bytes], None]]:
    """Write an MCAP file of ROS 2 messages with their definitions; yields ``put(topic, stamp_ns, message)``.

    Messages are bytes in CDR; ``stamp_ns`` is their time of recording. A chunk is closed when it holds ``chunk_bytes``
    or more. The extras are written first.
    """
    from mcap.writer import Writer  # noqa: PLC0415  only writers need it

    with path.open("wb") as file:
        writer = Writer(file, chunk_bytes)
        writer.start("ros2", f"mavnav {__version__}")
        kinds = dict.fromkeys(channel.type for channel in channels.values())
        schemas = {kind: writer.register_schema(kind, "ros2msg", definition(kind).encode()) for kind in kinds}
        numbers = {
            topic: writer.register_channel(topic, "cdr", schemas[c.type], {"offered_qos_profiles": qos_text(c)})
            for topic, c in channels.items()
        }
        for extra in extras:
            write_extra(writer, extra)

        def put(topic: str, stamp_ns: int, message: bytes) -> None:
            writer.add_message(numbers[topic], stamp_ns, message, stamp_ns)

        yield put
        writer.finish()
