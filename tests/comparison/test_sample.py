"""The log to compare where none is given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavnav.comparison import sample
from mavnav.ground_truth.references import read_true_map
from mavnav.logs import open_log
from mavnav.profiling import silent

ROOT = Path(__file__).parents[2]


def test_a_checkout_has_it(tmp_path: Path) -> None:
    assert sample.sample_log(tmp_path, silent) == ROOT / "sample_logs" / "corridor.mcap"
    assert list(tmp_path.iterdir()) == []


def test_it_is_the_mission_of_the_shipped_log() -> None:
    seed, *sets = sample.SETS
    options = " ".join([f"--{seed.replace('=', ' ')}", *(f"--set {text}" for text in sets)])
    command = f"mavnav simulate {sample.SCENARIO} {options} --record corridor.mcap"
    assert command in (ROOT / "sample_logs" / "README.md").read_text()


def test_elsewhere_it_is_flown_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sample, "SHIPPED", tmp_path / "nowhere.mcap")
    monkeypatch.setattr(sample, "SETS", (*sample.SETS, "max_steps=4"))
    log = sample.sample_log(tmp_path / "out", silent)
    assert log.parent == tmp_path / "out" / "logs"
    assert open_log(log).counts.usable >= 4
    monkeypatch.setattr(sample, "fly", lambda *_: pytest.fail("it is there"))
    assert sample.sample_log(tmp_path / "out", silent) == log


def test_its_true_map_is_where_the_walls_are(tmp_path: Path) -> None:
    true, _ = read_true_map(sample.sample_truth(tmp_path))
    scan = next(iter(open_log(ROOT / "sample_logs" / "corridor.mcap").scans()))
    assert np.median(true.distance_m(scan.points())) < 0.02  # the noise; the laser stands 0.06 m before the base
    assert len(true.segments_map) > 10
