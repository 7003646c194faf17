"""How much work the searches for a lost laser may take: every scan earns some, and a search spends what it costs.

The unit is a local search, of which a tracked scan takes one or two; all that it costs is five to seven of them. Work
is computed from the sizes of searches, not measured: the same log gives the same track on every machine.
"""

from __future__ import annotations

from math import inf

POSES, CELLS = 20_000, 80_000
"""Poses that a wide search bounds, and cells whose costs are bounded for it, in the time of a local search."""


def search_work(poses: int, cells: float, minima: int) -> float:
    """Return the work of a search of so many poses, with bounds of so many cells, that refines its lowest minima."""
    return minima + poses / POSES + cells / CELLS


class Budget:
    """Credit for searches of one kind, in local searches: ``first``, and what each scan earns, up to ``most``.

    ``work`` is that of the last search that was considered.
    """

    def __init__(self, each_scan: float, first: float, most: float = inf) -> None:
        """Begin with the first credit."""
        self.each_scan, self.most = each_scan, most
        self.credit, self.work = first, 0.0
        self._lent = 0.0

    @property
    def is_ready(self) -> bool:
        """Whether the credit covers a search like the last one; of one that takes more than ``most``, that much."""
        return self.credit >= min(self.work, self.most)

    def earn(self, *, found: bool = False) -> None:
        """Add what a scan earns, and what was lent to the scan before if it was ``found``."""
        self.credit = min(self.credit + self.each_scan + (self._lent if found else 0.0), self.most)
        self._lent = 0.0

    def pays(self, work: float, *, lent: bool = False) -> bool:
        """Spend the work of a search if the credit covers it; what is missing beyond ``most`` is paid off later.

        What is ``lent`` comes back if the scan is found.
        """
        self.work = work
        if not self.is_ready:
            return False
        self.credit -= work
        self._lent += work if lent else 0.0
        return True
