"""The quantities by which runs are compared: how they are written, and which run is best."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from msgspec import Struct

from mavnav.errors import ExitCode
from mavnav.metrics import gates
from mavnav.metrics.gates import NO_MAP, VERDICTS, stored_verdict
from mavnav.outputs.documents.schema import number_schema

Run = Mapping[str, Any]

LEAST_MAPPED_SHARE: Final = 0.5
"""Where a run does not say itself whether its map means anything, it does not with fewer of the scans on it."""


UNUSABLE: Final = VERDICTS[2:]
"""Verdicts of runs that do not compete with others."""


class Quantity(Struct, frozen=True):
    """A number of run.json by its name there; title, description, unit and direction are those of the schema.

    It is written times ``factor`` with so many ``digits``, in ``shown_unit`` if that is another; what reads the same
    counts as the same. ``per_cell`` marks what depends on the cell size of the map, and cannot be compared between
    maps of different cells. Differences up to the share ``noise`` are none: so much another
    sample of the readings changes them (benchmarks/metric_noise.py). A ``cost`` is no virtue of the map; what
    is not ``ranked`` differs from one run to the next, and no run is the best by it. ``otherwise`` is a second name,
    of runs that do not have the first.
    """

    name: str
    digits: int
    factor: float = 1.0
    shown_unit: str | None = None
    per_cell: bool = False
    noise: float = 0.0
    cost: bool = False
    ranked: bool = True
    otherwise: str = ""

    @property
    def title(self) -> str:
        """The heading of its column."""
        return str(number_schema(self.name)["title"])

    @property
    def unit(self) -> str:
        """The unit it is written in; empty for a count or a ratio."""
        unit = str(number_schema(self.name).get("unit", "1")) if self.shown_unit is None else self.shown_unit
        return "" if unit == "1" else unit

    @property
    def better(self) -> int:
        """-1 where less is better, +1 where more is, 0 where neither."""
        return {"lower": -1, "higher": 1}.get(number_schema(self.name).get("better", ""), 0)

    @property
    def about(self) -> str:
        """What it is."""
        return str(number_schema(self.name)["description"])

    @property
    def head(self) -> str:
        """The title with the unit."""
        return f"{self.title} {self.unit}".rstrip()

    def of(self, run: Run | None) -> float | None:
        """Return the number of a run in the unit it is written in, None where there is none."""
        value = number(run, self.name)
        if value is None and self.otherwise:
            value = number(run, self.otherwise)
        return None if value is None else float(value) * self.factor

    def write(self, value: float | None) -> str:
        """Write a value of run.json, or a dash for none."""
        return "-" if value is None else f"{value * self.factor:.{self.digits}f}"

    def same(self, a: float, b: float) -> bool:
        """Return whether two values, in the unit they are written in, do not differ by more than the noise."""
        a, b = round(a, self.digits), round(b, self.digits)
        return abs(a - b) <= self.noise * min(abs(a), abs(b))

    def text_of(self, run: Run | None) -> str:
        """Write the number of a run, or a dash where there is none."""
        value = self.of(run)
        return "-" if value is None else f"{value:.{self.digits}f}"


QUANTITIES: Final = (
    Quantity("map.accepted_share", 1, 100.0, "%", noise=0.03),
    Quantity("wall_thickness.spread.median_mm", 0, per_cell=True, noise=0.03),
    Quantity("wall_thickness.spread.p95_mm", 0, per_cell=True, noise=0.09),
    Quantity("wall_thickness.paper_cells.max", 1, per_cell=True, noise=0.4),
    Quantity("map_quality.ghost_walls.length_m", 1),
    Quantity("map_quality.crispness.occupied_cells_per_m", 1, shown_unit="", per_cell=True, noise=0.06),
    Quantity("map_quality.crispness.entropy_bits", 3, per_cell=True, noise=0.03),
    Quantity("map_quality.revisits.nn_l_mm", 1, noise=0.07),
    Quantity("reference.ate.rmse_m", 0, 1e3, "mm", noise=0.05, otherwise="truth.ate_rmse_m"),
    Quantity("reference.map_distance.mean_mm", 0, noise=0.05),
    Quantity("search.evaluations_per_scan.mean", 0, cost=True),
    Quantity("timing.cpu_s", 2, cost=True, ranked=False),
)
"""The columns of a comparison."""

DOUBT: Final = Quantity("tracking.doubt.probability", 2, ranked=False)
PATH: Final = Quantity("tracking.path_length_m", 1)
TIME: Final = Quantity("timing.wall_s", 1, cost=True)
"""Quantities that are reported, but not compared."""

NAMED: Final = {quantity.name: quantity for quantity in QUANTITIES}


def without_search(document: dict[str, Any]) -> dict[str, Any]:
    """Return run.json of a run at given poses without what is mavnav's own: no search, and the time of drawing."""
    return {section: value for section, value in document.items() if section not in {"search", "timing"}}


