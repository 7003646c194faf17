"""Ground truth that is named by a topic of the log, in place of a file."""

from __future__ import annotations

from typing import Final

AUTO: Final = "auto"
PREFIX: Final = "topic:"


def recorded_topic(truth: str) -> str | None:
    """Return the topic that a ``--truth`` names, ``auto`` or what follows ``topic:``; None for a file."""
    if truth == AUTO:
        return AUTO
    return truth.removeprefix(PREFIX) if truth.startswith(PREFIX) else None


def truth_text(topic: str) -> str:
    """Return the ``--truth`` that names a topic."""
    return topic if topic == AUTO else PREFIX + topic
