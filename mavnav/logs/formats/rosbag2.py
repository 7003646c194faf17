"""ROS 2 bag folders: the files of a bag and their order (REP-2005, metadata.yaml of rosbag2)."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from msgspec import Struct

from mavnav.errors import UsageError
from mavnav.logs.read_report import ReadReport

METADATA = "metadata.yaml"
LATEST_VERSION = 9
STORAGES = {"mcap": "mcap", "rosbag2-sqlite3": "sqlite3"}
"""Formats of files by the names that rosbag2 gives them."""

_PART = re.compile(r"(_?\d{4}(-\d\d){5})?(_(?P<number>\d+))?(\.(mcap|db3|bag|active|zstd|zst))*$")
"""The end of the name of a part: the time of its beginning (ROS 1), its number, and suffixes."""

_MAX_METADATA_BYTES = 1 << 20
_MAX_DEPTH = 20


class Metadata(Struct, frozen=True):
    """Storage files, number of messages and storage in metadata.yaml; the number is None if it is not given."""

    names: tuple[str, ...]
    messages: int | None
    storage: str = ""


def storage_files(
    folder: Path, report: ReadReport, is_storage: Callable[[Path], bool], metadata: Metadata | None
) -> list[Path]:
    """Return the storage files of a bag: those that metadata.yaml lists, else all files found, by number.

    Names and links that lead out of the folder are not followed. Missing listed files are reported as damage. After a
    crash files may be unlisted: they are read if their names mark them as parts of the same bag.

    Raises
    ------
    UsageError
        The folder holds several logs that are not parts of one bag.
    """
    files = _find_storage(folder, report, is_storage)
    names = metadata.names if metadata else ()
    inside = [file for name in dict.fromkeys(names) if (file := _listed_file(folder, name, report)) is not None]
    listed = list(dict.fromkeys(inside))
    if len(set(names)) < len(names) or len(listed) < len(inside):
        report.warn("metadata.yaml lists a file more than once; it was read once")
    unlisted = [file for file in files if file not in listed]
    parts = [file for file in unlisted if not listed or name_stem(file) in set(map(name_stem, listed))]
    if len({name_stem(file) for file in parts}) > 1:
        several = ", ".join(file.name for file in files[:5]) + (", ..." if len(files) > 5 else "")
        advice = "name one, or use 'mavnav batch FOLDER'"
        raise UsageError(f"{folder}: {len(files)} logs that are no parts of one bag ({several}); {advice}")
    for file in unlisted if metadata else ():
        outcome = "was read too" if file in parts else "was not read"
        report.warn(f"{file.name} lies in the folder, but metadata.yaml does not list it; it {outcome}")
    return listed + parts


def _find_storage(folder: Path, report: ReadReport, is_storage: Callable[[Path], bool]) -> list[Path]:
    """Return the storage files of a folder by number; links that lead out of it are reported."""
    files = []
    for file in sorted(folder.iterdir(), key=natural_key):
        if file.is_file() and not file.resolve().is_relative_to(folder.resolve()):
            report.damage(f"{file.name!r} is a link that leads out of the folder; it is not read", folder.name)
        elif is_storage(file):
            files.append(file)
    return files


def natural_key(path: Path) -> list[tuple[bool, int, str]]:
    """Return the sort key that puts x_2 before x_10."""
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", path.name)]


def name_stem(path: Path) -> str:
    """Return the common stem of a bag's parts: ``x`` of ``x_2.db3.zstd`` and ``x_2020-01-31-12-00-00_1.bag``."""
    return _PART.sub("", path.name)


def part_number(path: Path) -> int | None:
    """Return the number of a part of a bag by its name; None without one."""
    match = _PART.search(path.name)
    return int(match["number"]) if match and match["number"] else None


