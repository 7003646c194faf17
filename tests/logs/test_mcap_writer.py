"""MCAP files hold what was put into them, as the library of the format reads it."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from mavnav import __version__
from mavnav.logs.messages import definitions, ros
from mavnav.logs.writing.mcap_writer import CHUNK_BYTES, Attachment, Channel, Extras, qos_text, write_serialized

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


@pytest.mark.parametrize("seed", range(6))
def test_the_bytes_equal_those_of_the_formats_library(tmp_path, seed) -> None:
    rng = np.random.default_rng(seed)
    messages = [
        (str(rng.choice(list(CHANNELS))), int(rng.integers(2**62)), rng.bytes(int(rng.integers(0, 900))))
        for _ in range(int(rng.integers(0, 300)) * (seed > 0))
    ]
    files = [Attachment(f"é{k}.txt", "text/plain", rng.bytes(int(rng.integers(0, 99)))) for k in range(seed % 3)]
    extras = Extras(int(rng.integers(2**62)), {f"name{k}": {"a": "ü", "b": ""} for k in range(seed % 2)}, tuple(files))
    with write_serialized(tmp_path / "a.mcap", CHANNELS, 4000, extras) as put:
        for message in messages:
            put(*message)
    with (tmp_path / "b.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=4000)
        writer.start("ros2", f"mavnav {__version__}")
        kinds = {kind: ros.definition(kind).encode() for kind in (definitions.TF, definitions.SCAN)}
        schemas = {kind: writer.register_schema(kind, "ros2msg", text) for kind, text in kinds.items()}
        numbers = {
            topic: writer.register_channel(topic, "cdr", schemas[c.type], {"offered_qos_profiles": qos_text(c)})
            for topic, c in CHANNELS.items()
        }
        for name, values in extras.metadata.items():
            writer.add_metadata(name, values)
        for each in files:
            writer.add_attachment(extras.stamp_ns, extras.stamp_ns, each.name, each.media_type, each.data)
        for topic, stamp_ns, message in messages:
            writer.add_message(numbers[topic], stamp_ns, message, stamp_ns)
        writer.finish()
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
