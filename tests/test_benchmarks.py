"""The benchmarks import, and those that draw and count what docs/paper.md shows run: a small case of each."""

from __future__ import annotations

import importlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent


@pytest.fixture
def benchmark_module(monkeypatch: pytest.MonkeyPatch):
    """Return a function that imports a benchmark."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module


def test_every_benchmark_imports() -> None:
    names = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py"))
    code = f"import sys; sys.path[:0] = ['benchmarks', 'tests', '.']; [__import__(name) for name in {names}]"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_table_of_missions_is_made(benchmark_module) -> None:
    readings: ModuleType = benchmark_module("readings")
    cases = [
        readings.Case("noise", (), ("corner-paper",), range(1)),
        readings.Case("blind", ("laser.range_max_mm=100",), ("corner-paper",), range(1)),
    ]
    with ThreadPoolExecutor(1) as ex:
        head, _, paper, robust, blind, _ = readings.missions(ex, cases)
    assert [row.count("|") for row in (paper, robust)] == [head.count("|")] * 2
    assert "| noise | paper | corner-paper | 1 of 1 | 100.0 |" in paper
    assert "nan" not in paper + robust
    assert "| blind | paper | corner-paper | 0 of 1 | 0.0 | - | - | - |" in blind
    assert blind.endswith("| 1 | 0, 0 |")


def test_features_are_collected_of_missions(benchmark_module) -> None:
    """None were: missions are judged by a function of their own."""
    run = benchmark_module("doubt").made(ROOT, "mission-corner/fly/0/0")
    assert run["features"]["tracks_disagree"] > 0.0


def test_the_table_of_wrong_matches_is_made(benchmark_module, monkeypatch: pytest.MonkeyPatch) -> None:
    readings: ModuleType = benchmark_module("readings")
    monkeypatch.setattr(readings, "CURVE", readings.CURVE[:: len(readings.CURVE) - 1])
    with ThreadPoolExecutor(1) as ex:
        lines = readings.gate(ex, ("corner-paper",), range(1), pairs=2)
    rows = [[cell.strip() for cell in line.split("|")] for line in lines[2:]]
    assert [row[1] for row in rows] == ["paper", "as the search ends (60 mm, any share)"]
    assert all(sum(map(int, row[2:6])) <= 2 * len(readings.PLACES) for row in rows)
    assert int(rows[0][2]) <= int(rows[1][2])


def test_the_table_of_the_search_has_the_named_readings_and_the_best_designs(
    benchmark_module, monkeypatch: pytest.MonkeyPatch
) -> None:
    readings: ModuleType = benchmark_module("readings")
    monkeypatch.setattr(readings, "NAMED", readings.NAMED[:1])
    monkeypatch.setattr(readings, "ABLATED", ("corner-paper",))
    with ThreadPoolExecutor(1) as ex:
        _, _, paper, design, _, values = readings.search(ex, None, 3, (2,), range(1))
    assert paper.startswith("| paper | 100 (21 to 100) | 1 of 1, 100 %, ") and design.startswith("| design 2 | ")
    assert values.startswith("* design 2: expert.gate_occlusion_mm=80, expert.gate_share=0.55, gate_mm2=")


def test_wrong_pairs_are_apart_and_alike_only_where_the_world_is(benchmark_module) -> None:
    readings: ModuleType = benchmark_module("readings")
    for pair in readings.wrong_pairs("corner", 1, 3):
        assert pair.world_T_map.between(pair.world_T_laser).distance_m >= 1.0
        same = pair._replace(world_T_laser=pair.world_T_map, scan=pair.mapped[0])
        assert readings.judged(same, readings.load_config("paper")) == "alike"


def test_the_figures_are_drawn(
    benchmark_module, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures: ModuleType = benchmark_module("figures")
    monkeypatch.setattr(figures, "PICTURES", tmp_path)
    figures.mission("fig2_3_corner", "corner-paper", ("scenario", "map"))
    figures.recorded("fig4", tmp_path / "missing.mcap")
    figures.grids("fig8_grids")
    assert {path.name for path in tmp_path.iterdir()} == {"fig2_3_corner.png", "fig8_grids.png"}
    out, err = capsys.readouterr()
    assert "goal reached: " in out
    assert "mm unaligned), map to true walls p95 " in out
    assert "skipped" in err
