"""mavnav replay: what it writes and prints, and one line with a code for everything that goes wrong."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from mavnav.cli import run
from mavnav.errors import ExitCode
from mavnav.units import pluralize
from support.error_lines import expect_error
from support.log_files import laser, write_mcap
from support.marks import slow

FEW = ("--end", 2.0, "--quiet")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, sample: Path) -> Path:
    """Return the directory of a short run."""
    return made(sample, tmp_path_factory.mktemp("runs") / "first")


@pytest.fixture(scope="module")
def another(tmp_path_factory: pytest.TempPathFactory, sample: Path) -> Path:
    """Return the directory of the same short run, made once more."""
    return made(sample, tmp_path_factory.mktemp("runs") / "second")


def made(sample: Path, directory: Path) -> Path:
    assert run(["replay", str(sample), "-o", str(directory), *map(str, FEW)]) == 0
    return directory


def test_a_run_that_is_continued_has_its_frame(mavnav: Callable, sample: Path, finished: Path, tmp_path: Path) -> None:
    given = ("--continue", finished, "--align", "walls", "-o", tmp_path / "r", "-q")
    expect_error(mavnav("replay", sample, *given), ExitCode.USAGE, "--align", "--map or --continue")


def test_the_profile_is_a_line_a_stage(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    stage = re.compile(r"(\w[\w ]+?) +(\d+\.\d{3}) s +(\d+\.\d) %")
    _, out, err = mavnav("replay", sample, "-o", tmp_path / "r", *FEW, "--profile")
    rows = [match.groups() for line in out.splitlines() if (match := stage.fullmatch(line))]
    seconds = [float(spent_s) for _, spent_s, _ in rows]
    assert (seconds, err) == (sorted(seconds, reverse=True), "")
    assert {"reading", "search", "gate", "insert", "measuring"} <= {name for name, _, _ in rows}
    assert re.search(r"^a scan takes [\d.]+ ms, 95 % .* of the 100 ms until the next; \d+ MB", out, re.MULTILINE)
    assert sum(float(share) for _, _, share in rows) == pytest.approx(100.0, abs=0.05 * len(rows))
    _, out, err = mavnav("replay", sample, "-o", tmp_path / "j", *FEW, "--profile", "--json")
    assert json.loads(out)["exit_code"] == 0
    assert {name for line in err.splitlines() for name, _, _ in stage.findall(line)} >= {"reading", "search"}


def digest(directory: Path) -> dict[str, str]:
    outputs: dict[str, str] = json.loads((directory / "run.json").read_text())["outputs"]
    return outputs


def test_writes_what_it_promises(finished: Path) -> None:
    promised = {"trajectory.tum", "trajectory_base.tum", "trajectory.csv", "map.pgm", "map.yaml", "hits.npz"}
    promised |= {"walls.csv", "map.png", "wall_thickness.png", "result.mcap", "foxglove_layout.json", "metrics.json"}
    assert promised == set(digest(finished))
    assert {path.name for path in finished.iterdir()} == promised | {"run.json", "report.html"}


def test_again_gives_the_same_bytes(finished: Path, another: Path) -> None:
    assert digest(another) == digest(finished)


def scans_in(run: Path) -> int:
    """Return how many scans the log of a run has."""
    return json.loads((run / "run.json").read_text())["scans"]["total"]


def differing(one: dict, other: dict) -> set[str]:
    """Return the sections of run.json that differ, text by text."""
    assert list(one) == list(other)
    return {name for name in one if json.dumps(one[name]) != json.dumps(other[name])}


def test_the_gate_that_messages_give_as_an_example_holds(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    code, _, err = mavnav("replay", sample, "-q", "--gate", "thickness")
    assert code == ExitCode.USAGE
    gate = err.strip().rpartition("--gate ")[2].strip("'")
    assert gate.startswith("wall_thickness.p95_mm")
    code, _, err = mavnav("replay", sample, "-o", tmp_path / "run", *FEW, "--outputs", "trajectory", "--gate", gate)
    assert (code, err) == (0, "")


def test_only_timing_and_provenance_differ(sample: Path, finished: Path, another: Path) -> None:
    runs = []
    for directory in (finished, another):
        runs.append(json.loads((directory / "run.json").read_text()))
        assert "provenance" not in json.loads((directory / "metrics.json").read_text())
    assert differing(*runs) <= {"timing", "provenance"}
    told = runs[0]["provenance"]
    assert datetime.fromisoformat(told["started"]).tzinfo == UTC
    words = ["mavnav", "replay", str(sample), "-o", str(finished), *map(str, FEW)]
    assert shlex.split(told["command"]) == words
    assert told["options"]["end_s"] == 2.0
    assert told["folder"] == str(Path.cwd())
    assert told["host"].keys() == {"processor", "cores", "system"}


OPTIONS = (
    *("--odom", "/odom", "--start", "0.5", "--extrinsic=-0.01,0,0.1", "--truth", "auto", "--grid", "6x6"),
    *("--set", "robust.cell_mm=25", "--azimuth", "8", "--end", "2"),
)


@pytest.fixture(scope="module")
def with_options(sample: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the read-only copy of a run with many options, and a configuration file that is gone."""
    folder = tmp_path_factory.mktemp("options")
    config = folder / "my.yaml"
    config.write_text("robust: {deskew: off}\n")
    assert run(["replay", str(sample), "-o", str(folder / "run"), "--config", str(config), *OPTIONS, "-q"]) == 0
    config.unlink()
    copy = shutil.copytree(folder / "run", folder / "copy of it")
    shutil.rmtree(folder / "run")
    for path in (*copy.iterdir(), copy):
        path.chmod(path.stat().st_mode & ~0o222)
    return copy


