"""Quality gates: bounds on the numbers of a run, such as ``wall_thickness.p95_mm<=150``.

A gate names a number or a truth value of a document (run.json) by its keys, joined by dots. An unknown name raises a
UsageError with the nearest known name. A null value fails every gate. So does a metric of a map that is not meaningful:
an empty map has thin walls. The gate ``verdict`` holds for a good and a suspect run, ``verdict==good`` for a good one.
"""

from __future__ import annotations

import difflib
import operator
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, Final

from msgspec import Struct

from mavnav.errors import ExitCode, UsageError

OPERATORS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}

VERDICTS: Final = ("good", "suspect", "wrong", "lost")
"""The words of a verdict, from good to bad."""

VERDICT, USUAL = "verdict", "suspect"
"""The gate on the verdict, and the worst word for which it holds unless it names another."""

SPREAD: Final = ("median_mm", "p95_mm", "median_cells", "p95_cells", "length_m", "measured_share")
"""Names below ``wall_thickness`` that mean those of ``wall_thickness.spread``."""

BY_HITS: Final = "hits_"
"""What stands before the hit threshold of a wall thickness in a gate: ``hits_2`` is the key "2" of run.json."""

BARE, DEFAULT_HITS = ("max_mm", "max_cells", "sections", "share"), "2"
"""Old names below ``wall_thickness`` without a hit threshold, and the one that is meant."""

HEADLINES: Final = (
    "verdict", "map.accepted_share", "tracking.lost", "tracking.tracked_share", "tracking.doubt.probability",
    "wall_thickness.p95_mm", "wall_thickness.median_mm", "map_quality.ghost_walls.count",
    "map_quality.revisits.nn_l_mm", "reference.ate.rmse_m", "reference.map_distance.mean_mm",
)  # fmt: skip
"""The names that a hint prefers where several are near."""

OF_MAP: Final = ("wall_thickness", "map_quality", "map")
"""Sections that a run has if its map is drawn and measured."""

NO_MAP: Final = "the run has no map; repeat its command with --force, without --outputs"

MAP_SECTIONS: Final = (*(f"{name}." for name in OF_MAP), "slices.", "reference.map_distance.")
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
_EXAMPLE: Final = "write for example --gate 'wall_thickness.p95_mm<=150'"

Number = bool | int | float


class Gate(Struct, frozen=True):
    """A bound: the value of ``name`` compared with ``bound`` must hold; ``text`` is the gate as given."""

    text: str
    name: str
    comparison: str
    bound: Number


GateRow = dict[str, Any]
"""The result of a gate as documents have it.

``gate`` is its text, ``value`` what is compared (None: null; a verdict is a word), ``passed`` whether it holds, and
``why`` the reason why it failed, empty if it passed.
"""


def _row(gate: Gate, value: Number | str | None, why: str = "") -> GateRow:
    return {"gate": gate.text, "value": value, "passed": not why, "why": why}


def failure_text(row: Mapping[str, Any]) -> str:
    """Say why a gate failed, given its row in a document; that on the verdict is said in the words of the verdict."""
    return row["why"] if row["value"] in VERDICTS else f"gate {row['gate']} failed: {row['why']}"


def parse_gate(text: str, what: str = "--gate", example: str = _EXAMPLE) -> Gate:
    """Parse ``name OP bound``; raises UsageError, which says ``what`` is wrong and gives the ``example``."""
    match = _GATE.fullmatch(f"{VERDICT}<={USUAL}" if text.strip() == VERDICT else text)
    if match and match[1] == VERDICT and match[3] not in VERDICTS:
        raise UsageError(f"{what} {text!r}: {match[3]} is no verdict; they are {', '.join(VERDICTS)}")
    bound = None if match is None else _bound(match[3])
    if match is None or bound is None:
        raise UsageError(f"{what} {text!r} is not NAME, one of {' '.join(OPERATORS)}, and a number; {example}")
    return Gate(text.strip(), match[1], match[2], bound)


def _bound(text: str) -> Number | None:
    """Return a number or a truth value, of a verdict its place from good to bad."""
    if text in VERDICTS:
        return VERDICTS.index(text)
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        value = float(text)
    except ValueError:
        return None
    return None if value != value else value  # noqa: PLR0124  NaN compares with nothing


