"""The read report: the channels met, damage, warnings, and how far the reader is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from operator import ne

from msgspec.structs import replace

from mavnav.logs.messages.definitions import CLOUD, FOXGLOVE_SCAN, IMU, MULTI_ECHO, ODOMETRY, SCAN, TF, TF_ROS1
from mavnav.logs.records import AttachedFile, Channel, Damage, MetadataRecord

MAX_DAMAGE = 100
"""Damage is listed singly up to here, so that a log of rubbish does not fill the memory; the rest is counted."""

MAX_WARNINGS = 100
"""Warnings are listed up to here, the rest is counted: every topic of a log carries them all."""

MAX_TEXT = 300
"""Characters of a line of damage or of a warning; names in a log may be of any length."""

_MAX_KINDS = 20

REPLACEMENT = "\ufffd"
"""What stands for bytes that are not UTF-8 in texts that were read."""

KNOWN_TYPES = (SCAN, FOXGLOVE_SCAN, MULTI_ECHO, CLOUD, IMU, ODOMETRY, TF, TF_ROS1)
"""Types that a scan, a pose, a turn or a mounting can come from."""

KNOWN_ENCODINGS = ("cdr", "ros1", "ros2", "json", "protobuf", "carmen")
"""Encodings of messages; ``ros2`` is none, and no misspelt ``ros1`` either."""


class ReadReport:
    """Notes of one pass over a log.

    ``done_bytes`` grows from 0 to ``total_bytes``, the bytes that are to be read; ``here_bytes`` is the place in the
    present file. ``take_extra`` gets what a log holds
    besides messages, or why that cannot be used; without it, that is not read.
    """

    def __init__(self, take_extra: Callable[[AttachedFile | MetadataRecord | str], None] | None = None) -> None:
        self.take_extra = take_extra
        self.channels: dict[Channel, Channel] = {}
        self._declared: dict[Channel, Channel] = {}
        self._warnings: dict[str, None] = {}
        self._more_warnings = 0
        self.total_bytes = 0
        self._base_bytes = 0
        self.here_bytes = 0
        self._damage: list[Damage] = []
        self._unlisted: Counter[str] = Counter()

    def declare(self, channel: Channel) -> Channel:
        """Note a channel, with or without messages; return the one to use for it.

        Merged logs may define a type of one topic in several ways; each is a channel of its own. Where a letter or two
        of a type are wrong, as from a flipped bit, it is the one that is known.
        """
        key = replace(channel, metadata=())
        if key not in self._declared:
            mended = _mend(channel)
            if mended != channel:
                was, now = (f"{c.type} ({c.encoding})" for c in (channel, mended))
                self.damage(f"the type {was} is damaged, and taken for {now}", channel.topic)
            if REPLACEMENT in channel.topic:
                self.warn(f"the name of topic {channel.topic!r} is not UTF-8; what is none is replaced")
            self._declared[key] = self.channels.setdefault(replace(mended, metadata=()), mended)
        return self._declared[key]

    def only(self, message_type: str) -> Channel | None:
        """Return the channel of this type, if there is just one topic of it."""
        channels = [channel for channel in self.channels.values() if channel.type == message_type]
        return channels[0] if len({(channel.topic, channel.encoding) for channel in channels}) == 1 else None

    def damage(self, what: str, where: str) -> None:
        """Note something that could not be read, or is suspect."""
        what, where = _shorten(what), _shorten(where)
        if len(self._damage) < MAX_DAMAGE:
            self._damage.append(Damage(what, where))
        elif what in self._unlisted or len(self._unlisted) < _MAX_KINDS:
            self._unlisted[what] += 1
        else:
            self._unlisted["damage of other kinds"] += 1

    def warn(self, text: str) -> None:
        """Note something odd by which no data are lost; once, however often it is reported."""
        text = _shorten(text)
        if text not in self._warnings and len(self._warnings) < MAX_WARNINGS:
            self._warnings[text] = None
        elif text not in self._warnings:
            self._more_warnings += 1

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was warned about; the rest in a line."""
        more = (f"{self._more_warnings} more warnings; choose a topic with --topic",) if self._more_warnings else ()
        return (*self._warnings, *more)

    def next_file(self, size_bytes: int) -> None:
        """Note that a file of this size is done."""
        self._base_bytes += size_bytes
        self.here_bytes = 0

    @property
    def done_bytes(self) -> int:
        """Bytes read so far."""
        return self._base_bytes + self.here_bytes

    def damages(self) -> tuple[Damage, ...]:
        """Return what was noted, the unlisted rest in one line a kind."""
        rest = (Damage(f"{what} ({count} more)", "further on") for what, count in self._unlisted.items())
        return (*self._damage, *rest)


def _shorten(text: str) -> str:
    return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 3]}..."


def _mend(channel: Channel) -> Channel:
    """Return the channel with its type and encoding as they were, if only a letter or two are wrong."""
    kind = _nearest(channel.type, KNOWN_TYPES, 2)
    encoding = _nearest(channel.encoding, KNOWN_ENCODINGS, 1)
    return replace(channel, type=kind, encoding=encoding) if kind and encoding else channel


def _nearest(word: str, known: tuple[str, ...], most: int) -> str | None:
    """Return the known word that is as long and has at most so many other letters."""
    if word in known:
        return word
    wrong = {name: sum(map(ne, name, word)) for name in known if len(name) == len(word)}
    name = min(wrong, key=wrong.__getitem__, default=None)
    return name if name and wrong[name] <= most else None