def test_again_repeats_a_run_from_a_read_only_copy(mavnav: Callable, with_options: Path, tmp_path: Path) -> None:
    code, _, err = mavnav("replay", "--again", with_options, "-o", tmp_path / "again", "-q")
    assert code == 0
    assert re.fullmatch(rf"mavnav: all \d+ files are the same as {re.escape(str(with_options))}/run.json lists\n", err)
    first, second = (json.loads((path / "run.json").read_text()) for path in (with_options, tmp_path / "again"))
    assert differing(first, second) <= {"timing", "provenance"}
    assert second["provenance"]["options"] == first["provenance"]["options"]
    for path in with_options.iterdir():
        if path.name not in {"run.json", "report.html"}:  # which say when it was made
            assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes(), path.name


def test_the_printed_command_repeats_a_run(mavnav: Callable, with_options: Path, tmp_path: Path) -> None:
    first = json.loads((with_options / "run.json").read_text())
    words = shlex.split(first["provenance"]["again"])
    assert words[0] == "mavnav"
    code, _, _ = mavnav(*words[1:], "-o", tmp_path / "again", "-q")
    second = json.loads((tmp_path / "again" / "run.json").read_text())
    assert code == 0
    assert differing(first, second) <= {"timing", "provenance"}


def test_again_says_what_cannot_be_repeated(mavnav: Callable, with_options: Path, tmp_path: Path, sample: Path) -> None:
    changed = tmp_path / "corridor.mcap"
    changed.write_bytes(sample.read_bytes() + b"x")
    for words, said in (
        ((changed, "--again", with_options), "is not the log of"),
        ((changed, "--again", with_options), "SHA-256 was"),
        ((tmp_path / "gone.mcap", "--again", with_options), "the log of the run is not there"),
        (("--again", with_options, "--grid", "5x5"), "--again takes --grid from the run"),
        (("--again", with_options, "-o", with_options), "is the run to repeat; choose another directory"),
        (("--again", with_options, "-o", with_options.parent, "--force"), "contains the run to repeat; choose another"),
        (("--again", tmp_path), "holds no run"),
        ((), "no log; name one"),
    ):
        code, _, err = mavnav("replay", *words, "-q")
        assert code == ExitCode.USAGE
        assert said in err
    assert (with_options / "run.json").is_file()
    assert "write mavnav replay --again" in mavnav("simulate", "--again", with_options)[2]


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("provenance", "options", ["topic"]), ("provenance", "options", {}), ("provenance", "folder", 5),
        ("input", "path", ["a"]), ("input", "sha256", None), (None, "outputs", []), (None, "partial", "perhaps"),
    ],
)  # fmt: skip
def test_again_refuses_a_record_that_was_altered(
    section: str | None, key: str, value: object, mavnav: Callable, with_options: Path, tmp_path: Path
) -> None:
    document = json.loads((with_options / "run.json").read_text())
    (document[section] if section else document)[key] = value
    (tmp_path / "run.json").write_text(json.dumps(document))
    code, _, err = mavnav("replay", "--again", tmp_path)
    assert code == 2
    assert "run.json does not record how the run was made" in err


