"""The section ``wall_thickness`` of run.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from mavnav.metrics.fields import Measured, absent, number
from mavnav.metrics.wall_spread import WallCuts, WallSpread, wall_spread
from mavnav.metrics.wall_thickness import Sections, WallThickness, summary

if TYPE_CHECKING:
    from collections.abc import Mapping

PAPER_MIN_HITS: Final = 2
"""Hit threshold of the paper's count: the paper names none, and this one leaves out single stray hits."""


@dataclass(frozen=True, slots=True)
class PaperCells:
    """The paper's count: cells from the first to the last occupied cell across a wall, of at least ``min_hits``."""

    min_hits: int = field(metadata=number("a cell is occupied from so many hits on"))
    median: Measured = field(metadata=number("half of the wall, by length, has no more cells", unit="cells"))
    p95: Measured = field(metadata=number("95 % of the wall, by length, has no more cells", unit="cells"))
    max: Measured = field(
        metadata=number("cells of the thickest section of a wall", title="wall max", unit="cells", better="lower")
    )


@dataclass(frozen=True, slots=True)
class WallThicknessReport:
    """Wall thickness: the spread of hits across the walls, the paper's count of cells, and the published map's walls.

    The sections under a number use that hit threshold.
    """

    spread: WallSpread = field(default_factory=absent)
    paper_cells: PaperCells = field(default_factory=absent)
    hits_1: WallThickness = field(
        default_factory=absent, metadata={"alias": "1", "description": "cells of at least 1 hit"}
    )
    hits_2: WallThickness = field(
        default_factory=absent, metadata={"alias": "2", "description": "cells of at least 2 hits"}
    )
    hits_5: WallThickness = field(
        default_factory=absent, metadata={"alias": "5", "description": "cells of at least 5 hits"}
    )
    published_map: WallThickness = field(
        default_factory=absent, metadata={"description": "occupied cells of map.pgm, as of any tool's map file"}
    )


def wall_report(
    sections: Mapping[int, Sections], published: Sections | None, cuts: WallCuts | None, cell_m: float
) -> WallThicknessReport:
    """Return the summary of the sections at each hit threshold, of the published map, and of the cuts, unless None."""
    found = {hits: summary(cut, cell_m) for hits, cut in sections.items()}
    paper = found.get(PAPER_MIN_HITS)
    return WallThicknessReport(
        spread=absent() if cuts is None else wall_spread(cuts, cell_m),
        paper_cells=absent()
        if paper is None
        else PaperCells(PAPER_MIN_HITS, paper.median_cells, paper.p95_cells, paper.max_cells),
        **{f"hits_{hits}": thickness for hits, thickness in found.items()},
        published_map=absent() if published is None else summary(published, cell_m),
    )