def _listed_file(folder: Path, name: str, report: ReadReport) -> Path | None:
    """Return the file of a listed name; report it and return None if it leads out of the folder or is missing."""
    # Before version 4 names began with the folder; a file that was decompressed by hand is listed with its old suffix.
    base = folder / (folder / name).name
    problem = f"listed file {name!r} is missing"
    try:
        if not Path(os.path.realpath(folder / name)).is_relative_to(folder.resolve()):
            problem = f"listed file {name!r} leads out of the folder; it is not read"
        else:
            for path in (folder / name, base, base.with_name(base.name + ".zstd"), base.with_name(base.stem)):
                if path.is_file():
                    return path
    except (OSError, ValueError):  # too long, or with a null byte
        problem = f"listed file {name[:80]!r}: this cannot be a file's name"
    report.damage(problem, METADATA)
    return None


def read_metadata(folder: Path, report: ReadReport) -> Metadata | None:
    """Read metadata.yaml; report it and return None if it is missing or cannot be read.

    Only plain values are built from it: tags are not constructed and aliases are not expanded.
    """
    import yaml  # noqa: PLC0415

    path = folder / METADATA
    if not path.is_file() or not path.resolve().is_relative_to(folder.resolve()):
        report.warn("the folder has no metadata.yaml; the storage files found were read")
        return None
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_METADATA_BYTES + 1)
        return _metadata(_plain_tree(text, report), report)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())[:160]
        report.damage(f"content cannot be read ({reason}); the storage files found were read", METADATA)
        return None


def _metadata(tree: Any, report: ReadReport) -> Metadata:  # noqa: ANN401  (any YAML value)
    bag = tree.get("rosbag2_bagfile_information") if isinstance(tree, dict) else None
    if not isinstance(bag, dict):
        raise TypeError("it is not that of a bag" if tree else "it is empty")
    names = bag.get("relative_file_paths")
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        raise TypeError("relative_file_paths is no list of names")
    count, version, storage = bag.get("message_count"), bag.get("version"), bag.get("storage_identifier")
    if version not in {None, *map(str, range(1, LATEST_VERSION + 1))}:
        report.warn(f"{METADATA} is of version {version!r}; versions 1 to {LATEST_VERSION} are known")
    messages = int(count) if isinstance(count, str) and count.isdecimal() else None
    return Metadata(tuple(names), messages, storage if isinstance(storage, str) else "")


def _plain_tree(text: bytes, report: ReadReport) -> Any:  # noqa: ANN401
    """Build dictionaries, lists and strings of YAML.

    Raises ValueError for large or deeply nested input, and YAMLError for aliases and Python tags.
    """
    import yaml  # noqa: PLC0415

    if len(text) > _MAX_METADATA_BYTES:
        raise ValueError(f"it is larger than {_MAX_METADATA_BYTES} bytes")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    depth = 0
    for event in yaml.parse(text, loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        tag = getattr(event, "tag", None)
        if isinstance(event, yaml.AliasEvent) or "python" in str(tag):
            raise yaml.YAMLError(f"it has the tag {tag}" if tag else "it has aliases")
        if depth > _MAX_DEPTH:
            raise ValueError(f"it is nested deeper than {_MAX_DEPTH} levels")
    return _plain(yaml.compose(text, loader), report)


def _plain(node: Any, report: ReadReport) -> Any:  # noqa: ANN401
    """Return the value of a node; None for that of an empty document. A key given twice is reported."""
    if node is None or node.id == "scalar":
        return node and node.value
    if node.id == "sequence":
        return [_plain(item, report) for item in node.value]
    tree: dict[str, Any] = {}
    for key, value in node.value:
        name = str(key.value)
        if name in tree:
            report.damage(f"{name} is given twice; the first one is used", METADATA)
        else:
            tree[name] = _plain(value, report)
    return tree


def compare(metadata: Metadata, messages: int, formats: set[str], report: ReadReport) -> None:
    """Report that metadata.yaml counts other messages than were read, or names another storage than the files are.

    ``formats`` are those of the files.
    """
    listed, real = metadata.messages, {STORAGES[name] for name in formats if name in STORAGES}
    if listed is not None and listed > messages:
        report.damage(f"{messages} of the {listed} listed messages were read", METADATA)
    elif listed is not None and listed < messages:
        report.warn(f"{METADATA} counts {listed} messages, {messages} were read")
    if metadata.storage and real and metadata.storage not in real:
        report.warn(f"{METADATA} names the storage {metadata.storage!r}; the files are {' and '.join(sorted(real))}")