def test_again_warns_of_another_version(mavnav: Callable, with_options: Path, tmp_path: Path, sample: Path) -> None:
    old = tmp_path / "old"
    old.mkdir()
    document = json.loads((with_options / "run.json").read_text())
    document["libraries"]["numpy"] = "1.0"
    (old / "run.json").write_text(json.dumps(document | {"mavnav_version": "0.0.1", "partial": True}))
    moved = shutil.copy(sample, tmp_path / "moved.mcap")
    code, _, err = mavnav("replay", moved, "--again", old, "-o", tmp_path / "again", "-q")
    assert code == 0
    assert f"other versions than in {old}, results may differ: mavnav 0.0.1 then" in err
    assert "numpy 1.0 then" in err
    assert "was stopped before the log ended" in err
    second = json.loads((tmp_path / "again" / "run.json").read_text())
    assert differing(document, second) == {"input", "timing", "provenance", "libraries", "outputs"}  # the log's name
    assert second["input"] == document["input"] | {"path": str(moved)}


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are UTF-8 there")
@pytest.mark.parametrize(
    ("command", "options"),
    [("replay", ("--report",)), ("compare", ("--grid", "5x5", "-j", 1)), ("batch", ("--grid", "5x5", "-j", 1))],
)
def test_the_name_of_a_log_need_not_be_utf_8(
    mavnav: Callable, sample: Path, tmp_path: Path, command: str, options: tuple[object, ...]
) -> None:
    log = tmp_path / os.fsdecode(b"b\xffd.mcap")
    shutil.copy(sample, log)
    code, _, err = mavnav(command, log, "-o", tmp_path / "r", "--end", 0.5, "-q", *options)
    assert (code, err) == (0, "")


