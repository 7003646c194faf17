"""``mavnav replay --continue``: a log is added to a finished run, which stays as it is, or it is said why not."""

from __future__ import annotations

import json
import shlex
import shutil
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

import mavnav as api
from mavnav.ground_truth.tables import read_tum
from mavnav.units import pluralize
from support.log_files import drive, write_mcap
from support.sessions import CELLAR, WIDE, cut, errors_m, tour, written
from support.synthetic import along, furnished_rooms, record

PARTS = 3
STORED = ("name", "trajectory", "recording", "doubtful")


@pytest.fixture(scope="module")
def parts(tmp_path_factory) -> list[Path]:
    """Write a drive through a room in three logs."""
    folder = tmp_path_factory.mktemp("parts")
    return [written(part, folder / f"part{k}.mcap") for k, part in enumerate(cut(tour("hall"), PARTS))]


@pytest.fixture(scope="module")
def first(parts, tmp_path_factory) -> Path:
    """Return the run of the first part; for reading."""
    run = tmp_path_factory.mktemp("runs") / "first"
    api.replay(parts[0], directory=run)
    return run


def digests(run: Path) -> dict[str, str]:
    return {file.name: sha256(file.read_bytes()).hexdigest() for file in run.iterdir()}


def document(run: Path) -> dict:
    return json.loads((run / "run.json").read_text())


@pytest.mark.slow
def test_three_parts_one_after_another(mavnav, parts, first, tmp_path) -> None:
    """All poses are in the frame of the first part, which is that of the whole drive."""
    before, runs = digests(first), [first, tmp_path / "second", tmp_path / "third"]
    for k in (1, 2):
        code, out, err = mavnav("replay", "--continue", runs[k - 1], parts[k], "-o", runs[k], "-q")
        assert (code, err) == (0, "")
        assert f"{runs[k - 1]}, {pluralize(k, 'session')}" in out
    assert digests(first) == before
    found, hall = document(runs[2]), tour("hall")
    assert [session["name"] for session in found["continued"]["sessions"]] == ["part0", "part1"]
    assert set(digests(runs[2])) == {*found["outputs"], "run.json", "report.html"}
    files = ["session_part0.tum", "session_part1.tum", "trajectory.tum"]
    for file, part in zip(files, cut(hall, PARTS), strict=True):
        assert errors_m(read_tum(runs[2] / file), part, hall.world_T_laser[0]) < 0.05
    code, _, err = mavnav("replay", "--again", runs[1], "-o", tmp_path / "again", "-q")
    assert (code, err) == (
        0,
        f"mavnav: all {len(found['outputs']) - 2} files are the same as {runs[1]}/run.json lists\n",
    )


@pytest.mark.slow
def test_the_printed_command_repeats_a_continued_run(mavnav, parts, tmp_path) -> None:
    """It lists what differs from the run that was continued, even where that is a default."""
    coarse, run, again = (tmp_path / name for name in ("coarse", "run", "again"))
    assert mavnav("replay", parts[0], "-o", coarse, "-q", "--set", "robust.cell_mm=40")[0] == 0
    assert mavnav("replay", "--continue", coarse, parts[1], "-o", run, "-q", "--set", "robust.cell_mm=20")[0] == 0
    words = shlex.split(document(run)["provenance"]["again"])
    assert "--set=robust.cell_mm=20.0" in words
    assert mavnav(*words[1:], "-o", again, "-q")[0] == 0
    assert document(again)["outputs"] == document(run)["outputs"]


@pytest.mark.slow
def test_a_merged_map_is_continued_with_another_sensor(mavnav, parts, first, tmp_path) -> None:
    api.merge([first, parts[1]], tmp_path / "merged")
    track = along([(5.2, 3.0), (5.0, 2.0), (3.2, 0.9)], speed_m_s=0.4, period_s=0.5, turn_rad_s=0.6)
    recording = record(furnished_rooms(), track, WIDE, seed=4)
    log = written(recording, tmp_path / "wide.mcap")
    run = api.replay(log, continue_from=tmp_path / "merged", directory=tmp_path / "run")
    continued = run.metrics["continued"]
    assert (continued["joined"], len(continued["sessions"])) == (True, 2)
    assert errors_m(run.trajectory, recording, tour("hall").world_T_laser[0]) < 0.05


