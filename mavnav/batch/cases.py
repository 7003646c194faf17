"""Cases of a batch: every log with every setting, each with a name that is the same in every batch."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct
from msgspec.structs import replace

from mavnav.batch.find_logs import check_found, find_logs
from mavnav.batch.remote import download
from mavnav.batch.request import format_value
from mavnav.config.options import OPTIONS, REFERENCES, reference_files, run_options
from mavnav.errors import ExitCode, MavnavError, UsageError
from mavnav.ground_truth.map_file import map_files
from mavnav.ground_truth.references import load_references
from mavnav.jobs.run_cache import PlannedRun, make_run, references_sha256
from mavnav.logs import content_sha256
from mavnav.metrics.gates import Gate, parse_gate
from mavnav.outputs.documents.addresses import is_address, public_address
from mavnav.pipelines.replay import ReplayRequest

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mavnav.batch.request import BatchLogs, BatchRequest, Setting
    from mavnav.jobs import Outcome
    from mavnav.profiling import Progress

BASELINE_GATE = "baseline"
"""Name of the gate that passes if nothing is worse than in the baseline."""


class Case(Struct, frozen=True):
    """A log with a setting, and its gates.

    ``run`` is None for a log that cannot be read; ``error`` and ``exit_code`` are then the reason. ``log`` is the
    display name. With ``has_references``, the result is compared with ground truth. With ``baseline_gate``, this case
    may not be worse than in the baseline, whether or not the batch has that gate.
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


class CaseResult(Struct, frozen=True):
    """Result of a case.

    ``outcome`` is None if no job was run: the run was finished before, or the log cannot be read. ``document`` is
    run.json, None without a run.
    """

    case: Case
    outcome: Outcome | None
    document: dict[str, Any] | None


def make_cases(request: BatchRequest, progress: Progress) -> list[Case]:
    """Return the cases of a request in order, all settings of the first log first.

    Every log is read once for the hash of its content. A log that cannot be read, or whose references cannot, gives
    failed cases. The gates and accepted exit codes of several entries for one case are combined. Raises UsageError for
    a gate that cannot be parsed, for different references of one case, and for folders that cannot be read.
    """
    logs = [(entry, log) for entry in request.entries for log in _logs(request, entry)]
    names = display_names([log for _, log in logs])
    cases: dict[str, Case] = {}
    for number, (entry, log) in enumerate(logs):
        progress("reading", number, len(logs) if len(logs) > 1 else None)
        for case in _cases(request, entry, log, names[log]):
            cases[case.name] = _combine_cases(cases[case.name], case) if case.name in cases else case
    return list(cases.values())


def display_names(logs: Sequence[str]) -> dict[str, str]:
    """Return each log's display name: an address without its secrets, numbered if two would be equal."""
    names, taken = dict[str, str](), Counter[str]()
    for log in dict.fromkeys(logs):
        name = public_address(log) if is_address(log) else log
        taken[name] += 1
        names[log] = name if taken[name] == 1 else f"{name} ({taken[name]})"
    return names


def _logs(request: BatchRequest, entry: BatchLogs) -> Sequence[str]:
    return find_logs(entry.log, request.base) if request.patterns else entry.log


def read_paths(request: BatchRequest) -> Iterator[Path]:
    """Yield the paths of the logs and references of a request, whether or not they exist."""
    for entry in request.entries:
        yield from (request.base / log for log in _logs(request, entry))
        yield from reference_files(entry.options).values()
        if truth_map := entry.options.get("truth_map"):
            yield from map_files(truth_map)


def _combine_cases(one: Case, other: Case) -> Case:
    """Merge two cases of one name, for example from a pattern and from a path, with the gates of both."""
    if one.has_references and other.has_references and one.run != other.run:
        raise UsageError(f"{one.name}: two entries compare it with different references; give it one")
    return replace(
        other if other.has_references else one,
        gates=tuple(dict.fromkeys((*one.gates, *other.gates))),
        accept=one.accept | other.accept,
        baseline_gate=one.baseline_gate or other.baseline_gate,
    )


def _cases(request: BatchRequest, entry: BatchLogs, log: str, name: str) -> Iterator[Case]:
    """Yield the cases of one log with its display name, one for each setting."""
    shared: dict[str, Any] = {
        "log": name,
        "gates": tuple(parse_gate(text) for text in entry.gates if text != BASELINE_GATE),
        "accept": frozenset(entry.accept),
        "has_references": not entry.options.keys().isdisjoint(REFERENCES),
        "baseline_gate": BASELINE_GATE in entry.gates,
    }
    try:
        digests = _digest(request, log), references_sha256(load_references(**reference_files(entry.options)))
    except MavnavError as error:
        shared |= {"run": None, "error": str(error), "exit_code": error.exit_code}
        yield from (Case(_name(entry, name, setting), setting=setting, **shared) for setting in request.settings)
        return
    path, address = (Path(public_address(log)), log) if is_address(log) else (request.base / log, None)
    more: dict[str, Any] = {"force": True, "report": request.report, "address": address, "typed": request.typed}
    for setting in request.settings:
        wanted = ReplayRequest(path, request.directory, setting.config, entry.options, **more)
        yield Case(_name(entry, name, setting), setting=setting, run=make_run(wanted, *digests), **shared)


def _digest(request: BatchRequest, log: str) -> str:
    """Return the hash of a log's content; a log at an address is downloaded for that."""
    if is_address(log):
        with download(log) as folder:
            return content_sha256(folder / public_address(log))
    path = request.base / log
    if request.patterns:
        check_found(log, path)
    return content_sha256(path)


def _name(entry: BatchLogs, log: str, setting: Setting) -> str:
    """Return the name of a case: its log, its setting, and the given options but for references."""
    options = ((n, value) for n, value in run_options(entry.options) if not OPTIONS[n].reference)
    more = (name if value is True else f"{name}={_short(value)}" for name, value in options)
    return " ".join([log, setting.name, *more])


def _short(value: object) -> str:
    return ",".join(f"{x:g}" for x in value) if isinstance(value, tuple) else format_value(value)
