"""Quality gates: bounds on the numbers of a run, such as ``wall_thickness.spread.p95_mm<=150``.

A gate names a number or a truth value of a document (run.json) by its keys, joined by dots. An unknown name raises a
UsageError with the nearest known name. A null value fails every gate. So does a metric of a map that is not meaningful:
an empty map has thin walls.
"""

from __future__ import annotations

import difflib
import operator
import re
from itertools import chain
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from mavnav.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

OPERATORS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}

DEFAULT_HITS: Final = "2"
"""Hit threshold of ``wall_thickness.p95_cells`` if the name does not include one."""

MAP_SECTIONS: Final = ("wall_thickness.", "map_quality.", "map.", "slices.", "reference.map_distance.")
"""Beginnings of the names of sections, or parts of them, that are not meaningful if the map is not."""

SKIPPED: Final = "scans.skipped"
SKIP_REASONS: Final = (
    *("empty", "non_finite_angle", "zero_angle_increment", "impossible_geometry", "no_valid_beam"),
    *("duplicate_stamp", "backward_stamp", "suspect", "implausible", "impossible_stamp", "outside_window"),
    "undecodable",
)
"""Reasons by which scans are counted; a document lists those that occurred, and the others count as 0."""

MAX_LISTED: Final = 8
"""Maximum number of names that the message for an unknown name lists."""

_GATE: Final = re.compile(r"\s*([\w./-]+?)\s*(<=|>=|==|!=|<|>)\s*(\S+)\s*")
_EXAMPLE: Final = "write for example --gate 'wall_thickness.spread.p95_mm<=150'"

Number = bool | int | float


class Gate(Struct, frozen=True):
    """A bound: the value of ``name`` compared with ``bound`` must hold; ``text`` is the gate as given."""

    text: str
    name: str
    comparison: str
    bound: Number


class GateResult(Struct, frozen=True):
    """Result of a gate: the value (None: null) and why it failed, empty if it passed."""

    gate: Gate
    value: Number | None
    why: str = ""

    @property
    def passed(self) -> bool:
        """Whether the gate holds."""
        return not self.why

    def row(self) -> dict[str, Any]:
        """Return the verdict as documents have it."""
        return {"gate": self.gate.text, "value": self.value, "passed": self.passed, "why": self.why}


def parse_gate(text: str, what: str = "--gate", example: str = _EXAMPLE) -> Gate:
    """Parse ``name OP bound``; raises UsageError, which says ``what`` is wrong and gives the ``example``."""
    match = _GATE.fullmatch(text)
    bound = None if match is None else _bound(match[3])
    if match is None or bound is None:
        raise UsageError(f"{what} {text!r} is not NAME, one of {' '.join(OPERATORS)}, and a number; {example}")
    return Gate(text.strip(), match[1], match[2], bound)


def _bound(text: str) -> Number | None:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        value = float(text)
    except ValueError:
        return None
    return None if value != value else value  # noqa: PLR0124  NaN compares with nothing


def judge(gates: Iterable[Gate], document: Mapping[str, Any]) -> list[GateResult]:
    """Return the verdicts of gates on a document; raises UsageError for a name that it does not have."""
    return [_judge(gate, document) for gate in gates]


def judge_some(gates: Iterable[Gate], document: Mapping[str, Any]) -> list[GateResult]:
    """Return the verdicts of gates on one of several documents; a missing number fails its gate."""
    return [
        _judge(gate, document) if _has(document, gate.name) else GateResult(gate, None, "this run has no such number")
        for gate in gates
    ]


def check_known(gates: Iterable[Gate], documents: Sequence[Mapping[str, Any]]) -> None:
    """Raise UsageError for a name that none of the documents has."""
    for gate in gates:
        if documents and not any(_has(document, gate.name) for document in documents):
            find(documents[0], gate.name)


def _has(document: Mapping[str, Any], name: str) -> bool:
    try:
        find(document, name)
    except UsageError:
        return False
    return True


def _judge(gate: Gate, document: Mapping[str, Any]) -> GateResult:
    value = find(document, gate.name)
    if value is None:
        return GateResult(gate, None, "it is not known for this run")
    if _about_a_meaningless_map(gate.name, document):
        reasons = "; ".join(map(str, document["map_quality"].get("why") or ["too little of it"]))
        return GateResult(gate, value, f"it is {_format(value)}, but the map is not meaningful: {reasons}")
    return GateResult(gate, value, "" if OPERATORS[gate.comparison](value, gate.bound) else f"it is {_format(value)}")


def _about_a_meaningless_map(name: str, document: Mapping[str, Any]) -> bool:
    about_the_map = name.startswith(MAP_SECTIONS) and name != "map_quality.meaningful"
    return about_the_map and (document.get("map_quality") or {}).get("meaningful", True) is False


