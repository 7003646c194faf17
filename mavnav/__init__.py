"""mavnav: offline SLAM, maps and map quality from recorded 2D laser logs.

The names below are the Python interface (docs/python.md). They are loaded when first used.
"""

from __future__ import annotations

from mavnav.version import __version__

TYPE_CHECKING = False  # as in typing, whose import would take most of the time
if TYPE_CHECKING:
    from typing import Any

    from mavnav.api.functions import compare, open_log, replay, simulate
    from mavnav.api.results import Comparison, Run, load_run
    from mavnav.api.sessions import calibrate, diff, merge
    from mavnav.api.tracking import track
    from mavnav.errors import ConfigError, MavnavError, NoScansError, OutputError, TopicError, UsageError
    from mavnav.logs import Log
    from mavnav.pose import Pose, Trajectory
    from mavnav.scan import LaserSpec, Scan

__all__ = [
    "Comparison",
    "ConfigError",
    "LaserSpec",
    "Log",
    "MavnavError",
    "NoScansError",
    "OutputError",
    "Pose",
    "Run",
    "Scan",
    "TopicError",
    "Trajectory",
    "UsageError",
    "__version__",
    "calibrate",
    "compare",
    "diff",
    "load_run",
    "merge",
    "open_log",
    "replay",
    "simulate",
    "track",
]
_MODULES = {
    **dict.fromkeys(("compare", "open_log", "replay", "simulate"), "mavnav.api.functions"),
    **dict.fromkeys(("Comparison", "Run", "load_run"), "mavnav.api.results"),
    **dict.fromkeys(("calibrate", "diff", "merge"), "mavnav.api.sessions"),
    **dict.fromkeys(("LaserSpec", "Scan"), "mavnav.scan"),
    **dict.fromkeys(("Pose", "Trajectory"), "mavnav.pose"),
    **dict.fromkeys(
        ("ConfigError", "MavnavError", "NoScansError", "OutputError", "TopicError", "UsageError"), "mavnav.errors"
    ),
    "Log": "mavnav.logs",
    "track": "mavnav.api.tracking",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """Load a name of the interface; raises AttributeError for others."""
    if name not in _MODULES:
        raise AttributeError(f"module 'mavnav' has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415

    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """Return the names of the interface."""
    return sorted(__all__)
