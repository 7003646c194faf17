"""Messages that are no scans wait here until they are decoded together, in columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec import Struct, field

from mavnav.logs.messages.decode import decode_together
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel
from mavnav.logs.stamps import storable


class Waiting(Struct):
    """Messages of a topic that are no scans, until they are decoded together and go to the ``takers``."""

    channel: Channel
    decode: Callable[[bytes], Any]
    takers: tuple[Callable[[list[Any]], None], ...]
    messages: list[bytes] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)

    def pass_on(self, report: ReadReport) -> None:
        """Decode what waits; a message that does not decode is noted."""
        log_ns = np.array([*map(storable, self.log_ns)], np.int64)
        parts, errors = decode_together(self.channel, self.messages, log_ns, self.decode)
        for row, error in errors.items():
            where = f"{self.channel.topic}, {self.log_ns[row]} ns"
            report.damage(f"a message does not decode ({error})", where)
        for take in self.takers if parts else ():
            take(parts)
        self.messages, self.log_ns = [], []