def test_what_does_not_join_is_written_alone(mavnav, parts, first, tmp_path) -> None:
    """It is marked, and cannot be continued in its turn: the sessions before it are not in it."""
    log, run = written(tour("hall", 2, CELLAR), tmp_path / "cellar.mcap"), tmp_path / "run"
    code, _, err = mavnav("replay", "--continue", first, log, "-o", run, "-q")
    assert code == 5
    assert f"error: lost: cellar did not join {first}: " in err
    found = document(run)
    assert (found["continued"]["joined"], found["continued"]["sessions"], found["exit_code"]) == (False, [], 5)
    np.testing.assert_allclose(read_tum(run / "trajectory.tum").xyyaw[0], 0.0, atol=0.05)
    code, _, err = mavnav("replay", "--continue", run, parts[1], "-o", tmp_path / "next", "-q")
    assert (code, err.count("\n")) == (2, 1)
    assert f"did not join the run that it continued; continue {first}" in err
    code, _, err = mavnav("replay", "--continue", first, parts[0], "-o", tmp_path / "same", "-q")
    assert code == 5
    assert "it has the scans of part0" in err


def test_damaged_and_empty_logs(mavnav, parts, first, tmp_path) -> None:
    data = parts[1].read_bytes()
    damaged, empty, blind = (tmp_path / name for name in ("damaged.mcap", "empty.mcap", "blind.mcap"))
    damaged.write_bytes(data[: int(0.7 * len(data))])
    empty.touch()
    write_mcap(blind, drive(0))
    code, _, err = mavnav("replay", "--continue", first, damaged, "-o", tmp_path / "run", "-q")
    assert code == 3
    assert "the input is damaged" in err
    assert document(tmp_path / "run")["continued"]["joined"]
    for log in (empty, blind):
        code, out, err = mavnav("replay", "--continue", first, log, "-o", tmp_path / "none", "-q")
        assert (code, out, err.count("\n")) == (4, "", 1)
        assert not (tmp_path / "none").exists()


def test_a_run_of_another_version(mavnav, parts, first, tmp_path) -> None:
    run = tmp_path / "old"
    shutil.copytree(first, run)
    old = document(run) | {"mavnav_version": "0.1.0"}
    (run / "run.json").write_text(json.dumps(old))
    code, _, err = mavnav("replay", "--continue", run, parts[1], "-o", tmp_path / "run", "-q")
    assert (code, err.count("\n")) == (0, 1)
    assert f"{run} is of mavnav 0.1.0, this is {api.__version__}" in err


def test_what_cannot_be_continued(mavnav, parts, first, tmp_path) -> None:
    """One line, and nothing is written."""

    def changed(name: str, **sections: object) -> Path:
        run = tmp_path / name
        shutil.copytree(first, run)
        (run / "run.json").write_text(json.dumps({k: v for k, v in (document(run) | sections).items() if v}))
        return run

    altered, partly, gone = (changed(name) for name in ("altered", "partly", "gone"))
    with (altered / "trajectory.tum").open("a") as file:
        file.write("# seen\n")
    (partly / "result.mcap").unlink()
    (gone / "run.json").write_text("{")
    about = document(first)
    mission = changed("mission", input=about["input"] | {"format": "scenario"})
    paper = changed("paper", config=about["config"] | {"method": "paper"})
    outside = {"run": "a", "name": "b", "joined": True, "sessions": [dict.fromkeys(STORED, "../a")]}
    for args, words in (
        ([changed("outside", continued=outside)], "is no whole run: run.json lacks what is needed"),
        ([changed("odd", continued={"joined": 1})], "is no whole run: run.json lacks what is needed"),
        ([tmp_path], "holds no run (run.json: No such file or directory)"),
        ([parts[0]], "holds no run"),
        ([gone], "is no whole run: run.json is no JSON, or cut off"),
        ([changed("early", outputs=None)], "is no whole run: run.json lacks what is needed, as of an earlier version"),
        ([mission], "is a mission of mavnav simulate"),
        ([changed("located", localisation={"map": "map.yaml"})], "has the map of another run"),
        ([paper], "is of a method that cannot search whole maps"),
        ([altered], "trajectory.tum has been altered since it was written"),
        ([partly], "it has no result.mcap"),
        ([first, "--map", first], "--continue and --map both give a map"),
        ([first, "--method", "paper"], "method paper cannot search whole maps"),
        ([first, "-o", first, "--force"], "is an input, and would be lost"),
        ([first, "-o", first / "next"], "or inside of it; choose another one with -o"),
    ):
        code, out, err = mavnav("replay", "-o", tmp_path / "run", parts[1], "-q", "--continue", *args)
        assert (code, out, err.count("\n")) == (2, "", 1), args
        assert words in err, args
    assert not (tmp_path / "run").exists()
