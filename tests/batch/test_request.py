"""Settings: every method with every grid, a manifest's runs, and the names by which they are known."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavnav.batch.manifest import read_manifest
from mavnav.batch.request import crossed_settings, listed_settings
from mavnav.errors import ConfigError, UsageError


def names(*, methods=(), grids=(), azimuths=(), sets=(), options=None, file=None) -> list[str]:
    return [s.name for s in crossed_settings(file, sets, methods, grids, azimuths, options or {})]


def test_without_anything_there_is_one() -> None:
    assert names() == ["robust 20/10x10"]


def test_every_method_with_every_grid() -> None:
    assert names(methods=("robust", "paper"), grids=("5x5", "20x20")) == [
        "robust 10/5x5",
        "robust 40/20x20",
        "paper 10/5x5",
        "paper 40/20x20",
    ]


def test_azimuth_grids() -> None:
    assert names(azimuths=(40,)) == ["robust 40/10x10"]
    assert names(grids=("5x5", "9x9"), azimuths=(40,)) == ["robust 40/5x5", "robust 40/9x9"]
    assert names(grids=("5x5", "9x9"), azimuths=(10, 40)) == ["robust 10/5x5", "robust 40/9x9"]
    with pytest.raises(UsageError, match="2 values of --azimuth for 1 grids"):
        names(grids=("5x5",), azimuths=(10, 40))


def test_whatever_is_unusual_is_in_the_name() -> None:
    assert names(sets=("robust.cell_mm=25",), options={"final_pass": False}) == [
        "robust 20/10x10 final_pass=false robust.cell_mm=25"
    ]
    assert names(sets=("paper.cell_mm=25",)) == ["robust 20/10x10"]


def test_what_comes_twice_is_one() -> None:
    assert names(grids=("5x5", "5x5")) == ["robust 10/5x5"]


def manifest(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "night.yaml"
    path.write_text(text)
    read, layer = read_manifest(path)
    return [s.name for s in listed_settings(read.runs, layer, tmp_path, ("azimuth=30",), {})]


def test_runs_have_the_keys_of_a_configuration(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("robust: {cell_mm: 40}\n")
    text = """
runs:
  - {}
  - method: paper
    grid: 20x20
  - {config: mine.yaml, robust: {voxel_mm: 20}}
  - {name: coarse, config: mine.yaml}
"""
    assert manifest(tmp_path, text) == [
        "robust 30/10x10",
        "paper 30/20x20",
        "robust 30/10x10 robust.cell_mm=40 robust.voxel_mm=20",
        "coarse",
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("runs:\n  - {robust: {cel_mm: 4}}", r"night.yaml:2: unknown key robust.cel_mm; did you mean robust.cell_mm\?"),
        ("runs:\n  - {}\n  - {grid: 1x1}", r"night.yaml:3: grid is '1x1', it should be NxM"),
        ("runs:\n  - {name: [a]}", r"night.yaml:2: name is \['a'\]; give it a word"),
        ("runs:\n  - {config: gone.yaml}", r"gone.yaml: no such file"),
        ("runs:\n  - {name: a}\n  - {name: a, grid: 5x5}", "two runs are named 'a'"),
        ("rnus: []", r"night.yaml:1: unknown key rnus; did you mean runs\?"),
        ("logs: [{lgo: a.bag}]", r"night.yaml:1: unknown key logs.0.lgo; did you mean logs.0.log\?"),
        ("jobs: 0", r"night.yaml:1: jobs is 0"),
    ],
)
def test_mistakes_are_told_with_their_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        manifest(tmp_path, text)


def test_a_log_is_a_word_or_a_section(tmp_path: Path) -> None:
    path = tmp_path / "night.yaml"
    path.write_text("logs: [a.bag, {log: [b.bag, c.bag], topic: /scan, accept: 3, gates: 'scans.accepted>1'}]")
    first, second = read_manifest(path)[0].logs
    assert (first.log, second.log, second.topic, second.accept) == (("a.bag",), ("b.bag", "c.bag"), "/scan", (3,))
    assert second.gates == ("scans.accepted>1",)
