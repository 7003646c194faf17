"""The base of the models that are read from files: configuration, scenarios, manifests, planner."""

from __future__ import annotations

from typing import Any

from msgspec import Meta, Struct


class Strict(Struct, frozen=True, forbid_unknown_fields=True):
    """A frozen record that is read with all its bounds; unknown keys are refused.

    A value that is wrong only beside others is refused in ``__post_init__``, by a ValueError that begins with the key
    and a colon.
    """


def setting(description: str, **bounds: Any) -> Meta:  # noqa: ANN401  of msgspec.Meta
    """Return the annotation of a field: its description and its bounds; NaN and infinity lie outside of two bounds."""
    return Meta(description=description, **bounds)
