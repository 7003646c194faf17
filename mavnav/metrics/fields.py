"""Descriptions of the numbers of run.json: text, unit and direction of improvement, as annotations of the fields.

msgspec makes the JSON Schema of run.json from them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec import Meta, field

if TYPE_CHECKING:
    Measured = float
else:
    Measured = float | None
"""A number that may be unknown: NaN in a record, null in JSON, which has no NaN."""

ABSENT: Final[Any] = object()
"""The value of a field whose key is left out of JSON."""


OPTIONAL: Final[Any] = field(default_factory=lambda: ABSENT)
"""The default of a field whose key not every document has."""


def number(
    description: str, *, title: str = "", unit: str = "", better: Literal["lower", "higher"] | None = None
) -> Meta:
    """Return the description of a field that is a number, or a record of numbers of one kind.

    ``title`` and ``unit`` are given only if they do not follow from the name of the field (``p95_mm``: p95, mm).
    ``better`` is the direction of improvement, if there is one.
    """
    extra = {key: value for key, value in (("title", title), ("unit", unit), ("better", better)) if value}
    return Meta(description=description, extra_json_schema=extra)


def text(description: str) -> Meta:
    """Return the description of a field that is no number."""
    return Meta(description=description)
