"""Reads words and paths of the command line without pydantic, which typer has read every value.

Loading pydantic and preparing it for every option takes 0.1 s of processor time. This rests on names inside of typer;
where one is missing, typer reads the value.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    from collections.abc import Iterable


class Command(TyperCommand):
    """A command whose options that are not given, words and paths need no pydantic."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401  typer's Context
        """Parse as typer does, with a reader before that of each option and argument."""
        _put_readers(self.get_params(ctx))
        return super().parse_args(ctx, args)


class Group(TyperGroup):
    """The same for a command with commands."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401  typer's Context
        """Parse as typer does, with a reader before that of each option."""
        _put_readers(self.get_params(ctx))
        return super().parse_args(ctx, args)


def _put_readers(params: Iterable[Any]) -> None:
    for param in params:
        if hasattr(param, "get_runtime_param"):
            reader = _Reader(param.get_runtime_param)
            param.get_runtime_param = lambda reader=reader: reader


class _Reader:
    """Reads the values of one option; ``typers`` makes the reader that typer would take."""

    def __init__(self, typers: Any) -> None:  # noqa: ANN401
        self._typers = typers

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:  # noqa: ANN401
        """Return a value as what the command takes; raises typer's BadParameter where it is none."""
        kind = getattr(getattr(param, "type_descriptor", None), "annotation", None)
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if kind is str and isinstance(value, str):
            return value
        if kind == list[str] and isinstance(value, list | tuple) and all(isinstance(item, str) for item in value):
            return list(value)
        if kind is Path and isinstance(value, str):
            with suppress(ImportError):
                from typer._param_types import coerce_cli_path

                info = param.type_descriptor.parameter_info
                return coerce_cli_path(Path(value), info, path_type=Path, param=param, ctx=ctx)
        return self._typers().coerce(value, param=param, ctx=ctx)
