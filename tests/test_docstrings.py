"""Docstrings of the Python interface: the API page takes the type of an entry from the one parameter that it names."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable

import pytest

import mavnav


def entries(function: Callable[..., object]) -> list[str]:
    """Return the entries of the section Parameters."""
    text = inspect.cleandoc(function.__doc__ or "").partition("Parameters\n----------\n")[2]
    section = re.split(r"\n\n\w+\n-+\n", text)[0]
    return re.findall(r"^(\S.*)$", section, re.MULTILINE)


@pytest.mark.parametrize("name", ["open_log", "replay", "simulate", "compare", "track", "merge", "diff", "calibrate"])
def test_each_parameter_has_its_entry(name: str) -> None:
    function = getattr(mavnav, name)
    assert entries(function) == list(inspect.signature(function).parameters)


def test_each_attribute_of_a_log_is_described() -> None:
    text = inspect.cleandoc(mavnav.Log.__doc__ or "").partition("Attributes\n----------\n")[2]
    public = [name for name in mavnav.Log.__struct_fields__ if not name.startswith("_")]
    assert re.findall(r"^(\w+)$", text, re.MULTILINE) == public
