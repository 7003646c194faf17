"""The section of run.json with the options of a replay, made from their record."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from msgspec import Struct, defstruct, field

from mavnav.config.option_kinds import NUMBER, POSE, SWITCH
from mavnav.config.options import OPTIONS
from mavnav.metrics.fields import absent, number, text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.config.models import Config
    from mavnav.config.option_kinds import Option
    from mavnav.config.options import ReplayOptions


class GivenPose(Struct, frozen=True):
    """A pose of the laser as it was given, on its base or in a map."""

    x_m: Annotated[float, number("position")]
    y_m: Annotated[float, number("position")]
    yaw_rad: Annotated[float, number("heading, counter-clockwise")]


_RECORDED: Final = {name: option for name, option in OPTIONS.items() if option.recorded or not option.setting}


def _field(name: str, option: Option) -> tuple[Any, ...]:
    describe = number if option.kind is NUMBER else text
    kind = GivenPose if option.kind is POSE else option.kind.stored
    always = option.recorded or option.absent or option.kind is SWITCH
    annotation: Any = Annotated[kind if always else kind | None, describe(option.help)]
    return (name, annotation, field(default_factory=absent)) if option.absent else (name, annotation)


_FIELDS: Final = [
    *(_field(name, option) for name, option in _RECORDED.items() if not option.absent),
    ("config", Annotated[str | None, text("--config as typed")]),
    ("sets", Annotated[list[str], text("--set as typed")]),
    *(_field(name, option) for name, option in _RECORDED.items() if option.absent),
]

_DOC: Final = """The options of a replay, null where not given; those that change the configuration are in ``config``.

``config`` and ``sets`` are the configuration file or preset and the ``--set`` values. ``truth`` is a file, ``auto``
or ``topic:NAME``. Relative paths count from ``folder`` of the provenance.
"""

if TYPE_CHECKING:
    Options = Any
else:
    Options = defstruct("Options", _FIELDS, namespace={"__doc__": _DOC}, module=__name__, frozen=True)


def options_section(
    options: ReplayOptions[Path], config: Config, config_file: str | None, sets: Sequence[str]
) -> Options:
    """Return the section of a replay with its configuration, of a file or preset and of values as typed."""
    values = {name: getattr(config, option.setting) for name, option in _RECORDED.items() if option.setting}
    values |= {name: _plain(value) for name, value in options.items() if not OPTIONS[name].setting}
    missing = {n: False if o.kind is SWITCH else None for n, o in _RECORDED.items() if not o.absent}
    return Options(**missing | values, config=config_file, sets=list(sets))


def _plain(value: Any) -> Any:  # noqa: ANN401  the value of any option
    if isinstance(value, tuple):
        return GivenPose(*value)
    return str(value) if isinstance(value, Path) else value
