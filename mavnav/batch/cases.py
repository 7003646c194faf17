"""Cases of a batch: every log with every setting, each with a name that is the same in every batch.

The logs are given by paths, patterns, folders and addresses.
"""

from __future__ import annotations

import os
import re
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from msgspec import Struct, field
from msgspec.structs import replace

from mavnav.batch.remote import download, pinned_file
from mavnav.batch.request import BatchLogs, BatchRequest, Setting, format_value
from mavnav.config.options import OPTIONS, REFERENCES, reference_files, run_options
from mavnav.errors import ExitCode, MavnavError, NoScansError, UsageError
from mavnav.ground_truth.map_file import map_files
from mavnav.ground_truth.references import load_references
from mavnav.jobs.run_cache import PlannedRun, make_run, references_sha256
from mavnav.jobs.worker import Outcome
from mavnav.logs import content_sha256
from mavnav.logs.formats.detect import SUFFIXES, is_named_like_a_log
from mavnav.metrics.gates import Gate, parse_gate, read_accept
from mavnav.outputs.directory import document_of
from mavnav.outputs.documents.addresses import is_address, public_address
from mavnav.pipelines.replay import ReplayRequest
from mavnav.pipelines.score import ScoreRequest, scored_options
from mavnav.profiling import Progress

_PATTERN: Final = re.compile(r"[*?[]")


def find_logs(patterns: Iterable[str], base: Path) -> list[str]:
    """Return the logs that paths, patterns, folders and addresses refer to, each once and in order.

    A pattern (``*``, ``?``, ``[...]``, ``**``) gives the matching paths sorted by name, without hidden files and
    results of runs. A folder gives the logs in it and in its subfolders, including ROS 2 bags, without finished runs;
    links to folders are followed, but each folder counts once. A path or pattern that matches nothing is returned
    unchanged, so that only its own case fails. Relative paths start at ``base``; returned paths below ``base`` are
    relative to it. Raises UsageError for a folder that cannot be read.
    """
    logs: dict[str, None] = {}
    for pattern in patterns:
        try:
            logs.update(dict.fromkeys([pattern] if is_address(pattern) else _paths(pattern, base)))
        except OSError as error:
            place = error.filename or pattern
            raise UsageError(f"{place} cannot be read: {error.strerror}; name other logs") from error
    return list(logs)


def check_found(log: str, path: Path) -> None:
    """Raise NoScansError for a folder without logs, and UsageError for a pattern that matches nothing.

    ``log`` is a result of `find_logs`, and ``path`` its path.
    """
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        kinds = ", ".join(SUFFIXES)
        raise NoScansError(f"{log}: no logs in this folder ({kinds}; finished runs are left out); name another")
    if _PATTERN.search(log) and not path.exists():
        raise UsageError(f"{log}: nothing fits this pattern; ** in it stands for any folders")


def _paths(pattern: str, base: Path) -> list[str]:
    matches = _matches(pattern, base)
    logs = _logs_in(matches)
    rest = [match for match in matches if not any(path.is_relative_to(match) for path in logs)]
    return [_relative(path, base) for path in sorted([*logs, *(match for match in rest if not _logs_in([match]))])]


def _matches(pattern: str, base: Path) -> list[Path]:
    """Return the paths that a pattern matches; an existing path with brackets in its name is no pattern."""
    whole = base / pattern
    if whole.exists() or not _PATTERN.search(pattern):
        return [whole]
    anchor = Path(whole.anchor)
    paths = anchor.glob(str(whole.absolute().relative_to(anchor.absolute())))
    return sorted(path for path in paths if not _is_hidden(path, whole) and not _is_result(path)) or [whole]


def _is_hidden(path: Path, pattern: Path) -> bool:
    """Return whether a path has a hidden part that the pattern does not name; unfinished runs are hidden."""
    return any(part.startswith(".") and part not in pattern.parts for part in path.parts)


def _is_result(path: Path) -> bool:
    """Return whether a log is the result of a run, or a session of a merge."""
    return (path.name == "result.mcap" or path.name.startswith("session_")) and document_of(path.parent) is not None


def _logs_in(paths: Sequence[Path]) -> list[Path]:
    """Return files as they are, and the logs in folders and their subfolders, sorted.

    Each folder is visited once, however many links lead to it; by a path without links if there is one.
    """
    logs, visited = list[Path](), set[str]()
    waiting = deque(sorted(paths, key=lambda path: sum(part.is_symlink() for part in (path, *path.parents))))
    while waiting:
        path = waiting.popleft()
        folder = path.is_dir()
        place = os.path.realpath(path) if folder else f"{os.path.realpath(path.parent)}/{path.name}"
        if place in visited:
            continue
        visited.add(place)
        if not folder or (path / "metadata.yaml").is_file():
            logs.append(path)
        elif not document_of(path):
            shown = (each for each in path.iterdir() if not each.name.startswith("."))
            inner = [each for each in shown if each.is_dir() or is_named_like_a_log(each)]
            waiting.extendleft(each for each in inner if not each.is_symlink())
            waiting.extend(each for each in inner if each.is_symlink())
    return sorted(logs)


