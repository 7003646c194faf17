"""Leaflet, as the package ``xstatic-leaflet`` ships it, without its references to files beside it."""

from __future__ import annotations

import re
from importlib.resources import files


def script() -> str:
    """Return the script of Leaflet, which begins with its license."""
    return _read("leaflet.js").replace("//# sourceMappingURL=leaflet.js.map", "")


def style() -> str:
    """Return the style sheet of Leaflet; the pictures that it names are of controls that the page does not have."""
    return re.sub(r"url\([^)]*\)", "none", _read("leaflet.css"))


def _read(name: str) -> str:
    return (files("xstatic.pkg.leaflet") / "data" / name).read_text(encoding="utf-8")
