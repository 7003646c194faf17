"""Descriptions of the numbers of run.json: text, unit and direction of improvement, as metadata of the fields.

The metadata are keyword arguments of ``pydantic.Field``, from which pydantic makes the JSON Schema of run.json.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal


class _Nullable:
    """Mark of numbers that may be NaN, which JSON does not have: null is written."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:  # noqa: ANN401  pydantic's types
        return {"type": "nullable", "schema": handler(source)}


Measured = Annotated[float, _Nullable()]
"""A number that may be unknown: NaN in a record, null in JSON."""

ABSENT: Final[Any] = object()
"""The value of a field whose key is left out of JSON."""


def absent() -> Any:  # noqa: ANN401  the default of a field of any type
    """Return `ABSENT`: the default factory of an optional key."""
    return ABSENT


def number(
    description: str, *, title: str = "", unit: str = "", better: Literal["lower", "higher"] | None = None
) -> dict[str, Any]:
    """Return the metadata of a field that is a number, or a record of numbers of one kind.

    ``title`` and ``unit`` are given only if they do not follow from the name of the field (``p95_mm``: p95, mm).
    ``better`` is the direction of improvement, if there is one.
    """
    extra = {key: value for key, value in (("unit", unit), ("better", better)) if value}
    return {"description": description, **({"title": title} if title else {}), "json_schema_extra": extra}


def text(description: str) -> dict[str, Any]:
    """Return the metadata of a field that is no number."""
    return {"description": description}
