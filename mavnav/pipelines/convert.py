"""What is converted of a log: the document of ``mavnav convert``.

A run can be put back into its log: its transforms, poses, map and markers, to be seen beside all that was recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec.structs import asdict

from mavnav.errors import ExitCode, UsageError
from mavnav.ground_truth.tables import read_tum
from mavnav.logs import Log, Survey, choose, content_sha256, survey
from mavnav.logs.formats import detect
from mavnav.logs.messages import cdr, ros
from mavnav.logs.messages.definitions import TF, definition
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel, RawMessage, Schema
from mavnav.logs.transforms import TF_PREFIX, FramePoses, follow, frame_name, transforms_for
from mavnav.logs.writing.convert import convert_log
from mavnav.outputs.files.finished_run import finished_run
from mavnav.outputs.files.replay_log import MAP_FRAME
from mavnav.pose import Pose, Trajectory, between
from mavnav.units import NS

SCHEMA_VERSION: Final = 1


def convert_to(
    log: Path, target: Path, run: Path | None, *, strict: bool, force: bool, progress: Callable[..., None]
) -> dict[str, Any]:
    """Convert a log to an indexed MCAP and return the document; with a ``run``, its result is added to the log.

    Raises what `convert_log` does, and `messages_of_run`.
    """
    added = messages_of_run(run, log) if run else ()
    done = convert_log(log, target, strict=strict, force=force, progress=progress, added=added)
    return {
        "schema_version": SCHEMA_VERSION,
        "input": {"path": str(log)},
        "output": {"path": str(target), "size_bytes": target.stat().st_size},
        "topics": [asdict(topic) for topic in done.topics],
        "messages": done.messages,
        "left_out": done.left_out,
        "damage": [asdict(damage) for damage in done.damage],
        "warnings": list(done.warnings),
        "exit_code": int(ExitCode.DAMAGED_INPUT if done.damage else ExitCode.DONE),
    }


TOPICS: Final = ("/pose", "/map", "/path", "/markers")
"""Topics of result.mcap that are added."""

OTHER: Final = "mavnav"
"""Namespace of the topics, and beginning of the name of the map frame, whose names the log has itself."""


def messages_of_run(directory: Path, log: Path) -> list[RawMessage]:
    """Return what a run adds to its log, in the order of recording.

    ``/tf`` leads from the map to the frame above all others that carry the laser, so that each frame still has one
    parent. Messages have the stamps of the scans. Raises UsageError for a run of another log, and for one without its
    files.
    """
    run = finished_run(directory)
    about = run.document.get("input") or {}
    if about.get("sha256") != content_sha256(log):
        other = about.get("path", "many logs")
        raise UsageError(f"{directory} is a run of {other}, not of {log}; name one of this log")
    map_T_laser, recording = read_tum(run.file("trajectory.tum")), run.file("result.mcap")
    surveyed = survey(log, topic=about["topic"], truth=TF_PREFIX, odom="off")
    opened = choose(surveyed, topic=about["topic"])
    frames = _frames_below(surveyed, opened)
    map_frame = f"{OTHER}_{MAP_FRAME}" if MAP_FRAME in frames.names else MAP_FRAME
    ahead_ns = round(opened.clock.ahead_s / NS) if opened.clock else 0
    messages = [*_transforms(map_T_laser, frames, opened, map_frame)]
    messages += _results(recording, {topic.name for topic in surveyed.topics}, map_frame)
    return sorted((m._replace(log_ns=m.log_ns - ahead_ns) for m in messages), key=attrgetter("log_ns"))


def _frames_below(surveyed: Survey, log: Log) -> FramePoses:
    """Return the transforms of the log from its root frame to the laser, or of several merged lasers to their base."""
    frames = transforms_for(surveyed.motion.frames, log.topic, surveyed.lasers)
    body = log.base_frame if "," in log.topic else log.frame_id
    return FramePoses(TF_PREFIX, frame_name(body or "") or "laser", frames, surveyed.motion.truth.moving)


def _transforms(map_T_laser: Trajectory, frames: FramePoses, log: Log, map_frame: str) -> Iterator[RawMessage]:
    """Yield the transforms from the map to the root frame of the log, at the scans whose place below that is known."""
    root_T_laser = follow(frames.paths(log, lambda _: None), map_T_laser.stamps_ns)
    none = np.zeros_like(root_T_laser)
    map_T_root = between(between(map_T_laser.xyyaw, none), between(root_T_laser, none))
    channel = Channel("/tf", TF, "cdr", Schema(TF, "ros2msg", definition(TF).encode()))
    write = cdr.transforms(map_frame, frames.fixed_frame)
    for stamp_ns, pose in zip(map_T_laser.stamps_ns.tolist(), map_T_root.tolist(), strict=True):
        if np.isfinite(pose[0]):
            yield RawMessage(channel, stamp_ns, write(stamp_ns, Pose(*pose)))


def _results(recording: Path, taken: set[str], map_frame: str) -> Iterator[RawMessage]:
    """Yield poses, maps, path and markers of result.mcap, in the namespace `OTHER` where the log has such a topic."""
    for message in detect.read(recording, ReadReport()):
        channel = message.channel
        if channel.topic not in TOPICS:
            continue
        topic = f"/{OTHER}{channel.topic}" if channel.topic in taken else channel.topic
        data = message.data if map_frame == MAP_FRAME else _in_frame(map_frame, message.data, channel.type)
        renamed = Channel(topic, channel.type, channel.encoding, channel.schema, channel.metadata)
        yield RawMessage(renamed, message.log_ns, data)


def _in_frame(name: str, data: bytes, kind: str) -> bytes:
    """Return a message with another frame in its header, and in those of its poses or markers."""
    message: Any = ros.types_ros2().deserialize_cdr(data, kind)
    for each in (message, *getattr(message, "poses", ()), *getattr(message, "markers", ())):
        if hasattr(each, "header"):
            each.header.frame_id = name
    return ros.cdr(message)
