"""The record of how doubtful a track is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

HIGH: Final = 0.5
"""A track of higher probability is marked as doubtful."""

NOT_PLANAR: Final = "not planar"
"""The reason that makes a map of the plane meaningless."""


class Reason(NamedTuple):
    """A reason to doubt a track: the scans from and to which it holds, stamps in ns, and its strongest value there."""

    name: str
    start_ns: int
    end_ns: int
    value: float


class Remedy(NamedTuple):
    """Another whole track, made because the first one was lost or doubtful, the doubt of both, and which was kept."""

    name: str
    doubt_before: float
    doubt_after: float
    used: bool


@dataclass(frozen=True, slots=True)
class Doubt:
    """The probability that an accepted track is wrong somewhere, the reasons, the strongest first.

    ``tried`` names what was done because of it.
    """

    probability: float
    reasons: tuple[Reason, ...] = ()
    tried: tuple[str, ...] = ()

    @property
    def high(self) -> bool:
        """Whether the track is marked as doubtful."""
        return self.probability > HIGH

    def marks(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which of the scans (n,) are doubtful: those of the reasons, if the doubt is high.

        A reason that holds everywhere marks them only where no other says more.
        """
        found = [(stamps_ns >= r.start_ns) & (stamps_ns <= r.end_ns) for r in self.reasons if self.high]
        local = [some for some in found if not some.all()]
        marked = np.zeros(len(stamps_ns), np.bool_)
        for some in local or found:
            marked |= some
        return marked
