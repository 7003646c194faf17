"""What a command reads is not deleted by what it writes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

import mavnav as api
from mavnav.errors import ExitCode, UsageError
from support.changed_rooms import mapped, rooms, saved


@pytest.fixture
def folder(sample: Path, repo_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Be in a folder with a log, and a run directory with files that commands read."""
    monkeypatch.chdir(tmp_path)
    Path("r").mkdir()
    for place in (Path(), Path("r")):
        shutil.copy(sample, place / "log.mcap")
    Path("r/run.json").write_text("{}")
    Path("r/c.yaml").write_text("azimuth: 20\n")
    Path("r/s.yaml").write_text((repo_root / "configs" / "corner.yaml").read_text())
    for name in ("map.yaml", "truth.tum", "pairs.relations", "plan.pgm"):
        Path("r", name).touch()
    Path("plan.yaml").write_text("image: r/plan.pgm\nresolution: 0.05\n")
    return tmp_path


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("replay r/log.mcap", "r/log.mcap"),
        ("replay log.mcap --config r/c.yaml", "r/c.yaml"),
        ("replay log.mcap --map r", "r"),
        ("replay log.mcap --map r/map.yaml", "r/map.yaml"),
        ("replay log.mcap --truth r/truth.tum", "r/truth.tum"),
        ("replay log.mcap --truth-map r/map.yaml", "r/map.yaml"),
        ("replay log.mcap --map plan.yaml", "r/plan.pgm"),
        ("replay log.mcap --truth-map plan.yaml", "r/plan.pgm"),
        ("replay log.mcap --relations r/pairs.relations", "r/pairs.relations"),
        ("simulate r/s.yaml", "r/s.yaml"),
        ("simulate corner --config r/c.yaml", "r/c.yaml"),
        ("merge log.mcap r/log.mcap", "r/log.mcap"),
        ("merge log.mcap log.mcap --config r/c.yaml", "r/c.yaml"),
    ],
)
def test_an_input_in_the_output_directory_is_kept(mavnav: Callable, folder: Path, line: str, name: str) -> None:
    Path("r/merge.json").write_text("{}")
    before = {path: path.read_bytes() for path in Path("r").iterdir()}
    code, out, err = mavnav(*line.split(), "-o", "r", "--force", "-q")
    assert (code, out) == (ExitCode.USAGE, "")
    assert err == (
        f"mavnav: error: {name} is an input, and would be lost if r were replaced; choose another directory with -o\n"
    )
    assert {path: path.read_bytes() for path in Path("r").iterdir()} == before


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("calibrate c.json -o c.json", "c.json"),
        ("calibrate link.json -o c.json", "link.json"),
        ("calibrate log.mcap --config c.json -o c.json", "c.json"),
        ("calibrate bag -o bag/found.json", "bag"),
        ("diff m/map.yaml m -o m/map.png", "m/map.png"),
        ("diff m m/map.yaml -o m/map.png", "m/map.png"),
        ("diff m/map.yaml m --report m/page.html", "m/page.html"),
        ("simulate s.mcap --record s.mcap", "s.mcap"),
        ("simulate s.gif --animate s.gif", "s.gif"),
        ("simulate corner --config c.gif --animate c.gif", "c.gif"),
        ("simulate bag/s.yaml --record bag", "bag/s.yaml"),
    ],
)
def test_an_input_is_not_overwritten_by_a_file(mavnav: Callable, folder: Path, line: str, name: str) -> None:
    saved(mapped(rooms()), Path("m"))
    picture = Image.new("L", (40, 40), 254)
    picture.putpixel((3, 3), 0)
    for path in ("m/map.png", "m/page.html"):
        picture.save(path, format="PNG")
    image = "page.html" if "page" in line else "map.png"
    Path("m/map.yaml").write_text(f"image: {image}\nresolution: 0.05\norigin: [0, 0, 0]\n")
    Path("bag").mkdir()
    Path("bag/metadata.yaml").touch()
    Path("bag/bag.mcap").write_bytes(Path("log.mcap").read_bytes())
    shutil.copy("bag/bag.mcap", "c.json")
    if "--config" in line:
        for path in ("c.json", "c.gif"):
            Path(path).write_text("{azimuth: 20}")
    Path("link.json").symlink_to("c.json")
    for path in ("s.mcap", "s.gif", "bag/s.yaml"):
        shutil.copy("r/s.yaml", path)
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    code, out, err = mavnav(*line.split(), "--force", "-q")
    option, file = line.split()[-2:]
    assert (code, out) == (ExitCode.USAGE, "")
    assert err == (
        f"mavnav: error: {'--output' if option == '-o' else option}: {file} would overwrite {name}, which is an input; "
        "name another file\n"
    )
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before


def test_an_input_in_the_directory_of_a_cell_is_kept(mavnav: Callable, folder: Path) -> None:
    few = ("--end", 1, "-q", "-j", 1, "-o", "b", "--grid", "5x5")
    assert mavnav("batch", "log.mcap", *few)[0] == 0
    (cell,) = Path("b/cells").iterdir()
    kept = cell / "log.mcap"
    shutil.copy("log.mcap", kept)
    assert mavnav("batch", kept, *few, "--force")[0] == ExitCode.USAGE
    assert f"{kept} is an input" in json.loads(Path("b/batch.json").read_text())["cells"][0]["error"]
    assert kept.is_file()


def test_the_python_interface_keeps_inputs_too(folder: Path) -> None:
    for call in (
        lambda: api.replay("log.mcap", config="r/c.yaml", directory="r", force=True),
        lambda: api.simulate("corner", config="r/c.yaml", directory="r", force=True),
    ):
        with pytest.raises(UsageError, match=r"r/c\.yaml is an input"):
            call()


def test_a_run_beside_its_log_is_replaced(mavnav: Callable, folder: Path) -> None:
    assert mavnav("replay", "log.mcap", "-o", "r", "--force", "-q", "--end", 1, "--outputs", "trajectory")[0] == 0
    assert json.loads(Path("r/run.json").read_text())["input"]["path"] == "log.mcap"
    assert Path("log.mcap").is_file()
