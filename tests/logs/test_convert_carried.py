"""`mavnav convert`: what a log holds besides the bytes of its messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import Writer as Bag2Writer

from mavnav.logs import open_log
from mavnav.logs.writing.convert import convert_log
from support.log_files import LASER, START_NS, laser, serialized, store

if TYPE_CHECKING:
    from pathlib import Path

    from mcap.records import Channel

LATER_NS = 7_000_000


def channel_of(path: Path) -> Channel:
    """Return the only channel of an MCAP."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    (channel,) = summary.channels.values()
    return channel


def with_extras(path: Path) -> Path:
    """Write an MCAP with its own quality of service, times of publishing, attachments and a metadata record."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(LASER, "ros2msg", b"")
        metadata = {"offered_qos_profiles": "- reliability: best_effort\n", "robot": "one"}
        channel = writer.register_channel("/scan", "cdr", schema, metadata)
        writer.add_metadata("site", {"hall": "3"})
        for k in range(3):
            stamp_ns = laser(k).stamp_ns
            writer.add_message(channel, stamp_ns + LATER_NS, serialized(laser(k), 2), stamp_ns)
            writer.add_attachment(k, k + 1, f"{k}.txt", "text/plain", b"note" * k)
        writer.finish()
    return path


def test_an_mcap_keeps_what_it_holds_besides_messages(tmp_path: Path) -> None:
    done = convert_log(with_extras(tmp_path / "a.mcap"), tmp_path / "b.mcap")
    assert (done.left_out, done.warnings) == ({}, ())
    assert channel_of(tmp_path / "b.mcap").metadata == channel_of(tmp_path / "a.mcap").metadata
    for name in ("a.mcap", "b.mcap"):
        with (tmp_path / name).open("rb") as file:
            reader = make_reader(file)
            assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [("site", {"hall": "3"})]
            files = [(a.create_time, a.log_time, a.name, a.media_type, a.data) for a in reader.iter_attachments()]
            assert files == [(k, k + 1, f"{k}.txt", "text/plain", b"note" * k) for k in range(3)]
            assert [m.log_time - m.publish_time for _, _, m in reader.iter_messages()] == [LATER_NS] * 3


def test_an_attachment_that_is_damaged_is_left_out_and_named(tmp_path: Path) -> None:
    path = with_extras(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes().replace(b"notenote", b"note?ote"))
    done = convert_log(path, tmp_path / "b.mcap")
    assert done.left_out == {"extras": 1}
    assert [text for text in done.warnings if "2.txt" in text and "left out" in text]
    assert open_log(tmp_path / "b.mcap").counts.usable == 3


def test_a_ros_2_bag_keeps_its_quality_of_service(tmp_path: Path) -> None:
    time = QosTime(0, 0)
    best = (QosReliability.BEST_EFFORT, QosDurability.VOLATILE, time, time, QosLiveliness.AUTOMATIC, time)
    with Bag2Writer(tmp_path / "bag", version=8) as writer:
        profile = Qos(QosHistory.KEEP_LAST, 5, *best, avoid_ros_namespace_conventions=False)
        connection = writer.add_connection("/scan", LASER, typestore=store(2), offered_qos_profiles=[profile])
        writer.write(connection, START_NS, serialized(laser(0), 2))
    convert_log(tmp_path / "bag", tmp_path / "b.mcap")
    (profile,) = yaml.safe_load(channel_of(tmp_path / "b.mcap").metadata["offered_qos_profiles"])
    assert (profile["depth"], profile["reliability"]) == (5, QosReliability.BEST_EFFORT.value)


def test_a_latched_topic_of_ros_1_is_transient_local(tmp_path: Path) -> None:
    for latching, durability in ((1, "transient_local"), (0, "volatile")):
        with Bag1Writer(tmp_path / f"{latching}.bag") as writer:
            connection = writer.add_connection("/scan", LASER, typestore=store(1), latching=latching)
            writer.write(connection, START_NS, serialized(laser(0), 1))
        convert_log(tmp_path / f"{latching}.bag", tmp_path / f"{latching}.mcap")
        (profile,) = yaml.safe_load(channel_of(tmp_path / f"{latching}.mcap").metadata["offered_qos_profiles"])
        assert profile["durability"] == durability
