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
        ("batch LOG --memory-mb 1000000000000000", "--memory-mb"),
    ],
)
def test_a_value_out_of_bounds_is_a_usage_error(mavnav: Callable, sample: Path, line: str, said: str) -> None:
    code, out, err = mavnav(*(sample if word == "LOG" else word for word in line.split()), "-q")
    assert (code, out, err.count("\n")) == (ExitCode.USAGE, "", 1), err
    assert said in err


def test_the_memory_in_a_manifest_has_the_same_bound(mavnav: Callable, tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text("memory_mb: 1000000000000000\n")
    code, _, err = mavnav("batch", tmp_path / "m.yaml", "-q")
    assert (code, err.count("\n")) == (ExitCode.USAGE, 1)
    assert "m.yaml:1: memory_mb is 1000000000000000" in err
