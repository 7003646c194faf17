"""Runs of a comparison or a batch, known by all that decides their result, so that none is made twice."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav import __version__
from mavnav.errors import ExitCode, OutputError
from mavnav.ground_truth.references import References, load_references
from mavnav.logs import content_sha256
from mavnav.outputs.directory import RUN_FILE
from mavnav.pipelines import replay

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mavnav.config.models import Config
    from mavnav.jobs import Outcome, Report

SECTIONS: Final = (
    "scans",
    "tracking",
    "search",
    "map",
    "wall_thickness",
    "map_quality",
    "reference",
    "timing",
    "exit_code",
)
"""What the document of a comparison or a batch repeats of every run.json."""

REFERENCES = ("truth", "truth_map", "relations")
"""Of a request: the files to compare the outcome with."""

_NOT_OPTIONS = {"log", "log_sha256", "address", "directory", "config", "force", "report", *REFERENCES}
"""Of a request: where things are, what does not change a result, and what enters the key by itself."""


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """A replay to make or to find, and its key: SHA-256 of all that decides its result."""

    request: replay.Request
    key: str

    @property
    def config(self) -> Config:
        """Its configuration."""
        return self.request.config

    @property
    def name(self) -> str:
        """Its display name: ``drive.mcap robust 40/20x20``, azimuth grid before the grid as the paper writes."""
        return f"{self.request.log.name} {self.config.method} {self.config.azimuth}/{self.config.grid}"


def make_runs(
    logs: Iterable[Path], configs: Iterable[Config], options: Mapping[str, Any], directory: Path
) -> list[PlannedRun]:
    """Return every log with every configuration, logs first; what comes twice is one run.

    ``options`` are further values of a `replay.Request`. Each has a run directory of its own below
    ``directory/cells``: ``<log>-<method>-<grid>-<the first 8 digits of its key>``. Raises UsageError for a log or
    another file that cannot be read.
    """
    found: dict[str, PlannedRun] = {}
    references = references_sha256(load_references(**{name: options.get(name) for name in REFERENCES}))
    configs = list(configs)
    for log, digest in {log: content_sha256(log) for log in logs}.items():
        for config in configs:
            request = replay.Request(log=log, directory=directory, config=config, force=True, **options)
            cell = make_run(request, digest, references)
            found.setdefault(cell.key, cell)
    return list(found.values())


def make_run(request: replay.Request, log_sha256: str, references: str) -> PlannedRun:
    """Return the run of a request, given the hashes of its log and of its references.

    Its run directory lies below ``request.directory`` / ``cells``.
    """
    key = run_key(request, log_sha256, references)
    name = f"{replay.default_directory(request.log, request.config).name}-{key[:8]}"
    return PlannedRun(replace(request, directory=request.directory / "cells" / name, log_sha256=log_sha256), key)


def check_home(directory: Path, ours: Sequence[str]) -> None:
    """Make the directory that cells are to lie below; it may hold an earlier comparison or batch, known by its files.

    Raises OutputError where it cannot be used, or holds none of ``ours`` but something else.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        strange = bool(names := {path.name for path in directory.iterdir()}) and not names & set(ours)
    except OSError as error:
        raise OutputError(f"{directory} cannot be used: {error.strerror}; choose another with -o") from error
    if strange:
        raise OutputError(f"{directory} holds other files (no {ours[-1]}); choose another directory with -o")
    if not os.access(directory, os.W_OK | os.X_OK):
        raise OutputError(f"{directory} is not writable; choose another with -o")


def run_key(request: replay.Request, log_sha256: str, references: str) -> str:
    """Return the SHA-256 over the log's content, the effective configuration, options, references, and mavnav itself.

    Of mavnav the version and the source enter: between releases the version
    alone would pass off the results of earlier code.
    """
    document = {
        "mavnav": [__version__, source_sha256()],
        "log": log_sha256,
        "config": request.config.document(),
        "options": {f.name: _plain(getattr(request, f.name)) for f in fields(request) if f.name not in _NOT_OPTIONS},
        "references": references,
    }
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:  # noqa: ANN401  any option of a request
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def references_sha256(references: References) -> str:
    """Return the SHA-256 over what was read of the references, whatever files it stood in."""
    digest = hashlib.sha256()
    for name, known in ((f.name, getattr(references, f.name)) for f in fields(references)):
        for part in fields(known) if known is not None else ():
            if isinstance(array := getattr(known, part.name), np.ndarray):
                digest.update(f"{name}.{part.name} {array.shape}\n".encode() + array.tobytes())
    return digest.hexdigest()


@cache
def source_sha256() -> str:
    """Return the SHA-256 over all modules of this package."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for module in sorted(package.rglob("*.py")):
        digest.update(f"{module.relative_to(package).as_posix()}\n".encode() + module.read_bytes())
    return digest.hexdigest()


def earlier(cell: PlannedRun) -> dict[str, Any] | None:
    """Return the document of this run if it is finished; None where there is none, or none that can be read."""
    try:
        document: dict[str, Any] = json.loads((cell.request.directory / RUN_FILE).read_bytes())
        ExitCode(document["exit_code"])
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return document


def replay_run(request: replay.Request, report: Report) -> dict[str, Any]:
    """Replay one run and return its document; the job of a worker process, in which the kernels are loaded by now."""
    _, document = replay.replay(request, report, compile_s=0.0)
    return document


def run_row(
    cell: PlannedRun, outcome: Outcome | None, run: Mapping[str, Any] | None, directory: Path
) -> dict[str, Any]:
    """Describe a run: what it is, what became of it, and the sections of its run.json.

    ``outcome`` is None for a run that was there before, ``run`` for one that failed; directories are told from
    ``directory`` on.
    """
    status = "cached" if outcome is None else "failed" if run is None else "done"
    return {
        "name": cell.name,
        "log": str(cell.request.log),
        "method": cell.config.method,
        "grid": str(cell.config.grid),
        "azimuth": cell.config.azimuth,
        "key": cell.key,
        "status": status,
        "exit_code": int(run["exit_code"] if run else outcome.exit_code if outcome else ExitCode.BUG),
        "error": outcome.error if outcome and outcome.error else None,
        "directory": cell.request.directory.relative_to(directory).as_posix() if run else None,
        "run": {name: run[name] for name in SECTIONS if name in run} if run else None,
    }
