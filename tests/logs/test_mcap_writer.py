"""MCAP files hold what was put into them, as the library of the format reads it."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.reader import make_reader

from mavnav.logs.messages import definitions, ros
from mavnav.logs.records import AttachedFile, MetadataRecord
from mavnav.logs.writing.mcap_writer import CHUNK_BYTES, OutputChannel, write_serialized

CHANNELS = {
    "/tf_static": OutputChannel(definitions.TF, latched=True),
    "/tf": OutputChannel(definitions.TF),
    "/scan": OutputChannel(definitions.SCAN),
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


def test_extras_come_first(tmp_path) -> None:
    extras = [MetadataRecord("name", {"a": "ü", "b": ""}), AttachedFile(7, 7, "é.txt", "text/plain", b"data")]
    with write_serialized(tmp_path / "a.mcap", CHANNELS, extras=extras) as put:
        put("/tf", 1, b"")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        assert [(each.name, each.metadata) for each in reader.iter_metadata()] == [("name", {"a": "ü", "b": ""})]
        (attachment,) = reader.iter_attachments()
        assert (attachment.name, attachment.log_time, attachment.data) == ("é.txt", 7, b"data")
        (chunk,) = reader.get_summary().chunk_indexes
        assert reader.get_summary().attachment_indexes[0].offset < chunk.chunk_start_offset


def test_equal_messages_give_equal_bytes(tmp_path) -> None:
    for name in ("a", "b"):
        with write_serialized(tmp_path / name, CHANNELS) as put:
            put("/tf", 1, b"message")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