def test_summary_on_stdout(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    code, out, err = mavnav("replay", sample, "-o", tmp_path / "r", *FEW, "--report")
    assert code == 0
    assert err == ""
    assert "report.html" in out
    assert "21 of 21 scans" in (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    lines = out.splitlines()
    names = ["✓ good", "log", "used", "map", "walls", "path", "open", "next"]
    assert [re.split("  +", line.strip())[0] for line in lines] == names
    rows = dict(zip(names, lines, strict=True))
    assert f"{scans_in(tmp_path / 'r')} scans, 21 of them used" in rows["log"]
    assert "100.0 % of the scans have a pose; " in rows["used"]
    assert "no loop closed" in rows["used"]
    assert "map.png" in rows["open"]


def test_the_paper_s_method_says_why_it_refused_scans(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    made, strict = tmp_path / "r", ("--method", "paper", "--set", "paper.gate_mm2=1", "--outputs", "trajectory")
    _, stdout, _ = mavnav("replay", sample, "-o", made, *FEW, *strict)
    scans = json.loads((made / "run.json").read_text())["scans"]
    with (made / "trajectory.csv").open(encoding="ascii", newline="") as file:
        refused = [row for row in csv.DictReader(file) if row["refused_by"]]
    by_rule = Counter(row["refused_by"] for row in refused)
    assert len(refused) == scans["rejected"] > 0
    assert by_rule == {each["rule"]: each["scans"] for each in scans["refused"]}
    assert by_rule["cost"] > 0
    assert all(float(row["cost_m2"]) > float(row["threshold_m2"]) for row in refused if row["refused_by"] == "cost")
    assert all(row["tracked"] == "0" for row in refused)
    assert f"{pluralize(by_rule['cost'], 'scan')} by cost" in stdout


def test_only_the_named_groups_of_files_are_written(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    made = tmp_path / "r"
    code, stdout, _ = mavnav("replay", sample, "-o", made, *FEW, "--outputs", "trajectory,map")
    assert (code, "pictures" in stdout) == (0, False)
    names = {path.name for path in made.iterdir()}
    assert names == json.loads((made / "run.json").read_text())["outputs"].keys() | {"run.json"}
    written = {"trajectory.tum", "trajectory.csv", "map.pgm", "map.yaml", "hits.npz", "run.json"}
    assert names - {"trajectory_base.tum"} == written
    assert mavnav("check", made, "--gate", "scans.processed>=1")[0] == 0
    code, _, stderr = mavnav("metrics", made)
    assert (code, stderr.count("\n"), "result.mcap" in stderr) == (2, 1, True)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--outputs", "map,maps"], "known are trajectory, map, metrics, pictures, mcap, report"),
        (["--outputs", "map", "--report"], "report is drawn from trajectory and map"),
        (["--outputs", "trajectory", "--preview"], "--preview is drawn from map"),
    ],
)
def test_groups_of_files_that_cannot_be_are_refused_before_the_work(
    mavnav: Callable, sample: Path, tmp_path: Path, options: list[str], reason: str
) -> None:
    code, _, stderr = mavnav("replay", sample, "-o", tmp_path / "r", *options)
    assert (code, reason in stderr, (tmp_path / "r").exists()) == (2, True, False)


def test_json_is_run_json_and_nothing_else(spawn: Callable, sample: Path, tmp_path: Path) -> None:
    process = spawn("replay", sample, "-o", tmp_path / "r", "--end", 2.0, "--json")
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    document = json.loads(out)
    assert document == json.loads((tmp_path / "r" / "run.json").read_text())
    assert document["schema_version"] == 1
    assert document["exit_code"] == 0
    assert document["scans"]["processed"] == 21


def test_options_reach_the_run(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    options = ["--grid", "6x7", "--azimuth", "15", "--online", "--odom", "off", "--set", "robust.cell_mm=25"]
    code, out, _ = mavnav("replay", sample, "-o", tmp_path / "r", *FEW, "--json", *options, "--extrinsic", "0.1,0,0.5")
    document = json.loads(out)
    assert code == 0
    assert (document["grid"], document["azimuth"], document["method"]) == ("6x7", 15, "robust")
    assert document["config"]["final_pass"] is False
    assert document["config"]["robust"]["cell_mm"] == 25
    assert document["input"]["base_T_laser"] == {"x_m": 0.1, "y_m": 0.0, "yaw_rad": 0.5}
    assert document["input"]["odometry"] is None


def test_the_window_counts_from_the_first_scan(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    _, out, _ = mavnav("replay", sample, "-o", tmp_path / "r", "-q", "--json", "--start", 1, "--end", 2)
    document = json.loads(out)
    assert document["scans"]["processed"] == 11
    rows = (tmp_path / "r" / "trajectory.tum").read_text().splitlines()
    assert rows[0].split()[0].startswith("1700000001.0")


def test_paper_ignores_odometry(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    _, out, _ = mavnav("replay", sample, "-o", tmp_path / "r", *FEW, "--method", "paper", "--json")
    document = json.loads(out)
    assert document["method"] == "paper"
    assert document["input"]["odometry"] is None


def test_the_default_directory_names_log_method_and_grid(
    mavnav: Callable, sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert mavnav("replay", sample, *FEW, "--grid", "5x6")[0] == 0
    assert (tmp_path / "runs" / "corridor-robust-12-5x6" / "run.json").is_file()


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("a.mcap", "a"),
        ("a.b.bag", "a.b"),
        ("a.bag.active", "a"),
        ("a.mcap.zst", "a"),
        ("a_0.db3.zstd", "a_0"),
        ("noend", "noend"),
        (".mcap", ".mcap"),
    ],
)
def test_log_names(tmp_path: Path, name: str, stem: str) -> None:
    from mavnav.config.models import Config
    from mavnav.pipelines.replay import replay_directory

    assert replay_directory(tmp_path / name, Config()) == Path("runs") / f"{stem}-robust-20-10x10"


def test_a_folder_is_named_as_it_is(tmp_path: Path) -> None:
    from mavnav.config.models import Config
    from mavnav.pipelines.replay import replay_directory

    (tmp_path / "drive.mcap").mkdir()
    assert replay_directory(tmp_path / "drive.mcap", Config()).name == "drive.mcap-robust-20-10x10"


def test_a_link_is_named_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mavnav.logs.formats.detect import log_name

    (tmp_path / "sha256-77").touch()
    (tmp_path / "drive.mcap").symlink_to("sha256-77")
    assert log_name(tmp_path / "drive.mcap") == "drive"
    monkeypatch.chdir(tmp_path)
    assert log_name(Path()) == tmp_path.name


# --- errors: one line, one code -----------------------------------------------------------------------------------


def test_no_such_file(mavnav: Callable, tmp_path: Path) -> None:
    expect_error(mavnav("replay", tmp_path / "none.mcap", "-q"), ExitCode.USAGE, "none.mcap", "no such file")


def test_not_a_log(mavnav: Callable, tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no log at all, just words\n" * 20)
    expect_error(mavnav("replay", text, "-o", tmp_path / "r", "-q"), ExitCode.NO_SCANS, "notes.txt")
    assert not (tmp_path / "r").exists()


def test_no_scan_topic(mavnav: Callable, make_log: Callable, tmp_path: Path) -> None:
    log = make_log("odometry.mcap", scan=[])
    expect_error(mavnav("replay", log, "-o", tmp_path / "r", "-q"), ExitCode.NO_SCANS, "no LaserScan", "/odom")


def test_two_scan_topics(mavnav: Callable, make_log: Callable, finished: Path, tmp_path: Path) -> None:
    log = make_log("two.mcap", scan=["/front", "/rear"])
    front = f"/front ({scans_in(finished)} scans)"
    expect_error(mavnav("replay", log, "-o", tmp_path / "r", "-q"), ExitCode.USAGE, front, "/rear", "--topic")
    assert mavnav("replay", log, "-o", tmp_path / "r", *FEW, "--topic", "/rear")[0] == 0


def test_no_such_topic(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    expect_error(
        mavnav("replay", sample, "-o", tmp_path, "-q", "--force", "--topic", "/no"), ExitCode.USAGE, "/no", "/scan"
    )
    expect_error(
        mavnav("replay", sample, "-o", tmp_path, "-q", "--force", "--odom", "/no"), ExitCode.USAGE, "/no", "/odom"
    )


def test_an_existing_output_stays_without_force(mavnav: Callable, sample: Path, finished: Path) -> None:
    before = (finished / "run.json").read_bytes()
    expect_error(mavnav("replay", sample, "-o", finished, *FEW), ExitCode.OUTPUT, "exists", "--force")
    assert (finished / "run.json").read_bytes() == before


def test_an_unwritable_output_is_told_before_the_work(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    expect_error(mavnav("replay", sample, "-o", file / "run", "-q"), ExitCode.OUTPUT, str(file), "choose another place")
    expect_error(mavnav("replay", sample, "-o", "/proc/run", "-q", "--end", 0.1), ExitCode.OUTPUT, "/proc/run")


def test_unknown_configuration_key(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    config = tmp_path / "my.yaml"
    config.write_text("azimuth: 20\nrobust:\n  cel_mm: 25\n")
    result = mavnav("replay", sample, "-o", tmp_path / "r", "-q", "--config", config)
    expect_error(result, ExitCode.USAGE, f"{config}:3", "robust.cel_mm", "did you mean robust.cell_mm?")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--grid", "0x5"], ["--grid", "'0x5'", "10x10"]),
        (["--azimuth", "1"], ["--azimuth", "greater than or equal to 2"]),
        (["--azimuth", "many"], ["--azimuth", "see 'mavnav replay --help'"]),
        (["--method", "magic"], ["--method", "'robust' or 'paper'"]),
        (["--set", "robust.cel_mm=3"], ["robust.cell_mm"]),
        (["--extrinsic", "1,2"], ["--extrinsic", "X,Y,YAW"]),
        (["--extrinsic", "1,2,nan"], ["--extrinsic", "not finite"]),
        (["--extrinsic", "1,2,-90"], ["--extrinsic", "more than a turn", "in rad"]),
        (["--start-pose", "1,2,0"], ["--start-pose", "--map"]),
        (["--map", ".", "--start-pose", "1,2"], ["--start-pose", "X,Y,YAW"]),
        (["--map", "none.yaml"], ["none.yaml", "run directory"]),
        (["--map", ".", "--method", "paper"], ["--map", "--method robust"]),
        (["--align", "wall"], ["--align", "neither walls, none nor X,Y,YAW"]),
        (["--align", "walls", "--map", "."], ["--align", "--map or --continue"]),
        (["--align", "walls", "--online"], ["--align", "leave out --online"]),
        (["--align", "1,2,3", "--method", "paper"], ["--align", "--method robust"]),
        (["--no-such-option"], ["--no-such-option", "see 'mavnav replay --help'"]),
        (["--start", "100"], ["--start"]),
        (["--config", "none.yaml"], ["none.yaml", "paper, paper-literal, robust"]),
    ],
    ids=" ".join,
)
def test_options_that_cannot_be(
    mavnav: Callable, sample: Path, tmp_path: Path, options: list[str], words: list[str]
) -> None:
    code = ExitCode.NO_SCANS if "--start" in options else ExitCode.USAGE
    expect_error(mavnav("replay", sample, "-o", tmp_path / "r", "-q", *options), code, *words)
    assert list(tmp_path.iterdir()) == []


def test_a_file_name_cannot_steer_the_terminal(mavnav: Callable, tmp_path: Path) -> None:
    _, _, err = mavnav("replay", tmp_path / "a\x1b[2J\nb\u202e.mcap")
    assert "\x1b" not in err
    assert "\u202e" not in err
    assert "\\x1b[2J\\nb\\u202e" in err


def test_a_damaged_log_is_used_and_told(mavnav: Callable, make_log: Callable, tmp_path: Path) -> None:
    whole, cut = make_log("whole.mcap"), tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 6 // 10])
    code, out, err = mavnav("replay", cut, "-o", tmp_path / "r", "-q", "--json", "--end", 2.0)
    document = json.loads(out)
    assert code == document["exit_code"] == ExitCode.DAMAGED_INPUT
    assert document["damage"]
    assert "the input is damaged" in err


def test_a_track_lost_for_good_is_told(mavnav: Callable, make_log: Callable, tmp_path: Path) -> None:
    log = make_log("lost.mcap", blind_after=4)
    code, out, err = mavnav("replay", log, "-o", tmp_path / "r", "-q", "--json", "--end", 1.0)
    document = json.loads(out)
    assert code == document["exit_code"] == ExitCode.TRACKING_LOST
    assert document["tracking"]["lost"] is True
    assert document["tracking"]["intervals"][-1] == {"start_s": 0.4, "end_s": 1.0, "scans": 7, "recovered": False}
    assert document["verdict"]["word"] == "lost"
    assert err.startswith("mavnav: error: lost: tracking was lost 0.4 s after the first scan, 36 % of the scans have")
    assert err.count("\n") == 1
    assert len((tmp_path / "r" / "trajectory.tum").read_text().splitlines()) == 4


def test_a_log_of_which_the_end_is_lost_is_suspect(mavnav: Callable, make_log: Callable, tmp_path: Path) -> None:
    """A robot that was lifted at the end; before, it was called lost, with exit code 5."""
    log = make_log("lifted.mcap", blind_after=60, last=66)
    code, out, err = mavnav("replay", log, "-o", tmp_path / "r", "-q", "--end", 6.5)
    document = json.loads((tmp_path / "r" / "run.json").read_text())
    assert (code, document["exit_code"], document["tracking"]["lost"]) == (0, 0, False)
    assert document["tracking"]["intervals"][-1]["recovered"] is False
    assert out.splitlines()[0].startswith(
        "? suspect  no scan matches any more from 6.0 s after the first scan; 91 % of "
    )
    assert re.search(
        "^  try +if the laser was carried or covered there, leave the rest out with --end 6.0$", out, re.MULTILINE
    )
    assert "lost" not in err
    assert mavnav("replay", log, "-o", tmp_path / "s", "-q", "--end", 6.0, "--gate", "verdict==good")[0] == 0


def test_a_picture_that_is_not_written_is_not_named(mavnav: Callable, make_log: Callable, tmp_path: Path) -> None:
    log, line = make_log("dark.mcap", blind_after=4), ("-q", "--end", 1.0, "--odom", "off")
    for name, outputs, words in (
        ("all", (), "; look at map.png\n"),
        ("few", ("--outputs", "trajectory"), "; look at map.png of a run with --outputs pictures\n"),
    ):
        assert mavnav("replay", log, "-o", tmp_path / name, *line, *outputs)[2].endswith(words)


# --- in a known map -----------------------------------------------------------------------------------------------


def test_the_laser_is_found_in_the_map_of_another_run(
    mavnav: Callable, sample: Path, finished: Path, tmp_path: Path
) -> None:
    part = ("--start", 1.0, "--end", 1.8, "-q", "--odom", "off")
    code, out, _ = mavnav("replay", sample, "-o", tmp_path / "r", *part, "--map", finished, "--start-pose", "0.3,0,0")
    assert code == 0
    assert "found in the map" in out
    told = json.loads((tmp_path / "r" / "run.json").read_text())["localisation"]
    assert told["map"] == str(finished)
    assert told["start_pose"] == {"x_m": 0.3, "y_m": 0.0, "yaw_deg": 0.0}
    first = [float(word) for word in (finished / "trajectory.tum").read_text().splitlines()[10].split()]
    assert told["found"]["scan"] == 0
    assert told["found"]["x_m"] == pytest.approx(first[1], abs=0.05)
    assert told["found"]["y_m"] == pytest.approx(first[2], abs=0.05)


@pytest.mark.parametrize(("start", "far"), [("0.3,0,0", ""), ("2.5,0,0", ""), ("1e8,0,0", "100000000.0 m")])
def test_a_start_pose_far_from_the_pose_found_is_told(
    mavnav: Callable, sample: Path, finished: Path, tmp_path: Path, start: str, far: str
) -> None:
    known = ("--map", finished, "--start-pose", start, "--outputs", "trajectory")
    code, out, err = mavnav("replay", sample, "-o", tmp_path / "r", "--end", 1.0, "-q", "--odom", "off", *known)
    assert code == 0
    assert "found in the map" in out
    warnings = [line for line in err.splitlines() if "--start-pose" in line]
    assert len(warnings) == bool(far)
    if far:
        assert warnings[0].startswith(f"mavnav: warning: the laser was found {far} from --start-pose, at x ")
        assert "; check the pose found; if it is wrong, correct --start-pose" in warnings[0]


def test_a_run_in_a_given_map_is_compared_with_it_by_diff(
    mavnav: Callable, sample: Path, finished: Path, tmp_path: Path
) -> None:
    code, _, _ = mavnav("replay", sample, "-o", tmp_path / "r", "--end", 1.0, "-q", "--odom", "off", "--map", finished)
    assert code == 0
    code, out, _ = mavnav("diff", finished, tmp_path / "r", "-q", "--json")
    document = json.loads(out)
    assert (code, document["changed_m2"]) == (0, 0.0)
    assert document["alignment"]["agreeing"] > 0


def test_a_laser_that_is_nowhere_in_the_map_is_told(
    mavnav: Callable, make_log: Callable, finished: Path, tmp_path: Path
) -> None:
    log = make_log("nowhere.mcap", blind_after=0)
    code, out, err = mavnav("replay", log, "-o", tmp_path / "r", "--end", 0.6, "-q", "--odom", "off", "--map", finished)
    assert code == ExitCode.TRACKING_LOST
    assert "nowhere" in out
    assert out.split()[-3:] == ["mavnav", "info", str(log)]
    assert "--start-pose" in err
    assert json.loads((tmp_path / "r" / "run.json").read_text())["localisation"]["found"] is None
    assert (tmp_path / "r" / "trajectory.tum").read_text() == ""


def test_a_map_without_walls_is_refused(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    (tmp_path / "empty.pgm").write_bytes(b"P5 2 2 255\n" + bytes([254] * 4))
    (tmp_path / "empty.yaml").write_text("image: empty.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    result = mavnav("replay", sample, "-o", tmp_path / "r", "-q", "--map", tmp_path / "empty.yaml")
    expect_error(result, ExitCode.USAGE, "no occupied cell")


# --- signals ------------------------------------------------------------------------------------------------------


@pytest.fixture
def tracking(sample: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a run whose grids make the tracking long, and wait until it has begun."""
    talkative = "from mavnav.commands import progress; progress.LINE_PERIOD_S = 0.05"
    options = ["-o", str(tmp_path / "out" / "run"), "--grid", "100x100", "--azimuth", "1000"]
    code = f"{talkative}; from mavnav.cli import main; main()"
    command = [sys.executable, "-c", code, "replay", str(sample), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("mavnav: track"):
                break
        yield process
        process.kill()


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [
        (signal.SIGINT, ExitCode.INTERRUPTED, "interrupted"),
        (signal.SIGTERM, ExitCode.TERMINATED, "terminated"),
        slow(signal.SIGHUP, ExitCode.TERMINATED, "terminated"),
    ],
)
def test_the_first_signal_keeps_what_is_done_and_marks_it(
    tracking: subprocess.Popen[str], tmp_path: Path, number: int, code: int, word: str
) -> None:
    directory = tmp_path / "out" / "run"
    tracking.send_signal(number)
    _, err = tracking.communicate(timeout=100)
    assert tracking.returncode == code
    assert f"mavnav: {word}: writing the results so far" in err
    document = json.loads((directory / "run.json").read_text())
    assert (document["partial"], document["exit_code"]) == (True, code)
    assert 0 < document["scans"]["processed"] < document["scans"]["usable"]
    assert set(document["outputs"]) | {"run.json", "report.html"} == {path.name for path in directory.iterdir()}
    assert [path.name for path in directory.parent.iterdir()] == ["run"]


def test_a_second_signal_gives_up_and_leaves_nothing_half_written(
    tracking: subprocess.Popen[str], tmp_path: Path
) -> None:
    assert tracking.stderr is not None
    tracking.send_signal(signal.SIGINT)
    while "writing the results so far" not in tracking.stderr.readline():
        pass
    tracking.send_signal(signal.SIGINT)
    out, err = tracking.communicate(timeout=100)
    assert tracking.returncode == ExitCode.INTERRUPTED
    assert out == ""
    assert err.splitlines()[-1] == "mavnav: interrupted"
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


WHILE_WRITING = """
import os, signal, sys, time
from mavnav.outputs.writers import WRITERS
from mavnav.cli import main
write = WRITERS["map.pgm"]

def befallen(run, path):
    for number in sys.argv.pop().split(","):
        os.kill(os.getpid(), int(number))
    write(run, path)

WRITERS["map.pgm"] = befallen
main(sys.argv[1:-1])
"""


def befallen(sample: Path, directory: Path, *numbers: int) -> subprocess.CompletedProcess[str]:
    """Replay a second of a log, and get signals while the run is written."""
    line = ["replay", str(sample), "-o", str(directory), "-q", "--end", "1", "--force", ",".join(map(str, numbers))]
    command = [sys.executable, "-c", WHILE_WRITING, *line]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)


def test_a_signal_after_the_last_scan_comes_too_late_to_make_the_run_partial(sample: Path, tmp_path: Path) -> None:
    done = befallen(sample, tmp_path / "run", signal.SIGTERM)
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    assert (done.returncode, document["exit_code"], document["partial"]) == (ExitCode.DONE, ExitCode.DONE, False)
    assert done.stderr.splitlines()[-1] == "mavnav: the signal came after the work was done: the result is complete"


WHILE_SMOOTHING = """
import os, signal, sys
from mavnav.cli import main
from mavnav.slam.refinement import refine
smooth = refine.smooth_positions

def befallen(steps, period_s):
    os.kill(os.getpid(), signal.SIGINT)
    smooth(steps, period_s)

refine.smooth_positions = befallen
main(sys.argv[1:])
"""


def test_a_signal_in_a_pass_over_the_whole_log_says_so(sample: Path, tmp_path: Path) -> None:
    line = ["replay", str(sample), "-o", str(tmp_path / "run"), "-q", "--end", "1"]
    command = [sys.executable, "-c", WHILE_SMOOTHING, *line]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    assert (done.returncode, document["partial"]) == (ExitCode.INTERRUPTED, True)
    assert document["scans"]["processed"] == document["scans"]["usable"]
    assert "mavnav: stopped in the passes over the whole log; the run is partial" in done.stderr


@pytest.mark.parametrize("numbers", [(signal.SIGKILL,), (signal.SIGTERM, signal.SIGTERM)])
def test_a_run_that_dies_while_it_is_written_leaves_the_old_one(
    numbers: tuple[int, ...], sample: Path, tmp_path: Path
) -> None:
    directory = tmp_path / "run"
    directory.mkdir()
    (directory / "run.json").write_text("old")
    done = befallen(sample, directory, *numbers)
    assert done.returncode == (-signal.SIGKILL if signal.SIGKILL in numbers else ExitCode.TERMINATED)
    assert {path.name: path.read_text() for path in directory.iterdir()} == {"run.json": "old"}
    assert all(path.name.startswith(".run.") for path in tmp_path.iterdir() if path != directory)


@pytest.mark.usefixtures("finished")
def test_a_warm_run_loads_no_library_that_it_does_not_need(sample, tmp_path) -> None:
    code = "import sys\nfrom mavnav.cli import run\nassert run(sys.argv[1:]) == 0\nprint(*sys.modules, file=sys.stderr)"
    command = [sys.executable, "-c", code, "replay", sample, "--end", "0.5", "-q", "-o", tmp_path / "run"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    heavy = {"scipy.linalg", "scipy.ndimage", "scipy.spatial", "rosbags"}
    heavy |= {"numba", "pydantic", "yaml", "sqlite3"}
    heavy |= {f"mavnav.kernels.{name}" for name in ("beams", "polar_search.cost", "polar_search.search", "raycast")}
    assert not heavy & set(done.stderr.split())


@pytest.mark.parametrize(
    ("options", "key"),
    [
        (("--set", "paper.cell_mm=25"), "paper.cell_mm"),
        (("--method", "paper", "--deskew", "on"), "robust.deskew"),
        (("--method", "paper", "--odom", "auto"), "odom"),
    ],
)
def test_settings_without_effect_are_named(mavnav, sample, tmp_path, options, key) -> None:
    few = ("--end", 0.5, "-q", "--outputs", "trajectory")
    _, _, err = mavnav("replay", sample, "-o", tmp_path / "run", *few, *options)
    assert f"mavnav: warning: {key} has no effect with method" in err


def test_settings_that_fit_the_method_are_not_warned_about(mavnav, sample, tmp_path) -> None:
    few = ("--end", 0.5, "-q", "--outputs", "trajectory")
    code, _, err = mavnav("replay", sample, "-o", tmp_path / "run", *few, "--method", "paper", "--odom", "off")
    assert code == 0
    assert "no effect" not in err


def test_again_names_the_files_that_differ(mavnav: Callable, with_options: Path, tmp_path: Path) -> None:
    made = shutil.copytree(with_options, tmp_path / "made")
    document = json.loads((made / "run.json").read_text())
    document["outputs"]["map.pgm"] = "0" * 64
    (made / "run.json").write_text(json.dumps(document))
    code, _, err = mavnav("replay", "--again", made, "-o", tmp_path / "again", "-q")
    assert code == 0
    assert f"1 of {len(document['outputs'])} files differ from those that {made}/run.json lists: map.pgm" in err


def test_again_of_the_last_run_is_compared_with_that_run(
    mavnav: Callable, with_options: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The link to the last run leads to the repetition by then."""
    monkeypatch.chdir(tmp_path)
    made = Path(shutil.copytree(with_options, "runs/made"))
    made.chmod(0o755)
    (made / "run.json").chmod(0o644)
    document = json.loads((made / "run.json").read_text())
    (made / "run.json").write_text(json.dumps(document | {"outputs": document["outputs"] | {"map.pgm": "0" * 64}}))
    Path("runs/latest").symlink_to("made")
    code, _, err = mavnav("replay", "--again", "runs/latest", "-q")
    assert (code, Path("runs/latest").resolve().name) == (0, "made-again")
    assert f"1 of {len(document['outputs'])} files differ from those that runs/made/run.json lists: map.pgm" in err


def test_a_map_that_is_too_large_is_refused_before_it_takes_memory(
    mavnav: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    far_m = np.full(360, 199.0) + np.arange(360) % 7 * 0.1
    fields = {"angle_min": -3.14, "angle_increment": 0.01745, "range_max": 250.0, "ranges": far_m}
    log = write_mcap(tmp_path / "far.mcap", [laser(k, **fields) for k in range(12)])
    sets = ("--set", "robust.cell_mm=5", "--set", "robust.far_mm=250000")
    code, _, err = mavnav("replay", log, "-o", tmp_path / "r", "-q", *sets)
    assert code == 2
    assert "the map would be 399 m x 399 m in cells of 5 mm" in err
