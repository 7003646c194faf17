"""The Python interface: what its page and its notebook show is run here."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import sys
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image

import mavnav
from support.sessions import cut, tour, written

ROOT = Path(__file__).parent.parent
EXAMPLES = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs/python.md").read_text(), re.MULTILINE | re.DOTALL)


LOG = ROOT / "sample_logs" / "complex.bag"


@pytest.fixture(scope="module")
def log() -> Path:
    return LOG


@pytest.fixture(scope="module")
def run(log: Path) -> mavnav.Run:
    return mavnav.replay(log, end_s=2)


@pytest.fixture
def folder(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder to work in, with a log as the examples call it."""
    shutil.copy(log, tmp_path / "drive.bag")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("number", range(3))
def test_the_examples_run(number: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(EXAMPLES) == 3
    exec(compile(EXAMPLES[number], f"example {number}", "exec"), {})
    assert capsys.readouterr().out
    assert (folder / "runs/first/run.json").is_file() == (number == 0)


@pytest.mark.slow
def test_the_notebook_prints_what_is_in_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    shown = []
    monkeypatch.setattr(pyplot, "show", lambda: (shown.append(pyplot.gcf()), pyplot.close()))
    pytest.importorskip("pandas")
    cells = json.loads((ROOT / "docs/first_map.ipynb").read_text())["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
            stored = ["".join(each["text"]) for each in cell["outputs"] if each["output_type"] == "stream"]
            assert capsys.readouterr().out == "".join(stored)
            assert sum("data" in each for each in cell["outputs"]) == len(shown)
            shown.clear()


def test_a_run_has_what_its_files_say(run: mavnav.Run, tmp_path: Path) -> None:
    assert run.trajectory.xyyaw.shape == (len(run.trajectory.stamps_ns), 3)
    assert run.metrics["scans"]["tracked"] == len(run.trajectory)
    assert int((run.map.hits > 0).sum()) == run.metrics["map"]["cells"]
    assert not run.lost
    assert 0.0 <= (run.doubt or 0.0) <= 1.0
    kept = run.save(tmp_path / "kept")
    again = mavnav.load_run(tmp_path / "kept")
    np.testing.assert_array_equal(again.trajectory.xyyaw, run.trajectory.xyyaw)
    with pytest.raises(mavnav.OutputError, match=r"exists; .* or force=True to replace"):
        run.save(kept.directory)
    assert run.save(kept.directory, force=True).metrics == run.metrics


def test_a_frame_has_the_columns_of_the_table(run: mavnav.Run) -> None:
    pytest.importorskip("pandas")
    frame = run.frame()
    header = (run.directory / "trajectory.csv").read_text().partition("\n")[0].split(",")
    assert list(frame.columns) == [name for name in header if name != "stamp"]
    assert len(frame) == run.metrics["scans"]["processed"]
    tracked = frame[frame["tracked"]]
    np.testing.assert_array_equal(tracked.index.asi8, run.trajectory.stamps_ns)
    np.testing.assert_allclose(tracked[["x_m", "y_m", "yaw_rad"]], run.trajectory.xyyaw, atol=1e-6)
    assert (frame["beams_used"].dtype, frame["doubtful"].dtype) == (np.int64, np.bool_)


def test_a_run_shows_itself(run: mavnav.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    text = run._repr_html_()
    assert run.verdict["reason"] in text
    picture = b64decode(re.search(r'src="data:image/png;base64,([^"]+)"', text)[1])
    assert picture == (run.directory / "map.png").read_bytes()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with Image.open(run.directory / "map.png") as stored:
        assert run.plot().size == stored.size


def test_a_plot_has_map_and_path(run: mavnav.Run) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    axes = pyplot.subplots()[1]
    assert run.plot(axes) is axes
    left, right, low, high = axes.images[0].get_extent()
    xy_m = np.array(axes.lines[0].get_xydata(), float)
    assert np.isfinite(xy_m).all(axis=1).sum() == len(run.trajectory)
    assert ((xy_m > (left, low)) & (xy_m < (right, high)))[np.isfinite(xy_m).all(axis=1)].all()
    pyplot.close()


def test_records_print_in_one_line(run: mavnav.Run, log: Path) -> None:
    opened = mavnav.open_log(log)
    scan = next(iter(opened))
    for record in (run, run.trajectory, run.map, opened, scan, scan.spec):
        assert "\n" not in repr(record)
        assert len(repr(record)) < 400
    assert (
        repr(run.trajectory)
        == f"Trajectory(stamps_ns=int64[{len(run.trajectory)}], xyyaw=float64[{len(run.trajectory)}, 3])"
    )


def test_logs_and_runs_are_examined_as_by_the_commands(
    log: Path, run: mavnav.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from mavnav.cli import run as command

    def printed(*words: object) -> dict[str, object]:
        command([*map(str, words), "--json"])
        return json.loads(capsys.readouterr().out)

    assert mavnav.info(log) == printed("info", log, "-q")
    assert mavnav.metrics(run) == printed("metrics", run.directory, "-q")["maps"]
    gate = "wall_thickness.p95_mm<=1"
    assert mavnav.check(run, gates=gate) == printed("check", run.directory, "--gate", gate)["runs"]
    done = mavnav.convert(log, tmp_path / "a.mcap")
    assert done["messages"] == printed("convert", log, tmp_path / "b.mcap", "-q")["messages"]


def test_a_batch_and_a_sweep_have_their_runs(log: Path, tmp_path: Path) -> None:
    log = written(cut(tour("hall"), 6)[0], tmp_path / "drive.mcap")
    sweep = {"robust.cell_mm": [20, 40]}
    done = mavnav.batch(log, grids=[(5, 5)], settings=sweep, online=True, workers=1, gates="tracking.lost==true")
    assert [run.metrics["map"]["cell_mm"] for run in done.runs.values()] == [20, 40]
    assert done.document["exit_code"] == 1
    compared = mavnav.compare(log, grids=[(5, 5)], settings=sweep, online=True, workers=1)
    assert list(compared.runs) == [f"drive.mcap robust 10/5x5 robust.cell_mm={cell}" for cell in (20, 40)]


def test_a_run_without_a_directory_goes_with_its_object(log: Path) -> None:
    run = mavnav.replay(log, end_s=0.5, online=True)
    where = run.directory
    assert (where / "run.json").is_file()
    del run
    assert not where.exists()


def test_the_same_as_the_command(log: Path, run: mavnav.Run, tmp_path: Path) -> None:
    from mavnav.cli import run as command

    assert command(["replay", str(log), "--end", "2", "-q", "-o", str(tmp_path / "run")]) == 0
    for name in ("trajectory.tum", "hits.npz", "map.pgm", "map.png"):
        assert (tmp_path / "run" / name).read_bytes() == (run.directory / name).read_bytes()


def test_the_files_are_those_of_the_outputs(log: Path, tmp_path: Path) -> None:
    for outputs, report in (("map", False), (["trajectory", "map"], True)):
        run = mavnav.replay(log, end_s=1, outputs=outputs, report=report, directory=tmp_path / str(report))
        names = {path.name for path in run.directory.iterdir()}
        assert {"trajectory.tum" in names, "report.html" in names} == {report}
        assert "hits.npz" in names
        assert "result.mcap" not in names


def test_steps_of_scans_are_those_of_the_command_on_line(log: Path) -> None:
    opened = mavnav.open_log(log, end_s=2)
    found = [step.match.map_T_laser for step in mavnav.track(opened, period_s=opened.period_s) if step.tracked]
    run = mavnav.replay(log, end_s=2, online=True, odom="off")
    np.testing.assert_allclose(found, run.trajectory.xyyaw, atol=1e-6)


def test_a_mission(tmp_path: Path) -> None:
    run = mavnav.simulate("corner", seed=3, settings={"max_steps": 4}, record=tmp_path / "flight.mcap")
    assert run.metrics["mission"]["steps"] == 5
    assert len(mavnav.open_log(tmp_path / "flight.mcap")) > 0


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: mavnav.replay("nothing.mcap"), "no such file"),
        (lambda: mavnav.replay("nothing.mcap", settings={"robust.cel_mm": 3}), "did you mean robust.cell_mm"),
        (lambda: mavnav.load_run("."), "holds no run"),
        (lambda: mavnav.compare([]), r"log is \[\]; give at least one"),
        (lambda: mavnav.metrics([]), r"maps is \[\]; give at least one"),
        (lambda: mavnav.check([]), r"runs is \[\]; give at least one"),
        (lambda: mavnav.replay(LOG, start_s="1"), "start_s '1' is no time; it counts in seconds"),
        (lambda: mavnav.simulate("nowhere"), "nowhere"),
        (lambda: mavnav.open_log("nothing.mcap"), "no such file"),
        (lambda: mavnav.open_log(3), "path is 3; give a path"),
        (lambda: mavnav.open_log("a", topic=[3]), r"topic is \[3\]; give the name of a topic, or a list"),
        (lambda: mavnav.replay("a", grid=(5,)), r"grid is \(5,\); give the points in x and y"),
        (lambda: mavnav.replay("a", grid="5"), "^grid: grid is '5', it should be NxM"),
        (lambda: mavnav.replay("a", resolution_m=5), "^resolution_m: robust.cell_mm is 5000"),
        (lambda: mavnav.replay("a", settings={"robust.cell_mm": 0}), "^settings {'robust.cell_mm': 0}: robust.cell_mm"),
        (lambda: mavnav.replay(LOG, start_s=5, end_s=1), "end_s must be later than start_s"),
        (lambda: mavnav.replay(LOG, outputs="maps"), "^outputs: unknown 'maps'; known are trajectory"),
        (lambda: mavnav.replay(LOG, directory=ROOT), "choose another directory with directory"),
        (lambda: mavnav.metrics("nothing"), "no such file"),
        (lambda: mavnav.check("nothing"), "name the directory of a finished run"),
        (lambda: mavnav.check(LOG, gates="walls"), "walls"),
        (lambda: mavnav.info("nothing.mcap"), "no such file"),
        (lambda: mavnav.batch(LOG, grids=[5]), "grids? is 5; give the points"),
        (lambda: mavnav.open_log("a", extrinsic=(0, 0)), "x, y and yaw"),
        (lambda: mavnav.open_log("a", extrinsic=(0, 0, 90)), "in rad"),
        (lambda: mavnav.open_log("a", extrinsic=(0, 0, float("nan"))), "finite"),
        (lambda: mavnav.replay("a", settings=["robust.cell_mm=3"]), "give a dictionary"),
        (lambda: mavnav.replay("a", settings={"robust.cell_mm": np.array(3)}), "no plain type"),
        (lambda: mavnav.replay("a", start_pose=(0, 0, 0)), "give that with map"),
        (lambda: mavnav.replay("a", align="wall"), "^align 'wall' is neither walls"),
        (lambda: mavnav.replay("a", align=(0, 0)), "^align '0,0' is neither walls"),
        (lambda: mavnav.replay("a", align=3), "align is 3; give a list"),
        (lambda: mavnav.replay(LOG, align="walls", online=True), "align draws the finished map again"),
        (lambda: mavnav.compare(3), "log is 3; give a list"),
        (lambda: mavnav.compare("a", grids=3.5), "grids is 3.5; give a list"),
        *(
            (lambda n=n: mavnav.compare("a", workers=n), f"workers is {n!r}; give a whole number of at least 1")
            for n in (-1, 0, 1.5, "2", True)
        ),
        (lambda: mavnav.track([], period_s=0.0), "period_s is 0.0"),
        (lambda: list(mavnav.track([3])), "scan 0 is a int"),
    ],
)
def test_errors_are_one_line(call, said: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(mavnav.MavnavError, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: mavnav.replay("a", output="b"), "replay has no argument output; did you mean directory?"),
        (lambda: mavnav.replay("a", end=3.0), "replay has no argument end; did you mean end_s?"),
        (lambda: mavnav.batch("a", job=3), "batch has no argument job; help(mavnav.batch) lists those it has"),
        (lambda: mavnav.batch("a", jobs=3), "batch has no argument jobs; did you mean workers?"),
        (lambda: mavnav.open_log("a", topics="b"), "open_log has no argument topics; did you mean topic?"),
        (lambda: mavnav.track([], methods="b"), "track has no argument methods; did you mean method?"),
        (mavnav.replay, "missing a required argument: 'log'"),
    ],
)
def test_an_unknown_argument_is_answered_by_the_nearest(call, said: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(TypeError) as caught:
        call()
    assert str(caught.value) == said


SPEC = mavnav.LaserSpec(-np.pi / 2, np.pi / 180, 181, 0.1, 10.0)
SEEN = np.full(181, 2.0)


def scans_of(**changes: object) -> list[mavnav.Scan]:
    """Return two scans of a round room, the second one with changes."""
    scans = [mavnav.Scan(stamp_ns, SEEN.copy(), SPEC) for stamp_ns in (0, 10**8)]
    return [scans[0], replace(scans[1], **changes)]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"ranges_m": np.full(200, 2.0)}, r"scan 1: ranges_m has shape \(200,\), but its spec has 181 beams"),
        ({"ranges_m": np.full(20, 2.0)}, r"shape \(20,\)"),
        ({"ranges_m": np.full((1, 181), 2.0)}, r"shape \(1, 181\)"),
        ({"ranges_m": np.array(["far"] * 181)}, "no numbers"),
        ({"ranges_m": np.array([object()] * 181)}, "no numbers"),
        ({"ranges_m": np.full(181, 2.0 + 1.0j)}, "no numbers"),
        ({"ranges_m": np.zeros(0)}, r"shape \(0,\)"),
        ({"ranges_m": np.zeros(0), "spec": replace(SPEC, beams=0)}, "beams=0"),
        ({"ranges_m": np.array(2.0)}, r"shape \(1,\)"),
        ({"ranges_m": np.full(181, "2020-01-01", "M8[ns]")}, "no numbers"),
        ({"stamp_ns": -1}, "stamp_ns -1, no later"),
        ({"stamp_ns": None}, "whole ns"),
        ({"stamp_ns": True}, "whole ns"),
        ({"stamp_ns": 1 << 70}, "whole ns"),
        ({"times_s": np.zeros(20)}, r"times_s has shape \(20,\)"),
        ({"times_s": np.full(181, np.nan)}, "times_s are not all finite"),
        ({"stamp_ns": 0}, "stamp_ns 0, no later than the scan before"),
        ({"stamp_ns": 0.5}, "whole ns"),
        ({"spec": replace(SPEC, beams=-4)}, "beams=-4"),
        ({"spec": replace(SPEC, beams=180.5)}, "beams=180.5"),
        ({"spec": replace(SPEC, range_max_m=0.05)}, "range_max_m=0.05"),
        ({"spec": replace(SPEC, angle_step_rad=0.0)}, "step of 0"),
        ({"spec": replace(SPEC, angle_min_rad="left")}, "not finite"),
    ],
)
def test_scans_that_do_not_fit_are_refused(changes: dict[str, object], said: str) -> None:
    with pytest.raises(mavnav.UsageError, match=said) as caught:
        list(mavnav.track(scans_of(**changes), period_s=0.1))
    assert "\n" not in str(caught.value)


