"""The summary table: what is measured of each run, which run is best at it, and what that costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from mavnav.units import MM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.outputs.report.entry import Entry

LEAST_MAPPED_SHARE: Final = 0.5
"""Where a run does not say itself whether its map means anything, it does not with fewer of the scans on it."""


@dataclass(frozen=True, slots=True)
class Column:
    """A measure: the first of ``keys`` that the document has, times ``factor``, written with ``digits``.

    ``better`` is -1 where less is better, +1 where more is, 0 where neither. ``per_cell`` measures compare maps of one
    cell size only, ``by_cells`` measures differ only from one cell on. ``price`` is no virtue of the map.
    """

    title: str
    unit: str
    keys: tuple[str, ...]
    digits: int
    better: int
    about: str
    factor: float = 1.0
    per_cell: bool = False
    by_cells: bool = False
    price: bool = False


COLUMNS: Final = (
    Column("scans mapped", "%", ("map_quality.support.mapped_share", "map.accepted_share"), 1, 1,
           "share of the scans that are on the map", 100.0),
    Column("wall p95", "mm", ("wall_thickness.2.p95_mm",), 0, -1,
           "95 % of the wall, by length, is not thicker (cells of at least 2 hits)", by_cells=True),
    Column("wall max", "mm", ("wall_thickness.2.max_mm",), 0, -1, "the thickest section of a wall",
           by_cells=True),
    Column("ghost walls", "m", ("map_quality.ghost_walls.length_m",), 1, -1, "walls that stand on the map twice"),
    Column("cells per m", "", ("map_quality.crispness.occupied_cells_per_m",), 1, -1,
           "occupied cells per metre of wall", per_cell=True),
    Column("entropy", "bit", ("map_quality.crispness.entropy_bits",), 3, -1, "how undecided the cells are",
           per_cell=True),
    Column("revisits", "mm", ("map_quality.revisits.nn_l_mm",), 1, -1,
           "how far scans of a place lie from scans of the same place at another time"),
    Column("ATE", "mm", ("reference.ate.rmse_m", "truth.ate_rmse_m"), 0, -1,
           "absolute trajectory error against the truth, root mean square, after alignment", 1e3),
    Column("evaluations", "a match", ("search.evaluations_per_scan.mean",), 0, -1,
           "how many poses the search tries for each scan", price=True),
    Column("time", "s CPU", ("timing.cpu_s",), 2, -1, "processor time of the whole run", price=True),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Shown:
    """A field of the table: the text, whether it is the best of its column, and a bar's length from 0 to 1."""

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

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


def lookup(document: dict[str, Any], key: str) -> Any:  # noqa: ANN401  any JSON value
    """Return what a document has under keys joined by dots, None where there is nothing."""
    value: Any = document
    for part in key.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def value_of(entry: Entry, column: Column) -> float | None:
    """Return a run's value in the column's unit."""
    found = (lookup(entry.document, key) for key in column.keys)
    value = next((v for v in found if v is not None), None)
    return None if value is None else float(value) * column.factor


def why_not_meaningful(entry: Entry) -> str:
    """Say why a map is not to be compared with others; empty where it is."""
    quality = entry.document.get("map_quality")
    if quality:
        return "" if quality.get("meaningful") else "; ".join(map(str, quality.get("why") or ["no map to speak of"]))
    if (entry.document.get("tracking") or {}).get("lost"):
        return "the track was lost for good"
    share = lookup(entry.document, "map.accepted_share") or 0.0
    return "" if share >= LEAST_MAPPED_SHARE else f"only {share:.0%} of the scans are on the map"


def table(entries: Sequence[Entry]) -> Table:
    """Set the runs of one log side by side."""
    columns = tuple(c for c in COLUMNS if any(value_of(e, c) is not None for e in entries))
    best = {c: winners(entries, c) for c in columns}
    rows = tuple(
        Row(
            e.name,
            tuple(Shown(text(value_of(e, c), c.digits), k in best[c]) for c in columns),
            (times_the_coarsest(entries, e), times_the_coarsest(entries, e, "timing.cpu_s")),
            why_not_meaningful(e),
        )
        for k, e in enumerate(entries)
    )
    return Table(columns, rows)


NOTHING: Final = "\u2013"
"""What the page shows for a value that is not known."""


def text(value: float | None, digits: int) -> str:
    """Write a number with its digits, thousands apart."""
    return NOTHING if value is None else f"{value:,.{digits}f}".replace(",", "\u202f")


def winners(entries: Sequence[Entry], column: Column) -> frozenset[int]:
    """Return which runs are best at a measure, up to differences that do not count; none where no other does.

    Only meaningful maps compete, at least two, and only of one cell size where the measure counts cells.
    """
    found = {k: value_of(e, column) for k, e in enumerate(entries) if not why_not_meaningful(e)}
    values = {k: round(v, column.digits) for k, v in found.items() if v is not None}
    sizes_m = {entries[k].grid.cell_m for k in values}
    if not values or not column.better or (column.per_cell and len(sizes_m) > 1):
        return frozenset()
    best = max(values.values(), key=lambda v: column.better * v)
    counts_from = max(sizes_m) / MM if column.by_cells else 0.0
    won = frozenset(k for k, v in values.items() if v == best or abs(v - best) < counts_from)
    return won if len(won) < len(values) else frozenset()


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
    least, own = lookup(coarsest(entries, entry).document, key), lookup(entry.document, key)
    return None if not least or own is None else float(own / least)