def _relative(path: Path, base: Path) -> str:
    """Return the name of a path, the same for ``a`` and ``x/../a`` unless ``x`` is a link to elsewhere."""
    straight, whole = Path(os.path.normpath(path.absolute())), base.absolute()
    same = os.path.realpath(straight) == os.path.realpath(path)
    for each in (straight, path.absolute()) if same else (path.absolute(),):
        if each.is_relative_to(whole):
            return each.relative_to(whole).as_posix()
    return path.as_posix()


BASELINE_GATE = "baseline"
"""Name of the gate that passes if nothing is worse than in the baseline."""


class Case(Struct, frozen=True):
    """A log with a setting, and its gates.

    ``run`` is None for a log that cannot be read; ``error`` and ``exit_code`` are then the reason. ``log`` is the
    display name. With ``has_references``, the result is compared with ground truth. With ``baseline_gate``, this case
    may not be worse than in the baseline, whether or not the batch has that gate. ``licence`` and ``peers`` are those
    of the log. A repetition names the case that it repeats, a run at given poses the
    ``given`` trajectory.
    """

    name: str
    log: str
    setting: Setting
    run: PlannedRun | None
    gates: tuple[Gate, ...] = ()
    accept: frozenset[int | str] = frozenset()
    has_references: bool = False
    baseline_gate: bool = False
    error: str = ""
    exit_code: ExitCode = ExitCode.DONE
    licence: str = ""
    peers: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    repeat_of: str = ""
    given: str = ""

    @property
    def external(self) -> str:
        """The name of the program or the ``given`` trajectory that the poses are of; empty for mavnav's own."""
        return self.setting.program.name if self.setting.program else self.given


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
    a gate that cannot be parsed, for two logs of one name, different references of one case, and for folders that
    cannot be read.
    """
    logs = [(entry, log) for entry in request.entries for log in _logs(request, entry)]
    names = display_names([log for _, log in logs])
    cases, named = dict[str, Case](), dict[str, str]()
    for number, (entry, log) in enumerate(logs):
        progress("reading", number, len(logs) if len(logs) > 1 else None)
        name = entry.name or names[log]
        if (other := named.setdefault(name, log)) != log:
            two = " and ".join(map(public_address, (other, log)))
            raise UsageError(f"two logs are named {name!r}, {two}; give each a name of its own")
        for case in _cases(request, entry, log, name, progress):
            cases[case.name] = _combine_cases(cases[case.name], case) if case.name in cases else case
    return [each for case in cases.values() for each in _repeat(case, request.repeat)]


def _repeat(case: Case, times: int) -> Iterator[Case]:
    """Yield a case as often as given; the repetitions are named ``#2`` and on, with directories of their own."""
    yield case
    if (run := case.run) is None:
        return
    for k in range(2, times + 1):
        directory = run.directory.with_name(f"{run.directory.name}-{k}")
        again = replace(run, request=replace(run.request, directory=directory))
        yield replace(case, name=f"{case.name} #{k}", run=again, repeat_of=case.name)


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


def _cases(request: BatchRequest, entry: BatchLogs, log: str, name: str, progress: Progress) -> Iterator[Case]:
    """Yield the cases of one log with its display name, one for each setting."""
    shared: dict[str, Any] = {
        "log": name,
        "gates": tuple(parse_gate(text) for text in entry.gates if text != BASELINE_GATE),
        "accept": frozenset(map(read_accept, entry.accept)),
        "has_references": not entry.options.keys().isdisjoint(REFERENCES),
        "baseline_gate": BASELINE_GATE in entry.gates,
        "licence": entry.licence,
        "peers": entry.peers,
    }
    try:
        log = str(pinned_file(log, entry.pin, request.copies, progress).absolute()) if entry.pin else log
        digests = _digest(request, log), references_sha256(load_references(**reference_files(entry.options)))
    except MavnavError as error:
        shared |= {"run": None, "error": str(error), "exit_code": error.exit_code}
        yield from (Case(_name(entry, name, setting), setting=setting, **shared) for setting in request.settings)
        return
    path, address = (Path(public_address(log)), log) if is_address(log) else (request.base / log, None)
    more: dict[str, Any] = {"force": True, "report": request.report, "address": address, "typed": request.typed}
    for setting in request.settings:
        given, program = (path, request.directory, setting.config), setting.program
        if program:
            own = {"programs": (program,), "limit_s": request.limits.program_s, "alone": True}
            wanted: ReplayRequest = ScoreRequest(*given, scored_options(entry.options), **more | own)
        else:
            wanted = ReplayRequest(*given, entry.options, **more)
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
