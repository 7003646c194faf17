"""Values out of bounds are refused in one line that names the option."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

import mavnav as api
from mavnav.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("replay LOG --deskew yes", "--deskew: robust.deskew is 'yes', it should be 'auto', 'on' or 'off'"),
        ("replay LOG --search yes", "--search: search is 'yes', it should be 'pruned' or 'exhaustive'"),
        ("replay LOG --extrinsic=1e308,1e308,0", "--extrinsic '1e308,1e308,0' is farther than 1e+08 m from the origin"),
        ("replay LOG --map LOG --start-pose=0,-1e308,0", "--start-pose '0,-1e308,0' is farther than 1e+08 m"),
        ("simulate corner --set laser.period_ms=4e12", "--set laser.period_ms=4e12"),
        ("simulate corner --set laser.range_max_mm=1e300", "--set laser.range_max_mm=1e300"),
        ("simulate corner --set laser.range_min_mm=1e300", "--set laser.range_min_mm=1e300"),
        ("simulate corner --set planner.min_hits=10000000000000000000000", "--set planner.min_hits=1"),
        ("batch LOG --memory-mb 1000000000000000", "--memory-mb"),
    ],
)
def test_a_value_out_of_bounds_is_a_usage_error(mavnav: Callable, sample: Path, line: str, said: str) -> None:
    code, out, err = mavnav(*(sample if word == "LOG" else word for word in line.split()), "-q")
    assert (code, out, err.count("\n")) == (ExitCode.USAGE, "", 1), err
    assert said in err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("memory_mb: 1000000000000000", "memory_mb is 1000000000000000"),
        ("logs: [{log: a.mcap, extrinsic: [1.0e+308, 0, 0]}]", "is farther than 1e+08 m from the origin"),
        ("logs: [{log: a.mcap, extrinsic: [0, 0, 90]}]", "has a yaw of more than a turn; give it in rad"),
    ],
)
def test_a_manifest_has_the_same_bounds(mavnav: Callable, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "m.yaml").write_text(text)
    code, _, err = mavnav("batch", tmp_path / "m.yaml", "-q")
    assert (code, err.count("\n")) == (ExitCode.USAGE, 1)
    assert "m.yaml:1: " in err
    assert said in err


@pytest.mark.parametrize("pose", [(1e308, 0, 0), (0, -2e8, 0), (0, 0, 90), (float("inf"), 0, 0)])
def test_the_python_interface_has_the_same_bounds(sample: Path, pose: tuple[float, float, float]) -> None:
    with pytest.raises(UsageError, match=r"farther than|more than a turn|not finite"):
        api.replay(sample, extrinsic=pose)
