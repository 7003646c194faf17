"""mavnav: offline SLAM, maps and map quality from recorded 2D laser logs.

The names below are the Python interface (docs/python.md). They are loaded when first used.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

from mavnav.version import __version__

TYPE_CHECKING = False  # as in typing, whose import would take most of the time
if TYPE_CHECKING:
    from typing import Any

    from mavnav.api.functions import compare, open_log, replay, simulate
    from mavnav.api.reports import batch, check, convert, info, metrics
    from mavnav.api.results import Comparison, Run, load_run
    from mavnav.api.sessions import calibrate, diff, merge
    from mavnav.api.tracking import track
    from mavnav.errors import ConfigError, MavnavError, NoScansError, OutputError, TopicError, UsageError
    from mavnav.logs import Log
    from mavnav.pose import Pose, Trajectory
    from mavnav.scan import LaserSpec, Scan

__all__ = ["Comparison", "LaserSpec", "Log", "Pose", "Run", "Scan", "Trajectory", "__version__"]
__all__ += ["ConfigError", "MavnavError", "NoScansError", "OutputError", "TopicError", "UsageError"]
__all__ += ["batch", "calibrate", "check", "compare", "convert", "diff", "info", "load_run", "merge", "metrics"]
__all__ += ["open_log", "replay", "simulate", "track"]
_MODULES = {
    **dict.fromkeys(("compare", "open_log", "replay", "simulate"), "mavnav.api.functions"),
    **dict.fromkeys(("batch", "check", "convert", "info", "metrics"), "mavnav.api.reports"),
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


class _Package(ModuleType):
    """A package that has the name of a function of the interface, and can be called as that."""

    def __call__(self, *args: Any, **values: Any) -> Any:  # noqa: ANN401
        """Call the function; it raises what that raises."""
        name = self.__name__.rpartition(".")[2]
        return getattr(import_module(_MODULES[name]), name)(*args, **values)


class _Interface(ModuleType):
    """The module itself, in which a package does not hide the function of its name."""

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute, also a package that is imported."""
        if name in _MODULES and isinstance(value, ModuleType):
            value.__class__ = _Package
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Interface


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """Load a name of the interface; raises AttributeError for others."""
    if name not in _MODULES:
        raise AttributeError(f"module 'mavnav' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """Return the names of the interface."""
    return sorted(__all__)
