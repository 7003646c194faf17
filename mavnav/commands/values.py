"""Commands whose help names no types that say nothing, and which read words, plain numbers and paths without pydantic.

typer lets pydantic read every value; loading it and preparing it for every option takes 0.1 s of processor time. This
rests on names inside of typer; where one is missing, typer reads the value.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from pathlib import Path
from typing import Annotated, Any, Final, get_type_hints

from typer import TyperException
from typer.core import TyperCommand, TyperGroup

from mavnav.commands import shared
from mavnav.config.option_kinds import descriptions

_PLAIN: Final[dict[Any, re.Pattern[str]]] = {
    int: re.compile("[0-9]{1,15}"),
    float: re.compile("-?[0-9]{1,15}([.][0-9]{1,15})?"),
}
"""How most numbers are written; typer reads others, and those with bounds."""


class _Parameters:
    """What commands and groups of commands do with their options and arguments."""

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401  typer's Context
        """Return options and arguments as help shows them: flags and arguments have no type."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False) or param.param_type_name == "argument":
                param.display_type_rich = lambda ctx: ""  # noqa: ARG005  the name is typer's
        return params

    def parse_args(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401  typer's Context
        """Parse as typer does, with a reader before that of each option and argument."""
        for param in self.get_params(ctx):
            if hasattr(param, "get_runtime_param"):
                reader = _Reader(param.get_runtime_param)
                param.get_runtime_param = lambda reader=reader: reader
        try:
            return super().parse_args(ctx, args)  # type: ignore[misc]
        except TyperException as error:  # those of the parser lack the command
            error.ctx = getattr(error, "ctx", None) or ctx  # type: ignore[attr-defined]
            raise


class PlainCommand(_Parameters, TyperCommand):
    """A command whose options that are not given, words, plain numbers and paths need no pydantic."""


class CommandGroup(_Parameters, TyperGroup):
    """The same for a command with commands."""


class _Reader:
    """Reads the values of one option; ``typers`` makes the reader that typer would take."""

    def __init__(self, typers: Any) -> None:  # noqa: ANN401
        self._typers = typers

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:  # noqa: ANN401
        """Return a value as what the command takes; raises typer's BadParameter where it is none."""
        described = getattr(param, "type_descriptor", None)
        kind = getattr(described, "annotation", None)
        if info := getattr(described, "parameter_info", None):
            info.readable = False  # what reads the file says what to do
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if kind is str and isinstance(value, str):
            return value
        if kind == list[str] and isinstance(value, list | tuple) and all(isinstance(item, str) for item in value):
            return list(value)
        plain = None if getattr(described, "is_ranged", True) else _PLAIN.get(kind)
        if plain and isinstance(value, str) and plain.fullmatch(value):
            return float(value) if kind is float else int(value)
        if kind is Path and isinstance(value, str):
            with suppress(ImportError):
                from typer._param_types import coerce_cli_path

                info = param.type_descriptor.parameter_info
                return coerce_cli_path(Path(value), info, path_type=Path, param=param, ctx=ctx)
        return self._typers().coerce(value, param=param, ctx=ctx)


def describe(command: Callable[..., None]) -> str:
    """Give parameters the help of a command's docstring, or that of shared ones; return the rest of the docstring."""
    text, own = descriptions(command.__doc__)
    command.__annotations__ = get_type_hints(command, include_extras=True)  # typer would do so four times
    help_, signature = descriptions(shared.__doc__)[1] | own, inspect.signature(command)
    parameters = [_with_help(each, help_.get(each.name)) for each in signature.parameters.values()]
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    return text


def _with_help(parameter: inspect.Parameter, text: str | None) -> inspect.Parameter:
    if text is None or not (infos := getattr(parameter.annotation, "__metadata__", ())):
        return parameter
    info = copy(infos[0])  # shared by commands
    info.help = text
    return parameter.replace(annotation=Annotated[parameter.annotation.__origin__, info])
