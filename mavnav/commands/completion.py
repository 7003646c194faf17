"""Completion of option values in the shell (``mavnav --install-completion``): words, presets, scenarios, topics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import typer  # noqa: TC002  it reads annotations

Completer = Callable[[str], list[str]]

MAX_READ_S: Final = 1.0
"""Maximum time to read a log for its topics, in s."""


def words(*names: str) -> Completer:
    """Return the completer of an option that takes one of these words."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return complete


attitude_topics: Final = words("auto", "off", "/attitude")
planners: Final = words("wavefront", "field", "wall_following", "virtual_obstacles")
verdicts: Final = words("good", "suspect", "wrong", "lost")
outputs: Final = words(
    "trajectory", "map", "metrics", "slices", "pictures", "mcap", "report", "svg", "scale", "graph", "all"
)


def presets(incomplete: str) -> list[str]:
    """Return the presets whose names begin with ``incomplete``."""
    from mavnav.config.loading import presets as shipped

    return words(*shipped())(incomplete)


def scenarios(incomplete: str) -> list[str]:
    """Return the included scenarios whose names begin with ``incomplete``."""
    from mavnav.config.loading import scenarios as shipped

    return words(*shipped())(incomplete)


def scan_topics(context: typer.Context, incomplete: str) -> list[str]:
    """Return the scan topics of the log on the command line whose names begin with ``incomplete``."""
    return words(*_topics(context, odometry=False))(incomplete)


def odometry_topics(context: typer.Context, incomplete: str) -> list[str]:
    """Return the odometry topics of the log on the command line, and the other values of ``--odom``."""
    return words("auto", "off", *_topics(context, odometry=True))(incomplete)


def recorded_odometry(context: typer.Context, incomplete: str) -> list[str]:
    """Return the same without ``off``."""
    return words("auto", *_topics(context, odometry=True))(incomplete)


def _topics(context: typer.Context, *, odometry: bool) -> list[str]:
    from mavnav.logs import motion_and_scan_topics

    # An option without a value stops typer's parser before it assigns names to the arguments.
    per_log = [motion_and_scan_topics(Path(word), MAX_READ_S)[0 if odometry else 1] for word in context.args]
    return sorted({name for names in per_log for name in names})