def test_other_types_of_ranges_are_converted() -> None:
    def tracked(ranges_m: np.ndarray) -> list[object]:
        return list(mavnav.track(scans_of(ranges_m=ranges_m)))

    ranges_m = SEEN.copy()
    ranges_m[:20] = np.nan
    for no_return in (np.inf, 0.0, -1.0):
        assert tracked(np.where(np.isnan(ranges_m), no_return, ranges_m)) == tracked(ranges_m)
    for dtype in (np.float32, np.int64):
        assert tracked(SEEN.astype(dtype)) == tracked(SEEN.copy())
    assert tracked(np.repeat(SEEN, 2)[::2]) == tracked(SEEN.copy())
    with pytest.raises(TypeError, match="numpy array"):
        mavnav.Scan(0, [2.0] * 181, SPEC)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_run_is_given_where_a_path_can_be(log: Path, run: mavnav.Run, tmp_path: Path) -> None:
    assert mavnav.load_run(run).directory == run.directory
    assert mavnav.diff(run, run)["alignment"] is not None
    continued = mavnav.replay(log, start_s=2, end_s=3, continue_from=run)
    assert continued.metrics["continued"]["joined"]
    later = mavnav.replay(log, start_s=2, end_s=3, directory=tmp_path / "later").directory
    assert len(mavnav.merge([run, later], tmp_path / "merged")["sessions"]) == 2
    assert mavnav.replay(log, end_s=0.5, map=run).metrics["scans"]["total"] > 0


