"""The section ``wall_thickness`` of run.json."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from msgspec import Struct, field

from mavnav.metrics.fields import Measured, absent, number, text
from mavnav.metrics.wall_spread import WallCuts, WallSpread, wall_spread
from mavnav.metrics.wall_thickness import Sections, WallThickness, summary

if TYPE_CHECKING:
    from collections.abc import Mapping

PAPER_MIN_HITS: Final = 2
"""Hit threshold of the paper's count: the paper names none, and this one leaves out single stray hits."""


class PaperCells(Struct, frozen=True):
    """The paper's count: cells from the first to the last occupied cell across a wall, of at least ``min_hits``."""

    min_hits: Annotated[int, number("a cell is occupied from so many hits on")]
    median: Annotated[Measured, number("half of the wall length is at most so many cells thick", unit="cells")]
    p95: Annotated[Measured, number("95 % of the wall length is at most so many cells thick", unit="cells")]
    max: Annotated[
        Measured, number("cells of the thickest section of a wall", title="wall max", unit="cells", better="lower")
    ]


class WallThicknessReport(Struct, frozen=True):
    """Wall thickness: the spread of hits across the walls, the paper's count of cells, and the published map's walls.

    The sections under a number use that hit threshold.
    """

    spread: WallSpread = field(default_factory=absent)
    paper_cells: PaperCells = field(default_factory=absent)
    hits_1: Annotated[WallThickness, text("cells of at least 1 hit")] = field(name="1", default_factory=absent)
    hits_2: Annotated[WallThickness, text("cells of at least 2 hits")] = field(name="2", default_factory=absent)
    hits_5: Annotated[WallThickness, text("cells of at least 5 hits")] = field(name="5", default_factory=absent)
    published_map: Annotated[WallThickness, text("occupied cells of map.pgm, as of any tool's map file")] = field(
        default_factory=absent
    )


def wall_report(
    sections: Mapping[int, Sections], published: Sections | None, cuts: WallCuts | None, cell_m: float
) -> WallThicknessReport:
    """Return the summary of the sections at each hit threshold, of the published map, and of the cuts, unless None."""
    by_hits = {hits: summary(cut, cell_m) for hits, cut in sections.items()}
    paper = by_hits.get(PAPER_MIN_HITS)
    return WallThicknessReport(
        spread=absent() if cuts is None else wall_spread(cuts, cell_m),
        paper_cells=absent()
        if paper is None
        else PaperCells(PAPER_MIN_HITS, paper.median_cells, paper.p95_cells, paper.max_cells),
        **{f"hits_{hits}": thickness for hits, thickness in by_hits.items()},
        published_map=absent() if published is None else summary(published, cell_m),
    )
