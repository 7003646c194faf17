"""Search for the logs given by paths, patterns, folders and addresses."""

from __future__ import annotations

import os
import re
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mavnav.errors import NoScansError, UsageError
from mavnav.logs.formats.detect import SUFFIXES, is_named_like_a_log
from mavnav.outputs.directory import MERGE_FILE, RUN_FILE
from mavnav.outputs.documents.addresses import is_address

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

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
    logs = _logs(matches)
    rest = [match for match in matches if not any(path.is_relative_to(match) for path in logs)]
    return [_relative(path, base) for path in sorted([*logs, *(match for match in rest if not _logs([match]))])]


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
    return (path.name == "result.mcap" or path.name.startswith("session_")) and _is_run(path.parent)


def _is_run(folder: Path) -> bool:
    return any((folder / name).is_file() for name in (RUN_FILE, MERGE_FILE))


def _logs(paths: Sequence[Path]) -> list[Path]:
    """Return files as they are, and the logs in folders and their subfolders, sorted.

    Each folder is visited once, however many links lead to it; by a path without links if there is one.
    """
    logs, visited = list[Path](), set[str]()
    waiting = deque(sorted(paths, key=_links))
    while waiting:
        path = waiting.popleft()
        folder = path.is_dir()
        place = os.path.realpath(path) if folder else f"{os.path.realpath(path.parent)}/{path.name}"
        if place in visited:
            continue
        visited.add(place)
        if not folder or (path / "metadata.yaml").is_file():
            logs.append(path)
        elif not _is_run(path):
            shown = (each for each in path.iterdir() if not each.name.startswith("."))
            inner = [each for each in shown if each.is_dir() or is_named_like_a_log(each)]
            waiting.extendleft(each for each in inner if not each.is_symlink())
            waiting.extend(each for each in inner if each.is_symlink())
    return sorted(logs)


def _links(path: Path) -> int:
    return sum(part.is_symlink() for part in (path, *path.parents))


def _relative(path: Path, base: Path) -> str:
    try:
        return path.absolute().relative_to(base.absolute()).as_posix()
    except ValueError:
        return path.as_posix()
