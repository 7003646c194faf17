"""The run directory, and single files that the user names: checked before the work, complete or absent after it.

They are written beside and renamed at the end.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Final

from mavnav.atomic_files import beside, check_name, is_stream, replacing, writing
from mavnav.config.named_files import read_json, what_is_wrong
from mavnav.errors import OutputError, UsageError

RUN_FILE: Final = "run.json"
"""The file that makes a directory a run of ours."""

MERGE_FILE: Final = "merge.json"
"""The file that makes a directory a merge of ours."""

WHOLE_AGAIN: Final = "repeat its command with --force, without --outputs"
"""What to do where a file of a run is missing."""

MOST_HOLES_BYTES: Final = 4 << 30
"""Bytes of a file that the disk may not keep: they take no space, but would be hashed."""


def file_sha256(path: Path) -> str:
    """Return the SHA-256 by which a run knows a file of its directory; raises OSError."""
    with path.open("rb") as file:
        return file_digest(file, sha256).hexdigest()


def checked_file(directory: Path, name: str, digests: Mapping[str, str]) -> Path:
    """Return the path of a file of a run, given the digests by which the run knows its files.

    Raises UsageError where it is missing, or another one than was written. A file without a digest is taken as it is:
    who edits one by hand deletes its digest.
    """
    path = directory / name
    if not path.is_file():
        raise UsageError(f"{directory} is no whole run: it has no {name}; {WHOLE_AGAIN}")
    status = path.stat()
    if status.st_size - 512 * getattr(status, "st_blocks", status.st_size) > MOST_HOLES_BYTES:
        raise UsageError(f"{directory} is no whole run: {name} is mostly holes; get a whole copy")
    if name in digests and file_sha256(path) != digests[name]:
        advice = f"get it again, or, if that was on purpose, delete its line under 'outputs' of {RUN_FILE}"
        raise UsageError(f"{directory} is no whole run: {name} has been altered since it was written; {advice}")
    return path


def document_of(directory: Path) -> Path | None:
    """Return the run.json or merge.json of a directory, None where there is neither."""
    return next((directory / name for name in (RUN_FILE, MERGE_FILE) if (directory / name).is_file()), None)


def digests_of(directory: Path) -> dict[str, str]:
    """Return the digests of the files of a run or merge by their names; empty for a directory that is neither.

    Raises UsageError where its document has none.
    """
    if (file := document_of(directory)) is None:
        return {}
    try:
        return plain_digests(read_json(file)["outputs"])
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}; name a run directory") from error
    except (ValueError, LookupError, TypeError) as error:
        reason = what_is_wrong(error, "is not one of mavnav's")
        raise UsageError(f"{file} {reason}; name the directory of a finished run") from error


def check_files(directory: Path, outputs: object) -> None:
    """Raise UsageError for a file that is another one than was written; those that are not there are not missed.

    ``outputs`` is that section of the document of the run; raises ValueError where it is none.
    """
    digests = plain_digests(outputs)
    for name in digests:
        if os.path.lexists(directory / name):
            checked_file(directory, name, digests)


def plain_digests(outputs: object) -> dict[str, str]:
    """Return digests by names of files; raises ValueError for anything else, also a name outside of the folder."""
    pairs = outputs.items() if isinstance(outputs, dict) else [("", None)]
    if not all(isinstance(n, str) and isinstance(d, str) and Path(n).name == n for n, d in pairs):
        raise ValueError
    return dict(pairs)


def check_directory(
    directory: Path, *, force: bool, marker: str = RUN_FILE, inputs: Iterable[Path | None] = ()
) -> None:
    """Raise OutputError where a run cannot be put; cheap enough to ask before the work begins.

    What exists stays, unless ``force`` is set and it is an earlier run, which has the file ``marker``, or empty. Raises
    UsageError for an earlier run that contains one of the ``inputs``: replacing it would delete them.
    """
    check_no_file(directory)
    if not os.path.lexists(directory):
        check_parent(directory)
    elif any(directory.iterdir()) and not (directory / marker).is_file():
        raise OutputError(f"{directory} holds other files (no {marker}); choose another directory with -o")
    elif inside := [path for path in inputs if path and _contains(directory, path)]:
        loss = f"would be lost if {directory} were replaced"
        raise UsageError(f"{inside[0]} is an input, and {loss}; choose another directory with -o")
    elif not force:
        raise OutputError(f"{directory} exists; choose another directory with -o, or --force to replace it")


def check_no_file(directory: Path) -> None:
    """Raise OutputError for a file, for a link to nothing, or to itself, and for a name that no file can have."""
    check_name(directory)
    if directory.is_symlink() and not directory.exists():
        raise OutputError(f"{directory} is a link that leads nowhere; remove it, or choose another directory with -o")
    if os.path.lexists(directory) and not directory.is_dir():
        raise OutputError(f"{directory} is a file; choose another directory with -o")


def _contains(directory: Path, path: Path) -> bool:
    """Return whether a file or folder is a directory or in it, by its name or by the target of a link."""
    if not os.path.lexists(path):
        return False
    named = os.path.normpath(Path(os.path.realpath(path.parent)) / path.name)
    return any(Path(place).is_relative_to(directory.resolve()) for place in (named, os.path.realpath(path)))


def check_parent(path: Path) -> None:
    """Raise OutputError for a file or directory that cannot be made where it is to be."""
    for parent in path.absolute().parents:
        if parent.is_dir():
            if not os.access(parent, os.W_OK | os.X_OK):
                raise OutputError(f"{path} cannot be made: {parent} is not writable; choose another place")
            return
        if os.path.lexists(parent):
            raise OutputError(f"{path} cannot be made: {parent} is no directory; choose another place")


def check_target(path: Path) -> None:
    """Raise OutputError for a path that no file can be written to; devices, FIFOs and open streams are written into."""
    check_name(path)
    if path.is_dir():
        raise OutputError(f"{path} is a directory; name a file")
    if is_stream(path):
        return
    if path.exists() and not path.is_file():
        raise OutputError(f"{path} is a socket or a block device; name a file")
    check_parent(path)


def check_apart(files: Mapping[str, Path | None], inputs: Iterable[Path | None]) -> None:
    """Raise UsageError for a file that would overwrite an input, or another one of ``files``.

    ``files`` are the files to write by their options. A folder is overwritten with all that is in it; in that of a
    ROS 2 bag no file may be overwritten. Streams overwrite nothing.
    """
    option_of: dict[Path, str] = {}
    read = [(path, _real(path)) for path in inputs if path]
    for option, path in files.items():
        if path is None or is_stream(path):
            continue
        place = _real(path)
        if place in option_of:
            raise UsageError(f"{option_of[place]} and {option} are both {path}; name two files")
        option_of[place] = option
        for given, source in read:
            if source.is_relative_to(place) or (place.is_relative_to(source) and (source / "metadata.yaml").is_file()):
                raise UsageError(f"{option}: {path} would overwrite {given}, which is an input; name another file")


def _real(path: Path) -> Path:
    """Return a path without links; unlike `Path.resolve` also of links that lead in a circle."""
    return Path(os.path.realpath(path))


@contextmanager
def atomic_directory(directory: Path, *, force: bool, marker: str = RUN_FILE) -> Iterator[Path]:
    """Give a temporary directory beside ``directory`` that takes its name when the block ends well.

    On any failure it is removed, and what was there before stays. Raises OutputError where the disk says no.
    """
    with writing(directory, "make room or choose another with -o"):
        check_directory(directory, force=force, marker=marker)
    with replacing(directory, force=force, another="another directory with -o", room="another with -o") as partial:
        partial.mkdir()
        yield partial


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
    with writing(path), beside(path, exclusive=not force) as partial:
        write(partial)
