"""Values out of bounds are refused in one line that names the option."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mavnav.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("replay LOG --deskew yes", "--deskew: robust.deskew is 'yes', it should be 'auto', 'on' or 'off'"),
        ("replay LOG --search yes", "--search: search is 'yes', it should be 'pruned' or 'exhaustive'"),
    ],
)
def test_a_value_out_of_bounds_is_a_usage_error(mavnav: Callable, sample: Path, line: str, said: str) -> None:
    code, out, err = mavnav(*(sample if word == "LOG" else word for word in line.split()), "-q")
    assert (code, out, err.count("\n")) == (ExitCode.USAGE, "", 1), err
    assert said in err
