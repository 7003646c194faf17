"""What a reader tells while it reads: the channels met, damage, warnings, and how far it is."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from mavnav.logs.records import Damage

if TYPE_CHECKING:
    from mavnav.logs.records import Channel

MAX_DAMAGE = 100
"""Damage is listed singly up to here, so that a log of rubbish does not fill the memory; the rest is counted."""


class Ledger:
    """Notes of one pass over a log.

    ``done_bytes`` grows from 0 to ``total_bytes``, the bytes that are to be read.
    """

    def __init__(self) -> None:
        self.channels: dict[tuple[str, str, str], Channel] = {}
        self.warnings: list[str] = []
        self.total_bytes = 0
        self._base_bytes = 0
        self.here_bytes = 0
        self._damage: list[Damage] = []
        self._unlisted: Counter[str] = Counter()

    def declare(self, channel: Channel) -> Channel:
        """Note a channel, with or without messages; return the one to use for it."""
        return self.channels.setdefault((channel.topic, channel.type, channel.encoding), channel)

    def only(self, message_type: str) -> Channel | None:
        """Return the channel of this type, if there is just one."""
        found = [channel for channel in self.channels.values() if channel.type == message_type]
        return found[0] if len(found) == 1 else None

    def damage(self, what: str, where: str) -> None:
        """Note something that could not be read, or is suspect."""
        if len(self._damage) < MAX_DAMAGE:
            self._damage.append(Damage(what, where))
        else:
            self._unlisted[what] += 1

    def warn(self, text: str) -> None:
        """Note something odd by which no data are lost; once, however often it is told."""
        if text not in self.warnings:
            self.warnings.append(text)

    def at(self, offset: int) -> None:
        """Note the place in the present file."""
        self.here_bytes = offset

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
