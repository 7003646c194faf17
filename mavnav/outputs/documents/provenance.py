"""Where a run comes from: what was typed, when, and on which machine. Never part of what a run is compared by."""

from __future__ import annotations

import os
import platform
import shlex
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Final

from msgspec import Struct, field

from mavnav.outputs.documents.addresses import public_word
from mavnav.outputs.documents.run_json import Host, Provenance
from mavnav.outputs.documents.sections import Options
from mavnav.version import installed_version

LIBRARIES: Final = ("numpy", "numba", "scipy", "mcap", "rosbags", "pillow", "msgspec", "pyyaml")


def _folder() -> str | None:
    """Return the current folder, None where it is gone."""
    try:
        return str(Path.cwd())
    except OSError:
        return None


class Typed(Struct, frozen=True):
    """What the user typed: the command line in words, of it the configuration and the ``--set`` values, and where."""

    words: tuple[str, ...] = ()
    config: str | None = None
    sets: tuple[str, ...] = ()
    folder: str | None = field(default_factory=_folder)


def provenance(typed: Typed, again: Sequence[str], options: Options | None = None) -> Provenance:
    """Describe a run that starts now; ``again`` are the words of a command line that repeats it.

    The time is ISO 8601, in UTC, to the second: ``2026-01-31T12:00:00Z``.
    """
    started = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    command = shell_line(typed.words) if typed.words else None
    return Provenance(started, command, shell_line(again), typed.folder, options, host())


def shell_line(words: Sequence[str]) -> str:
    """Return words as a line for a shell, without the secrets of addresses."""
    return shlex.join(public_word(word) for word in words)


@cache
def host() -> Host:
    """Describe this machine, but not by a name of its own."""
    system = f"{platform.system()} {platform.release()} {platform.machine()}"
    return Host(_processor(), os.cpu_count() or 1, system)


@cache
def versions() -> dict[str, str]:
    """Return the version of each library."""
    return {name: installed_version(name) for name in LIBRARIES}


def _processor() -> str:
    """Return the model of the processor, or what is nearest to it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith(("model name", "Model")))
    return next(filter(None, models), "") or platform.processor() or platform.machine()
