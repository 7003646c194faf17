"""Stamps in a log: the order in which its messages are used, and which do not fit in."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

StampSource = Literal["header", "log"]

_LATEST_NS: Final = 1 << 62
_CALENDAR_NS: Final = 1_000_000_000_000_000_000
"""September 2001: stamps of a clock with a date are later, those that count from a start before."""


def storable(stamp_ns: int) -> int:
    """Return a stamp within the range of 64 bits; an impossible one stays impossible."""
    return min(max(stamp_ns, -1), _LATEST_NS)


class Stamps(Struct):
    """Both stamps of the messages of a topic as they came, 16 bytes each: of their headers, and of their recording."""

    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.header_ns)

    def add(self, header_ns: int, log_ns: int) -> None:
        """Take in the stamps of one message."""
        self.header_ns.append(header_ns if 0 <= header_ns < _LATEST_NS else storable(header_ns))
        self.log_ns.append(log_ns if 0 <= log_ns < _LATEST_NS else storable(log_ns))

    def extend(self, header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> None:
        """Take in the stamps of several messages, (n,) each."""
        for column, values in ((self.header_ns, header_ns), (self.log_ns, log_ns)):
            column.frombytes(values.clip(-1, _LATEST_NS).tobytes())

    def by(self, source: StampSource) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the stamps of a source, and those of recording, (n,) each."""
        header_ns, log_ns = np.array(self.header_ns, np.int64), np.array(self.log_ns, np.int64)
        return (header_ns if source == "header" else log_ns), log_ns


def ascending(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Choose the most elements that ascend strictly.

    Where passing over what is not later than all before keeps as many, that is the choice: so of two equal stamps the
    first counts, and a step back costs the scans after it, not those before.

    Parameters
    ----------
    stamps_ns
        (n,), in the order of use.

    Returns
    -------
    indices
        (m,), ascending, with ``m <= n``.
    """
    steps_ns = np.diff(stamps_ns)
    if (steps_ns > 0).all():
        return np.arange(len(stamps_ns))
    later = stamps_ns[1:] > np.maximum.accumulate(stamps_ns)[:-1]
    greedy = np.flatnonzero(np.concatenate(([True], later)))
    if (steps_ns >= 0).all():
        return greedy
    longest = _longest_ascending(stamps_ns.tolist())
    return greedy if len(greedy) >= len(longest) else np.array(longest)


def in_order(
    stamps_ns: NDArray[np.int64], recorded_ns: NDArray[np.int64], topic: str, warn: Callable[[str], None]
) -> NDArray[np.int64]:
    """Choose the most messages of ascending stamps, in the order of the file, or of recording where that keeps more.

    Returns their indices in the order of use, and warns of those left out; of equal stamps one is enough.
    """
    possible = np.flatnonzero(~impossible_stamps(stamps_ns))
    chosen = better_order(possible, recorded_ns, lambda numbers: numbers[ascending(stamps_ns[numbers])])
    if len(chosen) < len(stamps_ns) and (left_out := ~np.isin(stamps_ns, stamps_ns[chosen])).any():
        warn(f"{topic}: {left_out.sum()} of {len(stamps_ns)} messages are left out, their stamps do not ascend")
    return chosen


def better_order(
    numbers: NDArray[np.int64], recorded_ns: NDArray[np.int64], choose: Callable[[NDArray[np.int64]], NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Choose from the numbers (n,) in the order of the file, or of recording where that keeps more."""
    chosen = choose(numbers)
    if len(chosen) == len(numbers):
        return chosen
    other = choose(numbers[np.argsort(recorded_ns[numbers], kind="stable")])
    return other if len(other) > len(chosen) else chosen


def _longest_ascending(values: list[int]) -> list[int]:
    """Return the indices of the longest strictly ascending subsequence (patience sorting)."""
    tops: list[int] = []
    indices: list[int] = []
    previous: list[int] = []
    for index, value in enumerate(values):
        pile = bisect_left(tops, value)
        previous.append(indices[pile - 1] if pile else -1)
        tops[pile : pile + 1] = [value]
        indices[pile : pile + 1] = [index]
    chain, index = [], indices[-1] if indices else -1
    while index >= 0:
        chain.append(index)
        index = previous[index]
    return chain[::-1]


def impossible_stamps(stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which stamps are no times; zero is one, unless the clock has a date."""
    given = stamps_ns[stamps_ns != 0]
    least = 1 if len(given) and np.median(given) > _CALENDAR_NS else 0
    return (stamps_ns < least) | (stamps_ns >= _LATEST_NS)
