"""MCAP files hold what was put into them, as the library of the format reads it."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from mavnav.logs.messages import definitions, ros
from mavnav.logs.writing.mcap_stream import McapStream
from mavnav.logs.writing.mcap_writer import CHUNK_BYTES, Channel, write_serialized

CHANNELS = {
    "/tf_static": Channel(definitions.TF, latched=True),
    "/tf": Channel(definitions.TF),
    "/scan": Channel(definitions.SCAN),
}


@pytest.mark.parametrize("count", [0, 1, 2, 300])
def test_messages_come_back_in_chunks(tmp_path, count) -> None:
    rng = np.random.default_rng(5)
    messages = [
        (
            ("/tf", "/scan")[k % 2],
            10**18 + int(rng.integers(10**9)),
            rng.integers(0, 9, 2000).astype(np.uint8).tobytes(),
        )
        for k in range(count)
    ]
    with write_serialized(tmp_path / "a.mcap", CHANNELS) as put:
        for message in messages:
            put(*message)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        assert [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()] == sorted(
            messages, key=lambda m: m[1]
        )
        assert len(reader.get_summary().chunk_indexes) == -(-count * 2031 // (CHUNK_BYTES + 2031))


def test_channels_tell_their_type_and_whether_the_last_message_is_kept(tmp_path) -> None:
    with write_serialized(tmp_path / "a.mcap", CHANNELS) as put:
        put("/tf", 1, b"")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert {s.data.decode() for s in summary.schemas.values()} == {
        ros.definition(name) for name in (definitions.TF, definitions.SCAN)
    }
    for channel in summary.channels.values():
        wanted = CHANNELS[channel.topic]
        assert (summary.schemas[channel.schema_id].name, channel.message_encoding) == (wanted.type, "cdr")
        qos = channel.metadata["offered_qos_profiles"]
        assert ("transient_local" in qos, "depth: 1\n" in qos) == (wanted.latched, wanted.latched)


@pytest.mark.parametrize("count", [0, 1, 40])
def test_bytes_are_those_of_the_library(count) -> None:
    theirs, ours, about = BytesIO(), BytesIO(), {"a": "b", "\u00fc": "\u00e9"}
    library, stream = Writer(theirs, chunk_size=1000), McapStream(ours, "ros2", "test", 1000)
    library.start("ros2", "test")
    for name in ("one", "two"):
        assert library.register_schema(name, "ros2msg", b"int8 x") == stream.schema(name, "ros2msg", b"int8 x")
        assert library.register_channel(f"/{name}", "cdr", 1, about) == stream.channel(f"/{name}", "cdr", 1, about)
        library.add_metadata(name, about)
        stream.metadata(name, about)
        library.add_attachment(7, 7, name, "text/plain", b"content")
        stream.attachment(7, name, "text/plain", b"content")
    for k in range(count):
        library.add_message(k % 2 + 1, 100 - k, bytes(90), 100 - k)
        stream.message(k % 2 + 1, 100 - k, bytes(90))
    library.finish()
    stream.finish()
    assert ours.getvalue() == theirs.getvalue()
