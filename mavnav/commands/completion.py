"""Values that the shell completes after ``mavnav --install-completion``: words, shipped files, topics of a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import typer  # noqa: TC002  it reads annotations

if TYPE_CHECKING:
    from collections.abc import Callable

    Completer = Callable[[str], list[str]]

READING_S: Final = 1.0
"""For so long a log is read for its topics, s."""


def words(*names: str) -> Completer:
    """Return the completion of an option that takes one of some words."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return complete


METHODS: Final = words("robust", "paper")


def presets(incomplete: str) -> list[str]:
    """Return the shipped configurations whose names begin so."""
    from mavnav.config.loading import presets as shipped

    return words(*shipped())(incomplete)


def scenarios(incomplete: str) -> list[str]:
    """Return the shipped scenarios whose names begin so."""
    from mavnav.config.loading import scenarios as shipped

    return words(*shipped())(incomplete)


def scan_topics(context: typer.Context, incomplete: str) -> list[str]:
    """Return the scan topics of the log on the command line whose names begin so."""
    return words(*_topics(context, odometry=False))(incomplete)


def odometry_topics(context: typer.Context, incomplete: str) -> list[str]:
    """Return the odometry topics of the log on the command line, and the other values of ``--odom``."""
    return words("auto", "off", *_topics(context, odometry=True))(incomplete)


def _topics(context: typer.Context, *, odometry: bool) -> list[str]:
    from mavnav.logs import motion_and_scan_topics

    # An option without its value stops typer's parser before it has given the arguments their names.
    found = [motion_and_scan_topics(Path(word), READING_S)[0 if odometry else 1] for word in context.args]
    return sorted({name for names in found for name in names})
