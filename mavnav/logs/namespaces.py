"""Names of topics: whose they are where several robots, or several lasers, are in one log."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import takewhile
from string import digits
from typing import Final

from mavnav.logs.messages.definitions import FOXGLOVE_SCAN, MULTI_ECHO, SCAN
from mavnav.logs.records import Topic

FRAME: Final = "@"
"""Between a topic and a frame, where one topic has the scans of several lasers; no ROS name contains it."""

_OF_LASERS = frozenset({SCAN, FOXGLOVE_SCAN, MULTI_ECHO})


def namespace(name: str) -> str:
    """Return the namespace of a frame or a topic, empty for none: all before its last slash."""
    return name.rpartition("/")[0]


def topic_and_frame(name: str) -> tuple[str, str | None]:
    """Split the name of a scan topic into the topic and the frame of its laser, None for any."""
    topic, separator, frame = name.partition(FRAME)
    return topic, frame if separator else None


def shared_levels(a: str, b: str) -> int:
    """Count the levels that the namespaces of two topics share, from the root on."""
    return len([*takewhile(lambda pair: pair[0] == pair[1], zip(_levels(a), _levels(b), strict=False))])


def _levels(name: str) -> list[str]:
    return [level for level in namespace(name).split("/") if level]


def laser_topics(topics: Iterable[Topic]) -> list[str]:
    """Return the topics that have messages of lasers."""
    return [topic.name for topic in topics if topic.type in _OF_LASERS and topic.count]


def is_of_another_robot(name: str, topic: str, scan_topics: Iterable[str]) -> bool:
    """Return whether a topic is not of the robot of a scan topic: nearer to another one, or of another number."""
    shared = shared_levels(name, topic)
    if any(shared_levels(name, other) > shared for other in scan_topics):
        return True
    level, other = (levels[shared] if len(levels := _levels(each)) > shared else "" for each in (name, topic))
    return level != other and bool(level) and level.rstrip(digits) == other.rstrip(digits) != ""


def of_same_robot(names: Iterable[str], topic: str, scan_topics: Iterable[str]) -> list[str]:
    """Return those topics that are of the robot of a scan topic, the nearest in their namespaces.

    So, beside /robot2/scan, /robot2/odom is never that of /robot1/scan, while /odom is if there is no /robot1/odom.
    """
    others = [*scan_topics]
    own = [name for name in names if not is_of_another_robot(name, topic, others)]
    nearest = max((shared_levels(name, topic) for name in own), default=0)
    return [name for name in own if shared_levels(name, topic) == nearest]
