"""Ground truth from a topic of the log instead of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

AUTO: Final = "auto"
PREFIX: Final = "topic:"


def recorded_topic(truth: str) -> str | None:
    """Return the topic in a ``--truth`` value: ``auto``, or the text after ``topic:``; None for a file."""
    if truth == AUTO:
        return AUTO
    return truth.removeprefix(PREFIX) if truth.startswith(PREFIX) else None


def truth_fields(truth: str | Path | None) -> dict[str, Any]:
    """Return the fields of a request for a ``--truth`` value: ``truth_topic``, ``truth`` (a file), or none."""
    if truth is None:
        return {}
    topic = recorded_topic(str(truth))
    return {"truth": Path(truth)} if topic is None else {"truth_topic": topic}


def truth_text(topic: str) -> str:
    """Return the ``--truth`` value of a topic."""
    return topic if topic == AUTO else PREFIX + topic
