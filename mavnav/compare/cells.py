"""Cells of a comparison: one log replayed with one setting, known by everything that decides its result."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mavnav import __version__, replay
from mavnav.logs import content_sha256
from mavnav.outputs.directory import RUN_FILE
from mavnav.references import References, load_references

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mavnav.config import Config
    from mavnav.jobs import Report

REFERENCES = ("truth", "truth_map", "relations")
"""Of a request: the files to compare the outcome with."""

_NOT_OPTIONS = {"log", "directory", "config", "force", "report", *REFERENCES}
"""Of a request: where things are, what does not change a result, and what enters the key by itself."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A replay to make or to find, and its key: SHA-256 of all that decides its result."""

    request: replay.Request
    key: str

    @property
    def config(self) -> Config:
        """Its configuration."""
        return self.request.config

    @property
    def name(self) -> str:
        """What people call it: ``drive.mcap robust 40/20x20``, azimuth grid before the grid as the paper writes."""
        return f"{self.request.log.name} {self.config.method} {self.config.azimuth}/{self.config.grid}"


def make_cells(
    logs: Iterable[Path], configs: Iterable[Config], options: Mapping[str, Any], directory: Path, *, force: bool
) -> list[Cell]:
    """Return every log with every configuration, logs first; what comes twice is one cell.

    ``options`` are further values of a `replay.Request`. Each cell has a run directory of its own below
    ``directory/cells``: ``<log>-<method>-<grid>-<the first 8 digits of its key>``. Raises UsageError for a log or
    another file that cannot be read.
    """
    found: dict[str, Cell] = {}
    digests = {log: content_sha256(log) for log in logs}
    references = references_sha256(load_references(**{name: options.get(name) for name in REFERENCES}))
    configs = list(configs)
    for log, digest in digests.items():
        for config in configs:
            request = replay.Request(log=log, directory=directory, config=config, force=force, **options)
            key = cell_key(request, digest, references)
            name = f"{replay.default_directory(log, config).name}-{key[:8]}"
            place = directory / "cells" / name
            request = replay.Request(log=log, directory=place, config=config, force=force, **options)
            found.setdefault(key, Cell(request, key))
    return list(found.values())


def cell_key(request: replay.Request, log_sha256: str, references: str) -> str:
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
    package = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for module in sorted(package.rglob("*.py")):
        digest.update(f"{module.relative_to(package).as_posix()}\n".encode() + module.read_bytes())
    return digest.hexdigest()


def earlier(cell: Cell) -> dict[str, Any] | None:
    """Return the document of a finished run of this cell; None where there is none, or none that can be read."""
    try:
        document = json.loads((cell.request.directory / RUN_FILE).read_bytes())
    except (OSError, ValueError):
        return None
    return document if isinstance(document, dict) and "exit_code" in document else None


def replay_cell(request: replay.Request, report: Report) -> dict[str, Any]:
    """Replay one cell and return its document; the job of a worker process, in which the kernels are loaded by now."""
    _, document = replay.replay(request, report, compile_s=0.0)
    return document
