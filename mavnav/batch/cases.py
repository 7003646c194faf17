"""Cases of a batch: every log with every setting, each with a name that stays from one batch to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavnav.batch.find_logs import check_found, gather, is_address
from mavnav.batch.remote import fetched
from mavnav.batch.settings import told
from mavnav.errors import ExitCode, MavnavError, UsageError
from mavnav.ground_truth.references import load_references
from mavnav.jobs.run_cache import PlannedRun, make_run, references_sha256
from mavnav.logs import content_sha256
from mavnav.metrics.gates import Gate, parse_gate
from mavnav.pipelines import replay
from mavnav.pose import Pose

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from mavnav.batch.manifest import Entry
    from mavnav.batch.settings import Setting
    from mavnav.pipelines.replay import Progress

BASELINE_GATE = "baseline"
"""The gate that holds where nothing is worse than in the baseline."""


@dataclass(frozen=True, slots=True)
class Case:
    """A log with a setting, and what must hold of it.

    ``cell`` is None for a log that cannot be read, which ``error`` and ``exit_code`` tell. ``log`` is what people call
    it; ``has_references`` says that its outcome is compared with some, ``baseline_gate`` that it may not be worse than
    in the baseline, whatever holds of others.
    """

    name: str
    log: str
    setting: Setting
    cell: PlannedRun | None
    gates: tuple[Gate, ...] = ()
    accept: frozenset[int] = frozenset()
    has_references: bool = False
    baseline_gate: bool = False
    error: str = ""
    exit_code: ExitCode = ExitCode.DONE


def make_cases(
    entries: Sequence[Entry], settings: Sequence[Setting], base: Path, common: Mapping[str, Any], progress: Progress
) -> list[Case]:
    """Return the cases of a batch, logs first, in order.

    ``common`` are values of every `replay.Request`, its directory for one. Every log is read once, for the hash
    of its content; one that cannot be read, or whose references cannot, is a case that has failed already. What several
    entries say of one case holds together. Raises UsageError for a gate that cannot be read, and for two references.
    """
    logs = [(entry, log) for entry in entries for log in gather(entry.log, base)]
    found: dict[str, Case] = {}
    for number, (entry, log) in enumerate(logs):
        progress("reading", number, len(logs))
        for case in _cases(entry, log, settings, base, common):
            found[case.name] = _joined(found[case.name], case) if case.name in found else case
    return list(found.values())


def _joined(one: Case, other: Case) -> Case:
    """Return a case that two entries name, a pattern and then a path for one, with all that both say of it."""
    if one.has_references and other.has_references and one.cell != other.cell:
        raise UsageError(f"{one.name}: two entries compare it with different references; give it one")
    return replace(
        other if other.has_references else one,
        gates=tuple(dict.fromkeys((*one.gates, *other.gates))),
        accept=one.accept | other.accept,
        baseline_gate=one.baseline_gate or other.baseline_gate,
    )


def _cases(
    entry: Entry, log: str, settings: Sequence[Setting], base: Path, common: Mapping[str, Any]
) -> Iterator[Case]:
    address = log if is_address(log) else None
    path = Path(log) if address else base / log
    gates = tuple(parse_gate(text) for text in entry.gates if text != BASELINE_GATE)
    files = _files(entry, base)
    shared: dict[str, Any] = {"log": log, "gates": gates, "accept": frozenset(entry.accept)}
    shared |= {"has_references": any(files.values()), "baseline_gate": BASELINE_GATE in entry.gates}
    options = {**common, **_reading(entry), **files, "address": address}
    try:
        digest = _digest(log, path, address)
        references = references_sha256(load_references(**files))
    except MavnavError as error:
        failed: dict[str, Any] = {"cell": None, "error": str(error), "exit_code": error.exit_code}
        yield from (Case(_name(entry, log, setting), setting=setting, **shared, **failed) for setting in settings)
        return
    for setting in settings:
        request = replay.Request(path, config=setting.config, **options)
        yield Case(_name(entry, log, setting), setting=setting, cell=make_run(request, digest, references), **shared)


def _digest(log: str, path: Path, address: str | None) -> str:
    """Return the hash of a log's content; one at an address is fetched for that."""
    if address is None:
        check_found(log, path)
        return content_sha256(path)
    with fetched(address) as folder:
        return content_sha256(folder / path)


def _name(entry: Entry, log: str, setting: Setting) -> str:
    """Name a case by its log, its setting, and how the log is read, if that is told."""
    extrinsic = ",".join(f"{x:g}" for x in entry.extrinsic or ())
    reading = {"topic": entry.topic, "start_s": entry.start_s, "end_s": entry.end_s, "extrinsic": extrinsic}
    besides = [f"{name}={told(value)}" for name, value in reading.items() if value not in {None, ""}]
    return " ".join([log, setting.name, *besides, *(["strict"] if entry.strict else [])])


def _reading(entry: Entry) -> dict[str, Any]:
    mounting = Pose(*entry.extrinsic) if entry.extrinsic else None
    return {
        "topic": entry.topic,
        "start_s": entry.start_s,
        "end_s": entry.end_s,
        "extrinsic": mounting,
        "strict": entry.strict,
    }


def _files(entry: Entry, base: Path) -> dict[str, Path | None]:
    named = {"truth": entry.truth, "truth_map": entry.truth_map, "relations": entry.relations}
    return {name: None if file is None else base / file for name, file in named.items()}
