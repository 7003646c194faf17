"""MCAP files have the bytes that the library of the format would write."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from mavnav import __version__
from mavnav.logs import definitions, ros
from mavnav.logs.mcap_writer import CHUNK_BYTES, Channel, qos_text, write_serialized

CHANNELS = {
    "/tf_static": Channel(definitions.TF, latched=True),
    "/tf": Channel(definitions.TF),
    "/scan": Channel(definitions.SCAN),
}


def by_library(path, messages):
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES)
        writer.start("ros2", f"mavnav {__version__}")
        kinds = {definitions.TF: 0, definitions.SCAN: 0}
        schemas = {kind: writer.register_schema(kind, "ros2msg", ros.definition(kind).encode()) for kind in kinds}
        numbers = {
            topic: writer.register_channel(topic, "cdr", schemas[c.type], {"offered_qos_profiles": qos_text(c)})
            for topic, c in CHANNELS.items()
        }
        for topic, stamp_ns, data in messages:
            writer.add_message(numbers[topic], stamp_ns, data, stamp_ns)
        writer.finish()
    return path.read_bytes()


@pytest.mark.parametrize("count", [0, 1, 2, 300])
def test_the_bytes_are_those_of_the_library(tmp_path, count) -> None:
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
    assert (tmp_path / "a.mcap").read_bytes() == by_library(tmp_path / "b.mcap", messages)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        assert [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()] == sorted(
            messages, key=lambda m: m[1]
        )
        assert len(reader.get_summary().chunk_indexes) == -(-count * 2031 // (CHUNK_BYTES + 2031))
