"""Single files that the user names: checked before the work, and complete or absent after it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.atomic_files import beside, is_stream
from mavnav.errors import OutputError, UsageError
from mavnav.outputs.directory import check_target

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def check_file(path: Path | None, suffix: str, *, force: bool) -> None:
    """Raise UsageError or OutputError for a file that could not be written or has another suffix; None is no file."""
    if path is None:
        return
    check_target(path)
    if is_stream(path):
        return
    if path.suffix.lower() != suffix:
        raise UsageError(f"{path} is no {suffix[1:].upper()} file; name it with {suffix}, for example {path}{suffix}")
    if path.exists() and not force:
        raise OutputError(f"{path} exists; choose another file, or --force to replace it")


def write_file(path: Path, write: Callable[[Path], object], *, force: bool) -> None:
    """Write a file by a function that is given a path; raises OutputError if it cannot be written."""
    try:
        with beside(path, exclusive=not force) as partial:
            write(partial)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
