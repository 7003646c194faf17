"""The cache of finished runs: the key of a run is a hash of all inputs of its result."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import MsgspecError, Struct, convert
from msgspec.structs import asdict, replace

from mavnav.config.named_files import read_json
from mavnav.config.options import reference_files, run_options
from mavnav.errors import ExitCode, OutputError
from mavnav.ground_truth.references import References
from mavnav.outputs.directory import RUN_FILE, check_no_file, file_sha256
from mavnav.outputs.documents.run_json import RunDocument
from mavnav.outputs.writers import REPORT_FILE
from mavnav.pipelines.replay import ReplayRequest
from mavnav.pipelines.score import ScoreRequest
from mavnav.version import __version__

RUNS_FOLDER: Final = "cells"
"""Where in the directory of a comparison or a batch the directories of its runs are."""


class PlannedRun(Struct, frozen=True):
    """A replay to run or to read from the cache, and its key: the SHA-256 of all inputs of its result."""

    request: ReplayRequest
    key: str

    @property
    def directory(self) -> Path:
        """Its run directory."""
        return self.request.directory


def make_run(request: ReplayRequest, log_sha256: str, references: str) -> PlannedRun:
    """Return the run of a request, given the hashes of its log and of its references.

    Its run directory is ``<log>-<method>-<yaw samples>-<grid>-<the first 8 digits of its key>``, that of another
    program ``<log>-<program>-<digits>``, below ``request.directory/cells``.
    """
    key = run_key(request, log_sha256, references)
    directory = request.directory / RUNS_FOLDER / f"{request.usual_name}-{key[:8]}"
    return PlannedRun(replace(request, directory=directory, log_sha256=log_sha256), key)


def check_cache_directory(directory: Path, own_files: Sequence[str]) -> None:
    """Create the directory of a comparison or a batch; it may contain an earlier one, recognized by its files.

    Raises OutputError if it cannot be used, or if it contains files, but none of ``own_files``.
    """
    check_no_file(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        foreign = bool(names := {path.name for path in directory.iterdir()}) and not names & set(own_files)
    except OSError as error:
        raise OutputError(f"{directory} cannot be used: {error.strerror}; choose another with -o") from error
    if foreign:
        raise OutputError(f"{directory} holds other files (no {own_files[-1]}); choose another directory with -o")
    if not os.access(directory, os.W_OK | os.X_OK):
        raise OutputError(f"{directory} is not writable; choose another with -o")


def run_key(request: ReplayRequest, log_sha256: str, references: str) -> str:
    """Return the SHA-256 over the log's content, the effective configuration, options, references, and mavnav itself.

    Both the version of mavnav and the hash of its source are included, because the source changes between releases.
    """
    files = reference_files(request.options)
    document = {
        "mavnav": [__version__, source_sha256()],
        "log": log_sha256,
        "config": request.config.document(),
        "options": {name: value for name, value in run_options(request.options) if name not in files},
        "references": references,
        **({"program": request.programs[0].key()} if isinstance(request, ScoreRequest) else {}),
    }
    return hashlib.sha256(json.dumps(document, sort_keys=True, default=str).encode()).hexdigest()


def references_sha256(references: References) -> str:
    """Return the SHA-256 over the content of the references, independent of their files."""
    digest = hashlib.sha256()
    for name, known in asdict(references).items():
        for part, array in asdict(known).items() if known is not None else ():
            if isinstance(array, np.ndarray):
                digest.update(f"{name}.{part} {array.shape}\n".encode() + array.tobytes())
    return digest.hexdigest()


_ONLY_IN_WHEELS: Final = {"configs", "docs"}


@cache
def source_sha256() -> str:
    """Return the SHA-256 over the modules and data of this package, the same for a checkout and a wheel of it."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.*")):
        if file.suffix != ".pyc" and file.relative_to(package).parts[0] not in _ONLY_IN_WHEELS:
            digest.update(f"{file.relative_to(package).as_posix()}\n".encode() + file.read_bytes())
    return digest.hexdigest()


def finished_document(run: PlannedRun) -> dict[str, Any] | None:
    """Return run.json of a finished run; None if it is missing, cannot be read, or lacks what every run has."""
    try:
        document: dict[str, Any] = read_json(run.directory / RUN_FILE)
        convert(document | {"config": run.request.config}, RunDocument)
        ExitCode(document["exit_code"])
    except (OSError, ValueError, TypeError, MsgspecError):
        return None
    return document


def is_finished(run: PlannedRun) -> bool:
    """Return whether a run is finished: its run.json is whole, and its files are those whose digests are in it.

    With a report requested, that is there too. The files are read whole, as the log is for its own digest.
    """
    document = finished_document(run)
    if document is None or (run.request.report and not (run.directory / REPORT_FILE).is_file()):
        return False
    try:
        return all(file_sha256(run.directory / name) == digest for name, digest in document["outputs"].items())
    except (OSError, ValueError):
        return False
