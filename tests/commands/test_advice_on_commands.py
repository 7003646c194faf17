"""Advice is tried: each refusal that names an option or a command is caused, and what it names works."""

from __future__ import annotations

import json
import shutil
from itertools import pairwise
from pathlib import Path
from shlex import split

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.cli import run
from mavnav.errors import ExitCode
from support.advice_trials import SHORT, TRIALS
from support.faults import run_here
from support.field_logs import drive_log
from support.log_files import LASER, ODOM, TF, Message, write_mcap

MISSION = """\
walls:
  - polyline: {closed: true, points_m: [[0, 0], [3, 0], [3, 2], [0, 2]]}
  - box: {center_m: [1.5, 1.7], size_m: [0.4, 0.4]}
start: {x_m: 0.6, y_m: 0.8}
goal_m: [1.2, 0.8]
max_steps: 60
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, repo_root: Path) -> Path:
    """Return a folder with logs, runs, and runs that lack something."""
    folder = tmp_path_factory.mktemp("advice")
    drive = drive_log(6.0, beams=120, odometry=True)
    whole = sorted(drive, key=lambda message: message.time_ns)
    starts = [whole[0].time_ns + k * 10**9 for k in (0, 2, 4, 6)]
    messages, later, last = ([message for message in whole if a <= message.time_ns < b] for a, b in pairwise(starts))
    scans = [message for message in messages if message.type == LASER]
    odometry = [message for message in messages if message.type == ODOM]
    rear, rng = [replace(scan, topic="/rear") for scan in scans], np.random.default_rng(0)
    place = {"parent": "base_link", "child": "laser", "x": 0.1, "y": 0.0, "yaw": 0.0}
    mounted = [Message("/tf_static", TF, messages[0].time_ns, place)]
    (folder / "logs").mkdir()
    for name, content in {
        "log": messages,
        "next": later,
        "last": last,
        "long": drive_log(17.0, beams=60, odometry=True),
        "bare": scans,
        "two": [*messages, *rear],
        "truths": [*messages, *(replace(message, topic=topic) for message in odometry for topic in ("/gt", "/vicon"))],
        "drive_0": scans[:10],
        "drive_1": scans[10:],
        "logs/a": scans,
        "loose": [*scans, *rear],
        "lasers": [*mounted, *messages, *rear],
        "blind": [replace(scan, fields=scan.fields | {"ranges": rng.uniform(0.3, 5.0, 120)}) for scan in scans],
        "logs/b": messages,
    }.items():
        write_mcap(folder / f"{name}.mcap", content)
    for name in ("old.png", "old.mcap", "old.gif"):
        (folder / name).write_bytes(b"kept")
    (folder / "short.yaml").write_text(MISSION)
    shutil.copy(repo_root / "configs/corner.yaml", folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("mavnav.batch.runner.run_jobs", run_here)
        for line in (
            "replay log.mcap -o run -q",
            f"replay log.mcap -o bare --outputs trajectory {SHORT}",
            "simulate short.yaml -o mission -q",
            "merge run next.mcap -o merged -q",
            "edit run --keep-largest -o edited -q",
            f"batch log.mcap --baseline kept.json --update-baseline {SHORT} -o first -j 1",
            "compare run mission -o versions -q",
        ):
            assert run(split(line)) == 0, line
        assert run(split("replay blind.mcap --map run -o nowhere -q")) == ExitCode.TRACKING_LOST
    document = json.loads((folder / "run/run.json").read_text())
    changes = {
        "moved": {"input": document["input"] | {"path": "gone.mcap"}},
        "early": {"provenance": None, "outputs": None},
        "located": {"localisation": {"map": "map.yaml"}},
        "paper": {"config": document["config"] | {"method": "paper"}},
        "broken": {"outputs": {}},
        "spoilt": {},
        "small": {},
    }
    for name, change in changes.items():
        shutil.copytree(folder / "run", folder / name)
        (folder / name / "run.json").write_text(json.dumps(document | change))
    (folder / "broken/hits.npz").write_bytes(b"")
    (folder / "spoilt/result.mcap").write_bytes(b"")
    (folder / "small/hits.npz").unlink()
    (folder / "early.json").write_text(json.dumps(document["config"]))
    return folder


@pytest.fixture(scope="module")
def worked() -> set[str]:
    """Return the lines that were run: several messages advise the same."""
    return set()


@pytest.mark.slow
@pytest.mark.parametrize("trial", TRIALS, ids=lambda trial: trial[1].replace(" ", "_"))
def test_what_a_refusal_advises_works(
    trial: tuple[str, ...],
    folder: Path,
    worked: set[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    message, wrong, *right = trial
    monkeypatch.chdir(folder)
    monkeypatch.setattr("mavnav.batch.runner.run_jobs", run_here)
    for name in ("new", "wrong"):
        shutil.rmtree(name, ignore_errors=True)
    into = (
        ["-o", "wrong"]
        if wrong.startswith(("replay", "merge", "compare", "batch")) and "-o" not in split(wrong)
        else []
    )
    run([*split(wrong), *into])
    assert message in capsys.readouterr().err.replace("\n", " ")
    for line in right:
        assert line in worked or run(split(line)) == 0, capsys.readouterr().err
        worked.add(line)