def number(run: Run | None, name: str) -> float | None:
    """Return a number of run.json, None where there is no such number."""
    return None if run is None else gates.number(run, name)


def why_not_meaningful(run: Run) -> str:
    """Say why the map of a run is not to be compared with others; empty where it is."""
    quality = run.get("map_quality")
    if quality:
        why = [] if quality.get("meaningful") else list(map(str, quality.get("why") or ["no usable map"]))
        word, reason = verdict_texts(run)
        return "; ".join([*why, f"{word}: {reason}"] if word in UNUSABLE else why)
    if run.get("exit_code") == ExitCode.TRACKING_LOST or number(run, "tracking.lost"):
        return "the track was lost for good"
    if "map" not in run:
        return NO_MAP
    share = number(run, "map.accepted_share") or 0.0
    return "" if share >= LEAST_MAPPED_SHARE else f"only {100 * share:.0f} % of the scans were accepted"


def verdict_texts(run: Run | None) -> tuple[str, str]:
    """Return the word and the reason of the verdict on a run; both empty without one."""
    known = stored_verdict(run or {})
    return (known["word"], known["reason"]) if known else ("", "")


def comparable(quantity: Quantity, runs: Sequence[Run | None]) -> bool:
    """Return whether all ranked runs may be compared: by what is ``per_cell``, only if all have one cell size."""
    return not quantity.per_cell or len({_cell_mm(runs[k]) for k in ranked_values(quantity, runs)}) == 1


def winners(quantity: Quantity, runs: Sequence[Run | None]) -> list[int]:
    """Return which runs are best by a quantity, up to differences that do not count.

    Only meaningful maps compete, at least two; where it is ``per_cell``, those of each cell size among themselves.
    Nobody is best where all are equal.
    """
    values = ranked_values(quantity, runs)
    groups = by_cell_mm(runs).values() if quantity.per_cell else [values]
    return sorted(k for group in groups for k in _best(quantity, {k: values[k] for k in group if k in values}))


def ranked_values(quantity: Quantity, runs: Sequence[Run | None]) -> dict[int, float]:
    """Return the rounded values of the runs that are ranked by a quantity, by their index: those of meaningful maps."""
    known = {k: quantity.of(run) for k, run in enumerate(runs) if run is not None and not why_not_meaningful(run)}
    values = {k: round(value, quantity.digits) for k, value in known.items() if value is not None}
    return values if quantity.ranked else {}


def _best(quantity: Quantity, values: dict[int, float]) -> list[int]:
    top = max(values.values(), key=lambda value: quantity.better * value, default=0.0)
    best = [k for k, value in values.items() if quantity.same(value, top)]
    return best if len(best) < len(values) else []


def by_cell_mm(runs: Iterable[Run | None]) -> dict[float, list[int]]:
    """Return the indices of the meaningful maps by their cell size in mm, the largest first."""
    groups: dict[float, list[int]] = {}
    for k, run in enumerate(runs):
        if run is not None and not why_not_meaningful(run):
            groups.setdefault(_cell_mm(run), []).append(k)
    return dict(sorted(groups.items(), reverse=True))


def size_note(runs: Iterable[Run | None]) -> str:
    """Say that the cell sizes of the maps differ, and what is therefore not compared; empty where they do not."""
    groups = by_cell_mm(runs)
    if len(groups) < 2:
        return ""
    some = max(map(len, groups.values())) > 1
    how = "compared only among maps of the same cell size" if some else "not compared"
    sizes = [f"{cell_mm:g}" for cell_mm in groups]
    because = f"the cell sizes differ ({', '.join(sizes[:-1])} and {sizes[-1]} mm)"
    return f"wall thickness and crispness are {how}, because {because}"


def _cell_mm(run: Run | None) -> float:
    return float(number(run, "map.cell_mm") or 0.0)
