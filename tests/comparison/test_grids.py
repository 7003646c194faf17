"""Grids, yaw samples and methods of a comparison."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavnav.comparison.pipeline import comparison_settings
from mavnav.config.models import Config, GridSize, paired_yaw_samples
from mavnav.errors import ConfigError, UsageError


def chosen(*grids: str, azimuths: tuple[int, ...] = (), methods: tuple[str, ...] = (), sets: tuple[str, ...] = ()):
    found = comparison_settings(None, sets, methods, grids, azimuths, {})
    return [(s.config.method, s.config.azimuth, str(s.config.grid)) for s in found]


def test_the_papers_pairs() -> None:
    pairs = {n: paired_yaw_samples(GridSize(nx=n, ny=n)) for n in (5, 10, 20, 40, 80)}
    assert pairs == {5: 10, 10: 20, 20: 40, 40: 40, 80: 40}
    assert paired_yaw_samples(GridSize(nx=4, ny=9)) == 18
    assert paired_yaw_samples(Config().grid) == Config().azimuth


def test_no_grid_means_the_papers_three() -> None:
    assert chosen() == [("robust", 10, "5x5"), ("robust", 20, "10x10"), ("robust", 40, "20x20")]


def test_one_grid_is_compared_with_the_default() -> None:
    assert chosen("20x20") == [("robust", 20, "10x10"), ("robust", 40, "20x20")]
    assert chosen("5x5") == [("robust", 10, "5x5"), ("robust", 20, "10x10")]
    assert chosen("10x10") == [("robust", 20, "10x10")]
    assert chosen("20x20", sets=("grid=8x8",)) == [("robust", 16, "8x8"), ("robust", 40, "20x20")]


def test_azimuth_for_all_for_each_and_for_the_one() -> None:
    assert chosen("20x20", "5x5", azimuths=(30,)) == [("robust", 30, "5x5"), ("robust", 30, "20x20")]
    assert chosen("20x20", "5x5", azimuths=(40, 9)) == [("robust", 9, "5x5"), ("robust", 40, "20x20")]
    assert chosen("20x20", azimuths=(50,)) == [("robust", 20, "10x10"), ("robust", 50, "20x20")]
    assert chosen("20x20", "20x20", azimuths=(40, 20)) == [("robust", 20, "20x20"), ("robust", 40, "20x20")]
    with pytest.raises(UsageError, match="3 values of --azimuth for 2 grids"):
        chosen("20x20", "5x5", azimuths=(1, 2, 3))


def test_a_configured_azimuth_goes_with_every_grid(tmp_path: Path) -> None:
    assert chosen("20x20", "5x5", sets=("azimuth=25",)) == [("robust", 25, "5x5"), ("robust", 25, "20x20")]


def test_methods_bring_their_presets() -> None:
    found = comparison_settings(None, (), ("paper", "robust"), ("5x5", "6x6"), (), {"odom": "auto"})
    assert [(s.config.method, str(s.config.grid), s.config.final_pass) for s in found] == [
        ("paper", "5x5", False),
        ("paper", "6x6", False),
        ("robust", "5x5", True),
        ("robust", "6x6", True),
    ]
    assert len(chosen("5x5", "6x6", methods=("paper", "paper"))) == 2


def test_values_that_no_configuration_takes() -> None:
    for grids, azimuths, methods in ((("5",), (), ()), (("5x5", "6x6"), (1,), ()), (("5x5",), (), ("best",))):
        with pytest.raises(ConfigError):
            chosen(*grids, azimuths=azimuths, methods=methods)
