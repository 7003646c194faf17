"""What pages have in common: templates that escape what they are given, a policy that lets in nothing else, and facts.

The facts of a run are a line: when it was made, how long its log is, and what the sensor was.
"""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import Any
from urllib.parse import quote

from jinja2 import BytecodeCache, ChoiceLoader, Environment, PackageLoader, StrictUndefined
from jinja2.bccache import Bucket
from markupsafe import Markup
from msgspec import Struct

from mavnav.kernels.machine.cache import read_code, write_code


class Inlined(Struct, frozen=True):
    """Style or script that stands in the page itself, and its name in a Content-Security-Policy (CSP level 2)."""

    text: Markup
    source: str


class CompiledTemplates(BytecodeCache):
    """Compiled templates, kept beside the compiled kernels and trusted as those are: a third of the time of a page."""

    def load_bytecode(self, bucket: Bucket) -> None:
        """Fill in the code of a template, if it is there."""
        if code := read_code(_entry(bucket)):
            bucket.bytecode_from_string(bytes(code))

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep the code of a template."""
        write_code(_entry(bucket), bucket.bytecode_to_string())


def _entry(bucket: Bucket) -> str:
    return f"page_{bucket.key}-{bucket.checksum}"


def environment(*packages: str) -> Environment:
    """Return the templates of packages; the first that has a name wins. ``path | url`` makes a link, of any bytes."""
    templates = Environment(
        loader=ChoiceLoader([PackageLoader(package) for package in packages]),
        autoescape=True,
        bytecode_cache=CompiledTemplates(),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["url"] = lambda path: quote(os.fsencode(path))
    return templates


def inline(templates: Environment, *names: str, before: str = "") -> Inlined:
    """Return files of ours one after the other, as they stand, ``before`` them a library of others."""
    text = before + "".join(templates.loader.get_source(templates, name)[0] for name in names)  # type: ignore[union-attr]
    digest = b64encode(sha256(text.encode()).digest()).decode()
    return Inlined(Markup(text), f"'sha256-{digest}'")  # noqa: S704  nothing of a log is in it


def facts(documents: Sequence[Mapping[str, Any]]) -> str:
    """Describe the runs of one log, given run.json of each; what an earlier version did not write is left out.

    Runs of several days give the first and the last.
    """
    if not documents:
        return ""
    log_input = documents[0].get("input") or {}
    length_s = log_input.get("duration_s")
    parts = [_dates(documents), "" if length_s is None else f"log of {length_s:.1f} s", _sensor(log_input)]
    return " · ".join(part for part in parts if part)


def _dates(documents: Sequence[Mapping[str, Any]]) -> str:
    """Write the times of runs to the minute; only days where they are not of one minute."""
    texts = sorted(str((run.get("provenance") or {}).get("started") or "") for run in documents)
    days, minutes = ([text[:length] for text in texts if text] for length in (10, 16))
    if not days:
        return ""
    if minutes[0] == minutes[-1]:
        return f"{minutes[0].replace('T', ' ')} UTC"
    return days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"


def _sensor(log_input: Mapping[str, Any]) -> str:
    sensor = log_input.get("sensor")
    if not sensor:
        return ""
    most_m, rate_hz = sensor["range_max_m"], sensor["rate_hz"]
    reach = f"from {sensor['range_min_m'] or 0.0:.3g} m" + (f" to {most_m:.3g} m" if most_m is not None else "")
    parts = [f"{sensor['beams']} beams", f"{sensor['field_of_view_deg']:.4g} deg", reach]
    parts += [f"{rate_hz:.3g} Hz"] if rate_hz is not None else []
    return ", ".join([*parts, f"frame {log_input['frame_id']}"] if log_input.get("frame_id") else parts)
