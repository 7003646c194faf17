"""The base of the models that are read from files: configuration, scenarios, manifests, planner."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msgspec import Meta, Struct

if TYPE_CHECKING:
    from collections.abc import Iterator


class Strict(Struct, frozen=True, forbid_unknown_fields=True):
    """A frozen record that is read with all its bounds; unknown keys are refused.

    A value that is wrong only beside others is refused in ``__post_init__``, by a ValueError that begins with the key
    and a colon.
    """


class InSI:
    """A value of a section in SI units: ``cell_m`` of ``cell_mm``."""

    def __init__(self, key: str, unit: float) -> None:
        """Take the key and its unit, a constant of `mavnav.units`."""
        self._key, self._unit = key, unit

    def __get__(self, section: Strict, owner: type[Strict]) -> float:
        """Return the value."""
        return float(getattr(section, self._key) * self._unit)


def in_si(unit: float, *keys: str) -> Iterator[InSI]:
    """Return attributes of a section for its keys of one unit."""
    return (InSI(key, unit) for key in keys)


def setting(description: str, **bounds: Any) -> Meta:  # noqa: ANN401  of msgspec.Meta
    """Return the annotation of a field: its description and its bounds; NaN and infinity lie outside of two bounds."""
    return Meta(description=description, **bounds)
