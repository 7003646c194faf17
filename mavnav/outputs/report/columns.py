"""The summary table: what is measured of each run, which run is best at it, and what that costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mavnav.outputs.quantities import QUANTITIES, Quantity, number, why_not_meaningful, winners

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.outputs.report.entry import Entry


@dataclass(frozen=True, slots=True)
class Shown:
    """A field of the table: the text, and whether it is the best of its column."""

    text: str
    best: bool


@dataclass(frozen=True, slots=True)
class Row:
    """A run in the table; ``price`` its evaluations and time as multiples of the coarsest grid's, None if not known."""

    name: str
    fields: tuple[Shown, ...]
    price: tuple[float | None, float | None]
    why_not: str


@dataclass(frozen=True, slots=True)
class Table:
    """The runs of one log by the columns that any of them has."""

    columns: tuple[Quantity, ...]
    rows: tuple[Row, ...]


def table(entries: Sequence[Entry]) -> Table:
    """Set the runs of one log side by side."""
    runs = [e.document for e in entries]
    columns = tuple(c for c in QUANTITIES if any(c.of(run) is not None for run in runs))
    best = {c: winners(c, runs) for c in columns}
    rows = tuple(
        Row(
            e.name,
            tuple(Shown(text(c.of(e.document), c.digits), k in best[c]) for c in columns),
            (times_the_coarsest(entries, e), times_the_coarsest(entries, e, "timing.cpu_s")),
            why_not_meaningful(e.document),
        )
        for k, e in enumerate(entries)
    )
    return Table(columns, rows)


NOTHING: Final = "\u2013"
"""What the page shows for a value that is not known."""


def text(value: float | None, digits: int) -> str:
    """Write a number with its digits, thousands apart."""
    return NOTHING if value is None else f"{value:,.{digits}f}".replace(",", "\u202f")


def fineness(entry: Entry) -> int:
    """Return the points of a run's search grid, 0 where it does not say."""
    try:
        across, along = str(entry.document.get("grid")).split("x")
        return int(across) * int(along) + int(entry.document.get("azimuth") or 0)
    except ValueError:
        return 0


def coarsest(entries: Sequence[Entry], like: Entry) -> Entry:
    """Return the run of the same method with the coarsest grid."""
    same = [e for e in entries if e.document.get("method") == like.document.get("method")]
    return min(same, key=fineness)


def times_the_coarsest(
    entries: Sequence[Entry], entry: Entry, key: str = "search.evaluations_per_scan.mean"
) -> float | None:
    """Return what a run took, its evaluations a match, as a multiple of what the coarsest grid of its method did."""
    least, own = number(coarsest(entries, entry).document, key), number(entry.document, key)
    return None if not least or own is None else float(own / least)
