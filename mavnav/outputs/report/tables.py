"""The tables of a report: metrics, the best run of each and relative cost; settings, inputs, notes and ghost walls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

from msgspec import Struct

from mavnav.config.layers import by_dotted_key
from mavnav.outputs.documents import quantities
from mavnav.outputs.documents.quantities import number
from mavnav.outputs.report.entry import Entry
from mavnav.outputs.report.panels import ghosts

COLUMNS: Final = (quantities.QUANTITIES[0], quantities.DOUBT, *quantities.QUANTITIES[1:])
"""The columns of the table: the doubt stands beside the share of accepted scans."""

MISSING: Final = "\u2013"
"""Text for an unknown value."""

MAX_GHOSTS: Final = 20
METHODS: Final = ("paper", "robust")


class NamedRun(NamedTuple):
    """A run by its name within its log, and its run.json."""

    name: str
    document: dict[str, Any]


class Field(Struct, frozen=True):
    """A field of the table: its text, and whether it is the best of its column."""

    text: str
    best: bool


class RunRow(Struct, frozen=True):
    """A run in the table, with the word of its verdict.

    ``relative_costs`` are its evaluations and CPU time over those of the coarsest grid, or None. ``why_not`` is the
    reason why its map is not compared, empty if it is.
    """

    name: str
    word: str
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

    @property
    def has_costs(self) -> bool:
        """Whether there is a cost to be compared; given poses have none."""
        return len(self.rows) > 1 and any(cost is not None for row in self.rows for cost in row.relative_costs)


def table(runs: Sequence[NamedRun]) -> RunTable:
    """Return the table of the runs of one log."""
    documents = [run.document for run in runs]
    columns = tuple(c for c in COLUMNS if any(c.of(document) is not None for document in documents))
    best = {c: quantities.winners(c, documents) for c in columns}
    rows = []
    for k, run in enumerate(runs):
        word, why_not = quantities.verdict_texts(run.document)[0], quantities.why_not_meaningful(run.document)
        fields = tuple(Field(text(c.of(run.document), c.digits), k in best[c]) for c in columns)
        costs = relative_cost(runs, run), relative_cost(runs, run, "timing.cpu_s")
        rows.append(RunRow(run.name, word, fields, costs, why_not))
    return RunTable(columns, tuple(rows), quantities.size_note(documents))


def text(value: float | None, digits: int) -> str:
    """Format a number with ``digits`` decimals and thin spaces between thousands."""
    return MISSING if value is None else f"{value:,.{digits}f}".replace(",", "\u202f")


def fineness(entry: NamedRun) -> int:
    """Return the number of grid points plus yaw samples of a run's search grid, 0 if unknown."""
    try:
        across, along = str(entry.document.get("grid")).split("x")
        return int(across) * int(along) + int(entry.document.get("azimuth") or 0)
    except ValueError:
        return 0


def coarsest(entries: Sequence[NamedRun], like: NamedRun) -> NamedRun:
    """Return the run of the same method with the coarsest grid."""
    same = [e for e in entries if e.document.get("method") == like.document.get("method")]
    return min(same, key=fineness)


def relative_cost(
    entries: Sequence[NamedRun], entry: NamedRun, key: str = "search.evaluations_per_scan.mean"
) -> float | None:
    """Return a cost of a run, by default its evaluations per match, over that of the coarsest grid of its method."""
    least, own = number(coarsest(entries, entry).document, key), number(entry.document, key)
    return None if not least or own is None else float(own / least)


class Settings(Struct, frozen=True):
    """Effective settings by dotted key: those common to all runs, and those that differ, with one value per run."""

    common: list[tuple[str, str]]
    differing: list[tuple[str, list[str]]]


def settings(entries: Sequence[Entry]) -> Settings:
    """Compare the configurations of runs, without the sections of methods that no run used."""
    unused = {*METHODS} - {e.document.get("method") for e in entries}
    flat = [by_dotted_key(e.document.get("config") or {}) for e in entries]
    keys = [key for key in dict.fromkeys(k for f in flat for k in f) if key.partition(".")[0] not in unused]
    rows = [(key, [str(f.get(key, MISSING)) for f in flat]) for key in keys]
    common = [(key, values[0]) for key, values in rows if len(set(values)) == 1]
    return Settings(common, [(key, values) for key, values in rows if len(set(values)) > 1])


def inputs(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    """Return names and values of the log that the runs have in common, from the first of them."""
    log_input = entries[0].document.get("input") or {}
    wanted = ("path", "format", "topic", "frame_id", "duration_s", "size_bytes", "sha256")
    return [(key, str(log_input[key])) for key in wanted if log_input.get(key) is not None]


def versions(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    """Return the software of the runs with all versions of each."""
    runs = [e.document for e in entries]
    used = [{"mavnav": r.get("mavnav_version"), "python": r.get("python"), **(r.get("libraries") or {})} for r in runs]
    names = dict.fromkeys(name for one in used for name in one)
    return [(name, ", ".join(dict.fromkeys(str(one.get(name)) for one in used))) for name in names]


def commands(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    """Return pairs of a run and the command line that repeats it, for the runs that have one."""
    lines = [(entry.name, (entry.document.get("provenance") or {}).get("again")) for entry in entries]
    return [(name, str(line)) for name, line in lines if line]


def notes(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    """Return pairs of runs and the text of a warning or damage; equal texts of several runs are merged."""
    by_line: dict[str, list[str]] = {}
    for entry in entries:
        for line in _lines(entry.document):
            by_line.setdefault(line, []).append(entry.name)
    return [("all runs" if 1 < len(runs) == len(entries) else ", ".join(runs), line) for line, runs in by_line.items()]


def _lines(document: dict[str, Any]) -> Iterator[str]:
    yield from dict.fromkeys(map(str, document.get("warnings") or []))
    for damage in document.get("damage") or []:
        yield f"damage: {damage.get('what')}, {damage.get('where')}"


def slice_rows(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Return run, heights, occupied cells, and median and p95 of the wall thickness of each slice, and its length."""
    return [(e.name, *_slice_texts(layer)) for e in entries for layer in e.document.get("slices") or []]


def _slice_texts(layer: dict[str, Any]) -> list[str]:
    walls, heights = layer["wall_thickness"].get("2") or {}, f"{layer['from_m']:.2f} to {layer['to_m']:.2f}"
    thickness = [text(walls.get(key), digits) for key, digits in (("median_mm", 0), ("p95_mm", 0), ("length_m", 1))]
    return [heights, text(layer["occupied"], 0), *thickness]


def ghost_rows(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Return run, x, y, direction, length and offset of each ghost wall, as text; the longest of each run first."""
    keys = (("x_m", 2), ("y_m", 2), ("direction_deg", 0), ("length_m", 2), ("offset_mm", 0))
    longest = [(e.name, sorted(ghosts(e), key=lambda p: -p["length_m"])[:MAX_GHOSTS]) for e in entries]
    places = [(name, place) for name, several in longest for place in several]
    return [(name, *(text(place.get(key), digits) for key, digits in keys)) for name, place in places]
