"""What pages have in common: templates that escape what they are given, and a policy that lets in nothing else."""

from __future__ import annotations

import os
from base64 import b64encode
from hashlib import sha256
from urllib.parse import quote

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from msgspec import Struct


class Inlined(Struct, frozen=True):
    """Style or script that stands in the page itself, and its name in a Content-Security-Policy (CSP level 2)."""

    text: Markup
    source: str


def environment(*packages: str) -> Environment:
    """Return the templates of packages; the first that has a name wins. ``path | url`` makes a link, of any bytes."""
    templates = Environment(
        loader=ChoiceLoader([PackageLoader(package) for package in packages]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["url"] = lambda path: quote(os.fsencode(path))
    return templates


def inline(templates: Environment, *names: str) -> Inlined:
    """Return files of ours one after the other, as they stand."""
    text = "".join(templates.loader.get_source(templates, name)[0] for name in names)  # type: ignore[union-attr]
    digest = b64encode(sha256(text.encode()).digest()).decode()
    return Inlined(Markup(text), f"'sha256-{digest}'")  # noqa: S704  nothing of a log is in it
