"""Names that people type: answers to those of other tools and to mistakes, and what a repetition does."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from mavnav.batch.request import listed_settings, swept
from mavnav.comparison.pipeline import comparison_settings
from mavnav.config.layers import Layer
from mavnav.config.loading import load_config
from mavnav.errors import ConfigError, ExitCode
from mavnav.simulation.world.scenario_file import load_scenario

if TYPE_CHECKING:
    from tests.commands.conftest import Mavnav

SHORT = ("--end", "0.3", "--online", "-q")

ANSWERS = {
    "replay LOG --no-odom": "write --odom off",
    "replay LOG --duration 5": "write --end SECONDS, counted from the first scan",
    "replay LOG --out a": "write -o DIR",
    "replay LOG --output_dir=a": "write -o DIR",
    "replay LOG --map-resolution 0.05": "write --resolution METERS",
    "replay LOG --scan-topic /scan": "write --topic NAME",
    "compare LOG --laser-topic /scan": "write --topic NAME",
    "replay LOG --visualize": "'mavnav view RUN' shows the result",
    "info LOG --plot": "'mavnav view RUN' shows the result",
    "batch LOG --rate 2": "as fast as it can be",
    "replay LOG --from-bag": "see 'mavnav replay --help'",
    "info LOG --out a": "see 'mavnav info --help'",
    "run LOG": "write 'mavnav replay LOG'",
    "slam LOG": "write 'mavnav replay LOG'",
    "play LOG": "which plays the scans",
    "bag LOG": "write 'mavnav info LOG'",
    "plot RUN": "write 'mavnav view RUN'",
    "evaluate RUN": "write 'mavnav metrics RUN'",
    "drive.mcap": "write 'mavnav replay drive.mcap'",
    "replya LOG": "Did you mean 'replay', 'plan'?; see 'mavnav --help'",
    "replay drive.mcpa": "drive.mcpa: no such file; did you mean drive.mcap?",
    "info drive.mcpa": "did you mean drive.mcap?",
    "metrics drive.mcap": "map it with 'mavnav replay drive.mcap'",
    "replay out drive.mcap": "to write there, use -o out",
    "replay run": "run is no log, but a finished run; look at it with 'mavnav view'",
    "info run": "run is no log, but a finished run",
    "compare run": "name another to compare it with",
    "compare run drive.mcap": "drive.mcap is no finished run, others are",
    "compare run run --grid 5x5": "--grid is for logs",
    "replay drive.mcap --set azimuth=6 --set azimuth=8": "azimuth is given twice",
    "replay drive.mcap --resolution 50": "--resolution: robust.cell_mm is 50000.0, it should be",
    "replay drive.mcap --topic /none -o run": "/none",
    "replay drive.mcap --truth none.tum -o run": "none.tum",
    "replay drive.mcap --gate tracking.lots==1 -o run": "tracking.lots",
}


@pytest.mark.parametrize(("line", "answer"), ANSWERS.items())
def test_a_wrong_name_is_answered_in_a_line(
    line: str, answer: str, mavnav: Mavnav, sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("drive.mcap").symlink_to(sample)
    Path("run").mkdir()
    Path("run", "run.json").write_text("{}")
    code, out, error = mavnav(*line.split())
    assert (code, out) == (ExitCode.USAGE, "")
    assert answer in error.splitlines()[-1]
    assert len(error.splitlines()) == 1


def test_no_name_is_suggested_that_would_not_help(
    mavnav: Mavnav, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("drive\nlong", "drive\udcfflong"):
        Path(name).mkdir()
    Path("loop").symlink_to("loop")
    for command in ("metrics", "replay"):
        for wrong in ("drive\\nlong", "drive\\udcfflong", "loop"):
            code, _, err = mavnav(command, wrong)
            assert (code, "did you mean" in err) == (2, False), err
    for key in ("vehicle.bogus", "slam.robust.expert.bogus"):
        err = mavnav("simulate", "corner", "--set", f"{key}=2")[2]
        assert (f"unknown key {key}; " in err, f"mean {key.rpartition('.')[0]}?" in err) == (True, False), err


@pytest.mark.parametrize("method", ["robust", "paper"])
def test_the_resolution_is_the_cell_of_the_method_in_use(method: str) -> None:
    sets = [f"method={method}", "robust.cell_mm=11", "paper.cell_mm=11"]
    cells = {
        name: getattr(load_config(None, sets, {"resolution_m": 0.07}), name).cell_mm for name in ("robust", "paper")
    }
    assert cells == {"robust": 11, "paper": 11} | {method: 70.0}
    (listed,) = listed_settings([{"method": method, "resolution_m": 0.07}], Layer(), Path(), [], {})
    assert getattr(listed.config, method).cell_mm == 70.0
    mission = load_scenario("corner", [], {"slam.method": method, "slam.resolution_m": 0.07}).slam
    assert getattr(mission, method).cell_m == pytest.approx(0.07)


def test_settings_with_several_values_are_crossed() -> None:
    assert swept(["a=1,2", "b=x", "a=3", "c"]) == [[f"a={a}", "b=x", "c"] for a in (1, 2, 3)]
    assert swept(["a=[1, 2]", "s={b: 1, c: 2}"]) == [["a=1", "s={b: 1, c: 2}"], ["a=2", "s={b: 1, c: 2}"]]
    settings = comparison_settings(None, ["robust.cell_mm=10,20", "odom=auto,off"], (), (), (), {})
    assert [each.differs for each in settings] == [
        f"odom={odom} robust.cell_mm={cell}" for cell in (10, 20) for odom in ("auto", "off")
    ]
    grids = comparison_settings(None, [], (), ["5x5", "10x10"], (), {})
    assert [each.differs for each in grids] == ["", ""]
    with pytest.raises(ConfigError, match="given twice"):
        load_config(None, ["azimuth=6", "azimuth = 8"])


def test_a_command_that_is_repeated_writes_beside_and_compares(
    mavnav: Mavnav, sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert mavnav("replay", sample, *SHORT, "--outputs", "trajectory,map,metrics,mcap")[0] == ExitCode.DONE
    assert sorted(each.name for each in Path("runs").iterdir()) == [
        "corridor-robust-20-10x10",
        "corridor-robust-20-10x10-2",
        "latest",
    ]
    assert Path("runs/latest").resolve().name == "corridor-robust-20-10x10-2"
    _, out, _ = mavnav("check", *sorted(Path("runs").iterdir()), "--json")
    assert [row["run"] for row in json.loads(out)["runs"]] == [
        f"runs/corridor-robust-20-10x10{end}" for end in ("", "-2")
    ]
    assert mavnav("replay", sample, *SHORT, "-o", "runs/latest")[0] == ExitCode.OUTPUT

    shutil.move("runs/corridor-robust-20-10x10-2", "moved")
    code, out, _ = mavnav("compare", "runs/corridor-robust-20-10x10", "moved", "-q", "--json")
    document: dict[str, Any] = json.loads(out)
    assert code == ExitCode.DONE
    assert [cell["differs"] for cell in document["cells"]] == ["corridor-robust-20-10x10", "moved"]
    assert "robust 20/10x10 moved" in Path("runs/compare-runs/report.html").read_text("utf-8")
    assert not Path("runs/compare-runs/cells").exists()
    code, _, err = mavnav("compare", "moved", "runs/../moved", "-q")
    assert (code, "moved is a finished run; name another to compare it with" in err) == (ExitCode.USAGE, True)
    code, _, err = mavnav("compare", sample, *SHORT, "--grid", "10x10", "-o", "runs/compare-runs", "-q")
    assert (code, err) == (ExitCode.DONE, "")
    assert {each.name for each in Path("runs/compare-runs").glob("comparison.*")} == {
        f"comparison.{x}" for x in ("json", "csv", "md")
    }
