"""The summary table: the metrics of each run, the best runs of each metric, and the relative cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from mavnav.outputs.documents import quantities
from mavnav.outputs.documents.quantities import number

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.outputs.report.entry import Entry


COLUMNS: Final = (quantities.QUANTITIES[0], quantities.DOUBT, *quantities.QUANTITIES[1:])
"""The columns of the table: the doubt stands beside the share of accepted scans."""


class Field(Struct, frozen=True):
    """A field of the table: its text, and whether it is the best of its column."""

    text: str
    best: bool


class RunRow(Struct, frozen=True):
    """A run in the table; ``relative_costs`` are its evaluations and CPU time over those of the coarsest grid, or None.

    ``why_not`` is the reason why its map is not compared, empty if it is.
    """

    name: str
    fields: tuple[Field, ...]
    relative_costs: tuple[float | None, float | None]
    why_not: str


class RunTable(Struct, frozen=True):
    """The runs of one log, with the columns for which any of them has a value.

    ``not_compared`` says which of them are not compared between all runs, empty if all are.
    """

    columns: tuple[quantities.Quantity, ...]
    rows: tuple[RunRow, ...]
    not_compared: str


def table(entries: Sequence[Entry]) -> RunTable:
    """Return the table of the runs of one log."""
    runs = [e.document for e in entries]
    columns = tuple(c for c in COLUMNS if any(c.of(run) is not None for run in runs))
    best = {c: quantities.winners(c, runs) for c in columns}
    rows = tuple(
        RunRow(
            e.name,
            tuple(Field(text(c.of(e.document), c.digits), k in best[c]) for c in columns),
            (relative_cost(entries, e), relative_cost(entries, e, "timing.cpu_s")),
            quantities.why_not_meaningful(e.document),
        )
        for k, e in enumerate(entries)
    )
    return RunTable(columns, rows, quantities.size_note(runs))


MISSING: Final = "\u2013"
"""Text for an unknown value."""


def text(value: float | None, digits: int) -> str:
    """Format a number with ``digits`` decimals and thin spaces between thousands."""
    return MISSING if value is None else f"{value:,.{digits}f}".replace(",", "\u202f")


def fineness(entry: Entry) -> int:
    """Return the number of grid points plus yaw samples of a run's search grid, 0 if unknown."""
    try:
        across, along = str(entry.document.get("grid")).split("x")
        return int(across) * int(along) + int(entry.document.get("azimuth") or 0)
    except ValueError:
        return 0


def coarsest(entries: Sequence[Entry], like: Entry) -> Entry:
    """Return the run of the same method with the coarsest grid."""
    same = [e for e in entries if e.document.get("method") == like.document.get("method")]
    return min(same, key=fineness)


def relative_cost(
    entries: Sequence[Entry], entry: Entry, key: str = "search.evaluations_per_scan.mean"
) -> float | None:
    """Return a cost of a run, by default its evaluations per match, over that of the coarsest grid of its method."""
    least, own = number(coarsest(entries, entry).document, key), number(entry.document, key)
    return None if not least or own is None else float(own / least)
