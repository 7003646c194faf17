"""Cases of a batch: every log with every setting, each with a name that stays from one batch to the next."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavnav.batch.find_logs import check_found, gather
from mavnav.batch.remote import fetched
from mavnav.batch.settings import formatted
from mavnav.errors import ExitCode, MavnavError, UsageError
from mavnav.ground_truth.references import load_references
from mavnav.ground_truth.topics import recorded_topic
from mavnav.jobs.run_cache import REFERENCES, PlannedRun, make_run, references_sha256
from mavnav.logs import content_sha256
from mavnav.metrics.gates import Gate, parse_gate
from mavnav.outputs.addresses import is_address, public_address
from mavnav.pipelines.replay import ReplayRequest
from mavnav.pose import Pose

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mavnav.batch.manifest import Entry
    from mavnav.batch.request import BatchRequest
    from mavnav.batch.settings import Setting
    from mavnav.jobs import Outcome
    from mavnav.pipelines.replay import Progress

BASELINE_GATE = "baseline"
"""The gate that holds where nothing is worse than in the baseline."""


@dataclass(frozen=True, slots=True)
class Case:
    """A log with a setting, and what must hold of it.

    ``run`` is None for a log that cannot be read; ``error`` and ``exit_code`` then say why. ``log`` is its display
    name. ``has_references``: its outcome is compared with ground truth. ``baseline_gate``: it may not be worse than in
    the baseline, whatever holds of others.
    """

    name: str
    log: str
    setting: Setting
    run: PlannedRun | None
    gates: tuple[Gate, ...] = ()
    accept: frozenset[int] = frozenset()
    has_references: bool = False
    baseline_gate: bool = False
    error: str = ""
    exit_code: ExitCode = ExitCode.DONE


@dataclass(frozen=True, slots=True)
class CaseResult:
    """How a case ended.

    ``outcome`` is None if nothing was run for it: its run was finished before, or its log cannot be read. ``document``
    is run.json, None without a run.
    """

    case: Case
    outcome: Outcome | None
    document: dict[str, Any] | None


def make_cases(request: BatchRequest, progress: Progress) -> list[Case]:
    """Return the cases of a request, logs first, in order.

    Every log is read once, for the hash of its content; one that cannot be read, or whose references cannot, is a case
    that has failed already. What several entries say of one case holds together. Raises UsageError for a gate that
    cannot be read, for two references, and for folders that cannot be read.
    """
    logs = [(entry, log) for entry in request.entries for log in _logs(request, entry)]
    names = display_names([log for _, log in logs])
    found: dict[str, Case] = {}
    for number, (entry, log) in enumerate(logs):
        progress("reading", number, len(logs) if len(logs) > 1 else None)
        for case in _cases(request, entry, log, names[log]):
            found[case.name] = _merged(found[case.name], case) if case.name in found else case
    return list(found.values())


def display_names(logs: Sequence[str]) -> dict[str, str]:
    """Return each log's display name: an address without its secrets, numbered where two then read the same."""
    found, taken = dict[str, str](), Counter[str]()
    for log in dict.fromkeys(logs):
        name = public_address(log) if is_address(log) else log
        taken[name] += 1
        found[log] = name if taken[name] == 1 else f"{name} ({taken[name]})"
    return found


def _logs(request: BatchRequest, entry: Entry) -> Sequence[str]:
    return gather(entry.log, request.base) if request.patterns else entry.log


def _merged(one: Case, other: Case) -> Case:
    """Return a case that two entries name, a pattern and then a path for one, with all that both say of it."""
    if one.has_references and other.has_references and one.run != other.run:
        raise UsageError(f"{one.name}: two entries compare it with different references; give it one")
    return replace(
        other if other.has_references else one,
        gates=tuple(dict.fromkeys((*one.gates, *other.gates))),
        accept=one.accept | other.accept,
        baseline_gate=one.baseline_gate or other.baseline_gate,
    )


def _cases(request: BatchRequest, entry: Entry, log: str, name: str) -> Iterator[Case]:
    """Return the cases of one log with its display name, one for each setting."""
    references = {name: request.base / file for name in REFERENCES if (file := getattr(entry, name))}
    topic = recorded_topic(str(entry.truth)) if entry.truth else None
    if topic:
        del references["truth"]
    shared: dict[str, Any] = {
        "log": name,
        "gates": tuple(parse_gate(text) for text in entry.gates if text != BASELINE_GATE),
        "accept": frozenset(entry.accept),
        "has_references": bool(references) or topic is not None,
        "baseline_gate": BASELINE_GATE in entry.gates,
    }
    try:
        digests = _digest(request, log), references_sha256(load_references(**references))
    except MavnavError as error:
        shared |= {"run": None, "error": str(error), "exit_code": error.exit_code}
        yield from (Case(_name(entry, name, setting), setting=setting, **shared) for setting in request.settings)
        return
    options = _reading(entry) | references | {"truth_topic": topic, "typed": request.typed}
    options |= {"report": request.report, "force": True}
    path, address = (Path(public_address(log)), log) if is_address(log) else (request.base / log, None)
    for setting in request.settings:
        wanted = ReplayRequest(path, request.directory, setting.config, address=address, **options)
        yield Case(_name(entry, name, setting), setting=setting, run=make_run(wanted, *digests), **shared)


def _digest(request: BatchRequest, log: str) -> str:
    """Return the hash of a log's content; one at an address is fetched for that."""
    if is_address(log):
        with fetched(log) as folder:
            return content_sha256(folder / public_address(log))
    path = request.base / log
    if request.patterns:
        check_found(log, path)
    return content_sha256(path)


def _name(entry: Entry, log: str, setting: Setting) -> str:
    """Name a case by its log, its setting, and how the log is read where that is given."""
    extrinsic = ",".join(f"{x:g}" for x in entry.extrinsic or ())
    reading = {"topic": entry.topic, "start_s": entry.start_s, "end_s": entry.end_s, "extrinsic": extrinsic}
    more = [f"{name}={formatted(value)}" for name, value in reading.items() if value not in {None, ""}]
    return " ".join([log, setting.name, *more, *(["strict"] if entry.strict else [])])


def _reading(entry: Entry) -> dict[str, Any]:
    """Return the values of a `ReplayRequest` that say how a log is read."""
    given = {name: getattr(entry, name) for name in ("topic", "start_s", "end_s", "strict")}
    return given | {"extrinsic": Pose(*entry.extrinsic) if entry.extrinsic else None}