@pytest.mark.slow
def test_one_grid_need_not_be_a_list(tmp_path: Path) -> None:
    log = written(cut(tour("hall"), 6)[0], tmp_path / "drive.mcap")
    single, listed = (
        mavnav.compare(log, grids=grids, methods=methods, workers=1)
        for grids, methods in (("5x5", "robust"), (["5x5"], ["robust"]))
    )
    assert list(single.runs) == list(listed.runs)
    assert "5x5" in {cell["grid"] for cell in single.document["cells"]}


def test_ground_truth_topics_are_named_as_for_replay(tmp_path: Path) -> None:
    mavnav.simulate("corner", settings={"max_steps": 4}, record=tmp_path / "flight.mcap")
    for name in ("/ground_truth", "topic:/ground_truth"):
        opened = mavnav.open_log(tmp_path / "flight.mcap", truth=name)
        assert opened.truth is not None


def test_every_name_is_there_and_described() -> None:
    for name in mavnav.__all__:
        assert getattr(mavnav, name).__doc__
    assert dir(mavnav) == sorted(mavnav.__all__)
    with pytest.raises(AttributeError):
        _ = mavnav.nothing


def test_importing_is_light() -> None:
    code = "import sys, mavnav\nprint(sorted({'numpy', 'numba', 'pydantic', 'mcap', 'typer'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ast.literal_eval(done.stdout) == []
