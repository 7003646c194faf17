"""Budget of work for the searches of a lost laser: every scan adds credit, and a search spends its work.

The unit is a local search. A tracked scan needs one or two of them; with insertion and final pass it takes as long as
five to seven. Work is computed from the sizes of searches, not measured: a log gives the same track on every machine.
"""

from __future__ import annotations

from math import inf

DOUBTFUL_SCANS, LONG_LOST_SCANS, RARELY_SCANS = 8, 16, 64
"""Numbers of scans without an accepted pose after which a laser is lost, lost for long, and rarely searched."""

POSES, CELLS = 20_000, 80_000
"""Numbers of poses of a wide search, and of cells whose costs are bounded for it, that take as long as a local one."""

WIDE_EACH, WIDE_FIRST, WIDE_MOST = 2.0, 80.0, 120.0
WHOLE_EACH, WHOLE_FIRST = 1.0, 50.0
"""Budgets of wide regions and of the whole map, in local searches: credit of each scan, first and maximum credit."""


def is_lost(elapsed_s: float, period_s: float) -> bool:
    """Return whether a laser is lost that long after its last accepted pose, at that period of its scans."""
    return elapsed_s > DOUBTFUL_SCANS * period_s


def search_work(poses: int, cells: float, minima: int) -> float:
    """Return the work of a search: ``minima`` to refine, ``poses`` to search, ``cells`` to bound."""
    return minima + poses / POSES + cells / CELLS


class Budget:
    """Credit for searches of one kind, in local searches: ``first`` at the start, ``each_scan`` more, at most ``most``.

    ``work`` is that of the last search that was requested.
    """

    def __init__(self, each_scan: float, first: float, most: float = inf) -> None:
        """Start with the first credit."""
        self.each_scan, self.most = each_scan, most
        self.credit, self.work = first, 0.0
        self._refundable = 0.0

    @property
    def is_ready(self) -> bool:
        """Whether the credit covers a search like the last one requested, or has reached ``most``."""
        return self.credit >= min(self.work, self.most)

    def earn(self, *, found: bool = False) -> None:
        """Add the credit of a scan, and refund the refundable work of the last scan if that was ``found``."""
        self.credit = min(self.credit + self.each_scan + (self._refundable if found else 0.0), self.most)
        self._refundable = 0.0

    def spend(self, work: float, *, refundable: bool = False) -> bool:
        """Spend the work of a search if the credit covers it; return whether it does.

        A search of more work than ``most`` may leave a negative credit. Work that is ``refundable`` is returned by
        ``earn``.
        """
        self.work = work
        if not self.is_ready:
            return False
        self.credit -= work
        self._refundable += work if refundable else 0.0
        return True
