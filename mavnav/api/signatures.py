"""Signatures and docstrings of functions that take options of a replay, made from the record of the options."""

from __future__ import annotations

import inspect
import re
from functools import wraps
from inspect import Parameter
from textwrap import fill, indent
from typing import TYPE_CHECKING, Any, TypeVar, cast

from mavnav.config.option_kinds import SWITCH
from mavnav.config.options import OPTIONS, TYPES, File

if TYPE_CHECKING:
    from collections.abc import Callable

Function = TypeVar("Function", bound="Callable[..., Any]")


def with_options(*names: str) -> Callable[[Function], Function]:
    """Put options in the signature and the docstring of a function that takes them as ``**options``.

    In both they follow the positional arguments. Other names raise TypeError, as they do in any function.
    """

    def decorate(function: Function) -> Function:
        signature = inspect.signature(function)
        own = [each for each in signature.parameters.values() if each.kind is not Parameter.VAR_KEYWORD]
        places = [each for each in own if each.kind is not Parameter.KEYWORD_ONLY]
        signature = signature.replace(parameters=[*places, *map(_parameter, names), *own[len(places) :]])

        @wraps(function)
        def call(*args: Any, **values: Any) -> Any:  # noqa: ANN401  those of the function
            signature.bind(*args, **values)
            return function(*args, **values)

        call.__signature__ = signature  # type: ignore[attr-defined]
        text = "".join(f"    {name}\n{_description(name)}\n" for name in names)
        call.__doc__ = re.sub(r" {4}\*\*options\n( {8}.*\n)+", lambda _: text, function.__doc__ or "")
        return cast("Function", call)

    return decorate


def _parameter(name: str) -> Parameter:
    hint = TYPES[name]
    default = False if OPTIONS[name].kind is SWITCH else None
    python = hint[File] if getattr(hint, "__parameters__", ()) else hint
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=python)


def _description(name: str) -> str:
    option = OPTIONS[name]
    return indent(fill(f"{option.metavar}: {option.help}" if option.metavar else option.help, 112), " " * 8)