def judge(gates: Iterable[Gate], document: Mapping[str, Any]) -> list[GateRow]:
    """Return the verdicts of gates on a document; raises UsageError for a name that it does not have."""
    return [_judge(gate, document) for gate in gates]


def judge_some(gates: Iterable[Gate], document: Mapping[str, Any]) -> list[GateRow]:
    """Return the verdicts of gates on one of several documents; a missing number fails its gate."""
    return [
        _judge(gate, document) if _has(document, gate.name) else _row(gate, None, "this run has no such number")
        for gate in gates
    ]


def stored_verdict(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the verdict in a document; None without one, as of earlier versions, and if it is none."""
    known = document.get(VERDICT)
    texts = [known.get(key) for key in ("word", "reason", "advice")] if isinstance(known, dict) else [None]
    return dict(known) if all(isinstance(t, str) for t in texts) and texts[0] in VERDICTS else None  # type: ignore[arg-type]


def judge_verdict(accept: Collection[int | str], document: Mapping[str, Any]) -> list[GateRow]:
    """Return whether the verdict of a run is accepted: `USUAL` or better without a word in ``accept``.

    That are words and exit codes; of several words the worst counts. Nothing is returned for a lost run where its exit
    code is accepted, and for a run without a verdict, of an earlier version.
    """
    known = stored_verdict(document)
    if not known or (known["word"] == VERDICTS[-1] and accepts_code(accept, ExitCode.TRACKING_LOST)):
        return []
    words = [word for word in VERDICTS if word in accept] or [USUAL]
    return judge([parse_gate(f"{VERDICT}<={words[-1]}")], document)


def read_accept(given: int | str, what: str = "--accept") -> int | str:
    """Return an exit code or the word of a verdict; raises UsageError for what is neither, and says ``what`` it is."""
    code = int(given) if str(given).isdecimal() else None
    if given in VERDICTS or code in {*ExitCode}:
        return given if code is None else code
    kinds = f"no exit code of mavnav (see docs/cli.md) and no verdict ({', '.join(VERDICTS)})"
    raise UsageError(f"{what} {given}: {kinds}")


def accepts_code(accept: Collection[int | str], code: int) -> bool:
    """Return whether an exit code counts as done: that of a lost run does where its verdict is accepted."""
    return code in accept or (code == ExitCode.TRACKING_LOST and VERDICTS[-1] in accept)


def check_known(gates: Iterable[Gate], documents: Sequence[Mapping[str, Any]]) -> None:
    """Raise UsageError for a name that none of the documents has."""
    for gate in gates:
        if documents and not any(_has(document, gate.name) for document in documents):
            find(documents[0], gate.name)


def _has(document: Mapping[str, Any], name: str) -> bool:
    value = _value(document, name)
    return value is None or isinstance(value, Number)


def _judge(gate: Gate, document: Mapping[str, Any]) -> GateRow:
    value = find(document, gate.name)
    if value is None:
        return _row(gate, None, "it is not known for this run")
    if gate.name == VERDICT:
        passed, known = OPERATORS[gate.comparison](value, gate.bound), document[VERDICT]
        return _row(gate, known["word"], "" if passed else f"{known['word']}: {known['reason']}")
    about_map = gate.name.startswith(MAP_SECTIONS) and gate.name != "map_quality.meaningful"
    if about_map and (document.get("map_quality") or {}).get("meaningful", True) is False:
        reasons = "; ".join(map(str, document["map_quality"].get("why") or ["too little of it"]))
        return _row(gate, value, f"it is {_format(value)}, but the map is not meaningful: {reasons}")
    return _row(gate, value, "" if OPERATORS[gate.comparison](value, gate.bound) else f"it is {_format(value)}")


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
        if name != VERDICT and not any(_fits(_parts(name), pattern) for pattern in patterns):
            whole = [".".join(pattern) for pattern in patterns if "*" not in pattern]
            raise UsageError(_unknown(name, whole, example))


def _fits(parts: Sequence[str], pattern: Sequence[str]) -> bool:
    return len(parts) == len(pattern) and all(known in ("*", part) for part, known in zip(parts, pattern, strict=True))


def find(document: Mapping[str, Any], name: str) -> Number | None:
    """Return the number of that name; None if it or a parent is null, or if it is NaN; 0 for an unused skip reason.

    The number of a verdict is its place from good to bad. Raises UsageError for a name that the document does
    not have, or that is no number.
    """
    value = _value(document, name)
    if value is None or isinstance(value, Number):
        return value
    raise UsageError(_unknown(name, names(document)))


def number(document: Mapping[str, Any], name: str) -> Number | None:
    """Return the same as `find`, but None where that raises: of many names, most are not in every document."""
    value = _value(document, name)
    return value if isinstance(value, Number) else None


def _value(document: Mapping[str, Any], name: str) -> object:
    """Return the value of that name, None for NaN, `_NOTHING` if there is none."""
    value: Any = document
    if name == VERDICT and (known := stored_verdict(document)):
        return VERDICTS.index(known["word"])
    for part in _parts(name):
        if value is None:
            return None
        value = _child(value, part)
    if value is _NOTHING and _did_not_occur(document, name):
        return 0
    return None if value != value else value  # noqa: PLR0124  NaN compares with nothing


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
    """Return a name with all keys of run.json."""
    return ".".join(_parts(name))


def _parts(name: str) -> list[str]:
    """Return the keys of a name: those of the wall thickness may be left out, or have an older or clearer name."""
    first, *rest = name.split(".")
    if first == "wall_thickness" and rest:
        rest[0] = rest[0].removeprefix(BY_HITS)
        section = "spread" if rest[0] in SPREAD else DEFAULT_HITS if rest[0] in BARE else ""
        rest = [section, *rest] if section else rest
    return [first, *rest]


def clear_name(name: str) -> str:
    """Return the name that says what a wall thickness is measured on; other names as they are."""
    first, *rest = _parts(name)
    if first != "wall_thickness" or len(rest) < 2:
        return name
    rest = rest[1:] if rest[0] == "spread" else [f"{BY_HITS}{rest[0]}", *rest[1:]] if rest[0].isdecimal() else rest
    return ".".join([first, *rest])


def renaming(name: str) -> str:
    """Say that a name is an old one; empty if it is not."""
    clear = clear_name(name)
    return "" if name == clear or ".spread." in name else f"{name} is an old name of {clear}"


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

    Of several, a headline is preferred. If there is none, the message lists the names beside it.
    """
    if name.startswith(("reference", "ate", "rpe")) and not any(k.startswith("reference.") for k in known):
        return f"no number {name} in run.json; it needs --truth, --truth-map or --relations"
    if name.startswith(MAP_SECTIONS) and not any(k.startswith(MAP_SECTIONS) for k in known):
        return f"no number {name} in run.json; {NO_MAP}"
    shown = list(dict.fromkeys(map(clear_name, known)))
    headlines = [k for k in HEADLINES if k in shown]
    shown = [*headlines, *(k for k in shown if k not in headlines)]
    near = [k for k in shown if k.startswith(f"{clear_name(name)}.")]
    near = near or difflib.get_close_matches(name, headlines, n=1, cutoff=0.85)
    near = near or [k for k in headlines if k.startswith(f"{name}_")]
    near = near or difflib.get_close_matches(name, shown, n=1, cutoff=0.75)
    if not near:
        last = difflib.get_close_matches(name.rpartition(".")[2], {k.rpartition(".")[2] for k in shown}, 1, cutoff=0.7)
        near = [k for k in shown if last and k.rpartition(".")[2] == last[0]]
    if near:
        return f"no number {name} in run.json; did you mean {near[0]}?"
    section = name.rpartition(".")[0]
    beside = [k.rpartition(".")[2] for k in shown if section and k.rpartition(".")[0] == section]
    if 0 < len(beside) <= MAX_LISTED:
        return f"no number {name} in run.json; {section} has {', '.join(beside)}"
    return f"no number {name} in run.json; the numbers of any run.json can be named, {example}"
