"""ROS 2 bag folders: which files belong to the bag, and in which order (REP-2005, rosbag2's metadata.yaml)."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mavnav.logs.ledger import Ledger

METADATA = "metadata.yaml"
_MAX_METADATA_BYTES = 16 << 20


def storage_files(folder: Path, ledger: Ledger, is_storage: Callable[[Path], bool]) -> list[Path]:
    """Return the storage files of a bag: those that metadata.yaml lists, else all that are found, by number.

    Names that lead out of the folder are not followed. Listed files that are missing are damage; found ones that are
    not listed are a warning.
    """
    found = sorted((f for f in folder.iterdir() if f.is_file() and is_storage(f)), key=_natural)
    names = _listed_names(folder / METADATA, ledger)
    if names is None:
        return found
    listed = [file for name in names if (file := _inside(folder, name, ledger)) is not None]
    for stranger in [file.name for file in found if file not in listed]:
        ledger.warn(f"{stranger} lies in the folder, but metadata.yaml does not list it; it was not read")
    return listed


def _natural(path: Path) -> list[tuple[bool, int, str]]:
    """Sort x_2 before x_10."""
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", path.name)]


def _inside(folder: Path, name: str, ledger: Ledger) -> Path | None:
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        ledger.damage(f"metadata.yaml lists {name!r}, which leads out of the folder; it is not read", METADATA)
        return None
    if not path.is_file():
        path = folder / path.name  # before metadata version 4 names began with the folder's
    if not path.is_file():
        ledger.damage(f"metadata.yaml lists {name!r}, which is missing", METADATA)
        return None
    return path


def _listed_names(path: Path, ledger: Ledger) -> list[str] | None:
    """Return the file names that metadata.yaml lists; None where it is missing or broken."""
    import yaml  # noqa: PLC0415

    if not path.is_file():
        ledger.warn("the folder has no metadata.yaml; the storage files found were read")
        return None
    try:
        with path.open("rb") as file:
            document = yaml.safe_load(file.read(_MAX_METADATA_BYTES))
        return _names(document)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())[:160]
        ledger.damage(f"metadata.yaml cannot be read ({reason}); the storage files found were read", METADATA)
        return None


def _names(document: Any) -> list[str]:  # noqa: ANN401  (whatever YAML holds)
    names = document["rosbag2_bagfile_information"]["relative_file_paths"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise TypeError("relative_file_paths is no list of names")
    return names
