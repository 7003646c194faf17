"""Versions: that of mavnav, and those of installed packages."""

from __future__ import annotations

import sys
from functools import cache
from typing import Any

__version__ = "0.3.0"

DOCUMENT_HEAD: dict[str, Any] = {"schema_version": 1, "mavnav_version": __version__}
"""How every JSON document begins: the version of its format, and that of mavnav."""


def installed_version(package: str) -> str:
    """Return the version of an installed package by the name of its folder; "none" if there is no such folder."""
    return _installed_versions().get(package.lower(), "none")


@cache
def _installed_versions() -> dict[str, str]:
    """Return the version of each package by the name of its folder, in a tenth of ``importlib.metadata``'s time."""
    from pathlib import Path  # noqa: PLC0415  the package is imported before Ctrl-C ends it silently

    folders = (folder.stem for path in reversed(sys.path) for folder in Path(path).glob("*-*.*-info"))
    return {name.lower(): version for name, _, version in (folder.partition("-") for folder in folders)}