def _format(value: Number) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.6g}"


def check_names(names: Iterable[str], known: Iterable[str], example: str = _EXAMPLE) -> None:
    """Raise UsageError for a name that no document can have, before there is one.

    ``known`` are the possible names, with ``*`` for any key or index of a list; ``example`` is what an option with
    such a name looks like.
    """
    skipped = [f"{SKIPPED}.{reason}" for reason in SKIP_REASONS]
    named = chain.from_iterable(skipped if name == f"{SKIPPED}.*" else (name,) for name in known)
    patterns = [name.split(".") for name in named]
    for name in names:
        if not any(_fits(_parts(name), pattern) for pattern in patterns):
            whole = [".".join(pattern) for pattern in patterns if "*" not in pattern]
            raise UsageError(_unknown(name, whole, example))


def _fits(parts: Sequence[str], pattern: Sequence[str]) -> bool:
    return len(parts) == len(pattern) and all(known in ("*", part) for part, known in zip(parts, pattern, strict=True))


def find(document: Mapping[str, Any], name: str) -> Number | None:
    """Return the number of that name; None if it or a parent is null, or if it is NaN; 0 for an unused skip reason.

    Raises UsageError for a name that the document does not have, or that is no number.
    """
    value: Any = document
    for part in _parts(name):
        if value is None:
            return None
        value = _child(value, part)
    if value is _NOTHING and _did_not_occur(document, name):
        return 0
    if value is None or isinstance(value, Number):
        return None if value != value else value  # noqa: PLR0124  NaN compares with nothing
    raise UsageError(_unknown(name, names(document)))


_NOTHING: Final = object()
"""Mark of a missing key."""


def _did_not_occur(document: Mapping[str, Any], name: str) -> bool:
    """Return whether a name is that of a reason for which this document has skipped no scan."""
    section, _, reason = name.rpartition(".")
    return section == SKIPPED and reason in SKIP_REASONS and isinstance(_child(document.get("scans"), "skipped"), dict)


def _child(value: object, part: str) -> object:
    """Return the value of a key of a dictionary, or of an index of a list; `_NOTHING` if there is none."""
    if isinstance(value, list) and part.isdecimal() and int(part) < len(value):
        return value[int(part)]
    return value.get(part, _NOTHING) if isinstance(value, dict) else _NOTHING


def full_name(name: str) -> str:
    """Return a name with the hit threshold of wall thickness, which may have been left out."""
    return ".".join(_parts(name))


def _parts(name: str) -> list[str]:
    """Return the parts of a name, with the hit threshold of wall thickness if it was left out."""
    first, *rest = name.split(".")
    if first == "wall_thickness" and len(rest) == 1 and not rest[0].isdecimal():
        rest.insert(0, DEFAULT_HITS)
    return [first, *rest]


def names(document: Mapping[str, Any]) -> list[str]:
    """Return the names of all numbers of a document, nulls included, as they are written in a gate."""
    return [".".join(parts) for parts in _leaves(document)]


def _leaves(value: object) -> Iterator[tuple[str, ...]]:
    if value is None or isinstance(value, Number):
        yield ()
    children = enumerate(value) if isinstance(value, list) else value.items() if isinstance(value, dict) else ()
    for key, child in children:
        for rest in _leaves(child):
            yield (str(key), *rest)


def _unknown(name: str, known: Sequence[str], example: str = _EXAMPLE) -> str:
    """Return the message for an unknown name with the nearest known one: a child, or a similar name or last part.

    If there is none, the message lists the names beside it.
    """
    if name.startswith("reference") and not any(k.startswith("reference.") for k in known):
        return f"no number {name} in run.json; it needs --truth, --truth-map or --relations"
    full = full_name(name)
    near = [k for k in known if k.startswith(f"{full}.")]
    usual = f"wall_thickness.{DEFAULT_HITS}."
    short = [k.replace(usual, "wall_thickness.") for k in known if k.startswith(usual)]
    near = near or difflib.get_close_matches(full, [*known, *short], n=1, cutoff=0.75)
    if not near:
        last = difflib.get_close_matches(name.rpartition(".")[2], {k.rpartition(".")[2] for k in known}, n=1)
        near = [k for k in known if last and k.rpartition(".")[2] == last[0]]
    if near:
        return f"no number {name} in run.json; did you mean {near[0]}?"
    section = name.rpartition(".")[0]
    beside = [k.rpartition(".")[2] for k in known if section and k.rpartition(".")[0] == section]
    if 0 < len(beside) <= MAX_LISTED:
        return f"no number {name} in run.json; {section} has {', '.join(beside)}"
    return f"no number {name} in run.json; the numbers of any run.json can be named, {example}"
