"""Commands that run at once in one folder keep their results apart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mavnav import atomic_files

if TYPE_CHECKING:
    from collections.abc import Callable

FEW = ("--end", "0.5", "--online", "-q", "--grid", "5x5", "--outputs", "trajectory")


@pytest.mark.parametrize(("owner", "name"), [("1", "x-2"), ("4194304", "x"), ("none", "x")])
def test_a_replay_takes_no_name_that_a_running_one_has_taken(
    mavnav: Callable, sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: str, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    runs = Path("runs")
    runs.mkdir()
    usual = f"{sample.stem}-robust-10-5x5"
    (runs / f".{usual}.claim").symlink_to(f"{atomic_files.machine()}-{owner}")
    assert mavnav("replay", sample, *FEW)[0] == 0
    claims = {f".{usual}.claim"} if owner == "1" else set()
    assert {path.name for path in runs.iterdir()} == {"latest", name.replace("x", usual, 1), *claims}


def test_a_command_that_fails_leaves_no_claim(
    mavnav: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty.mcap").touch()
    assert mavnav("replay", "empty.mcap")[0] != 0
    assert [path.name for path in tmp_path.iterdir()] == ["empty.mcap"]
