"""The real recordings, and the odd and the damaged ones by the tables of their READMEs."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from mavnav.cli import run
from mavnav.logs import open_log

pytestmark = pytest.mark.real_logs

FOLDER = Path(os.environ.get("MAVNAV_REAL_LOGS") or Path(__file__).parents[3] / "shared" / "logs")

NOT_YET: frozenset[str] = frozenset()
"""Files that do not behave as their README says; strict, so that one that does must leave the list."""

MORE_THAN_ASKED = "damaged/ccny_demo_line_endings_converted.bag"
SOUND = {"variants/B30_no_laserscan.mcap", "damaged/S14_no_messages.mcap"}
"""Logs without scans that are whole."""


class Row(NamedTuple):
    name: str
    scans: set[int]
    codes: set[int]


def table(folder: str) -> list[Row]:
    """Read name, scans and exit codes from a README's table; nothing where the folder is absent."""
    readme = FOLDER / folder / "README.md"
    if not readme.is_file():
        return []
    lines = [line for line in readme.read_text().splitlines() if re.match(r"\| [\w./]+ \|", line)]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [Row(f"{folder}/{r[0]}", numbers(r[2]), numbers(r[3])) for r in rows if r[0] != "file"]


def numbers(text: str) -> set[int]:
    """Read `88 to 100`, `0 or 3`, `100 or 50 (one topic), or 0 and ...`."""
    text = re.sub(r"\(.*?\)", "", text)
    found = [int(n) for n in re.findall(r"\d+", text)]
    return set(range(found[0], found[1] + 1)) if " to " in text and len(found) == 2 else set(found)


ROWS = table("variants") + table("damaged")


def test_tables_are_read(real_logs: Path) -> None:
    assert len(ROWS) >= 40
    assert numbers("88 to 100") == set(range(88, 101))
    assert numbers("0 or 3") == {0, 3}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_files_behave_as_their_readme_says(
    row: Row, real_logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code = run(["info", str(real_logs / row.name), "--json"])
    out, err = capsys.readouterr()
    document = json.loads(out)
    right = (
        code in row.codes
        and document["exit_code"] == code
        and (document["scans"]["usable"] in row.scans or row.name == MORE_THAN_ASKED)
        and bool(document["damage"]) == (code == 3 or (code == 4 and row.name not in SOUND))
        and not list(tmp_path.iterdir())
    )
    assert right != (row.name in NOT_YET), f"exit {code}, {document['scans']}, {document['damage']}"
    if code in (2, 4):
        assert len(err.strip().splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("row", [row for row in ROWS if "/L" in row.name], ids=lambda row: row.name)
def test_lengths_that_lie_cost_neither_time_nor_memory(row: Row, real_logs: Path) -> None:
    command = [sys.executable, "-c", "from mavnav.cli import main; main()", "info", real_logs / row.name, "--json"]
    child = subprocess.run(command, capture_output=True, timeout=60, check=False, preexec_fn=limit)
    assert child.returncode in row.codes


def limit() -> None:
    """Hold the child to 10 s of CPU, and to 1.5 GB of addresses, of which the libraries take 1 GB."""
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (10, 10))
    resource.setrlimit(resource.RLIMIT_AS, (3 << 29, 3 << 29))


def test_line_endings_converted_bag_gives_back_the_scans_bit_for_bit(real_logs: Path) -> None:
    """More than its README asks for: the message of scan 278 is whole, only the chunk's header before it is not."""
    sound = {s.stamp_ns: s.ranges_m.tobytes() for s in open_log(real_logs / "ccny_demo/ccny_demo.bag").scans()}
    damaged = list(open_log(real_logs / "damaged/ccny_demo_line_endings_converted.bag").scans())
    assert len(damaged) >= 359
    assert all(sound[s.stamp_ns] == s.ranges_m.tobytes() for s in damaged)


def test_traversal_is_not_followed_even_if_the_file_exists(real_logs: Path, tmp_path: Path) -> None:
    import shutil

    from mavnav.errors import NoScansError

    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_bytes((real_logs / "damaged/D01_traversal/metadata.yaml").read_bytes())
    shutil.copyfile(real_logs / "damaged/D11_yaml_python_tag/x_0.db3", tmp_path / "secret.db3")
    with pytest.raises(NoScansError, match="leads out of the folder"):
        open_log(folder)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("ccny_demo/ccny_demo.bag", "ccny_demo/ccny_demo.mcap"),
        ("urg_exp1/urg_exp1.mcap", "urg_exp1/urg_exp1.bag"),
        ("urg_exp1/urg_exp1.mcap", "urg_exp1/urg_exp1_ros2"),
    ],
)
def test_forms_of_a_log_are_equal_bit_for_bit(one: str, other: str, real_logs: Path) -> None:
    a, b = open_log(real_logs / one), open_log(real_logs / other)
    assert (a.counts, a.cleaning, a.sensor, a.base_T_laser) == (b.counts, b.cleaning, b.sensor, b.base_T_laser)
    for x, y in zip(a.scans(), b.scans(), strict=True):
        assert (x.stamp_ns, x.spec, x.ranges_m.tobytes()) == (y.stamp_ns, y.spec, y.ranges_m.tobytes())
    if a.odometry and b.odometry:
        np.testing.assert_array_equal(a.odometry.odom_T_laser.xyyaw, b.odometry.odom_T_laser.xyyaw)
        np.testing.assert_array_equal(a.odometry.odom_T_laser.stamps_ns, b.odometry.odom_T_laser.stamps_ns)


@pytest.mark.parametrize(
    ("name", "scans", "beams", "odd"),
    [
        ("ccny_demo/ccny_demo.bag", 360, 681, {"zero": 12699, "below_min": 643}),
        ("urg_exp1/urg_exp1.mcap", 756, 682, {"zero": 270547, "below_min": 14375}),
        ("lego_robot4/lego_robot4.mcap", 278, 660, {"below_min": 41}),
        ("turtlebot4_mac2/turtlebot4_mac2_ros2", 357, 720, {"above_max": 2626, "plus_inf": 58865}),
        ("intel_sparse/intel_sparse.mcap", 910, 180, {"above_max": 4172}),
    ],
)
def test_odd_ranges_of_the_real_logs_are_counted(
    name: str, scans: int, beams: int, odd: dict[str, int], real_logs: Path
) -> None:
    log = open_log(real_logs / name)
    assert (log.counts.total, log.counts.usable, log.sensor.beams, log.damage) == (scans, scans, beams, ())
    assert {k: n for k, n in log.cleaning.items() if n and k != "valid"} == odd
    assert sum(log.cleaning.values()) == scans * beams
    finite = sum(int(np.isfinite(s.ranges_m).sum()) for s in log.scans())
    assert finite == log.cleaning["valid"]


def test_mounting_and_odometry_of_the_real_logs(real_logs: Path) -> None:
    lego = open_log(real_logs / "lego_robot4/lego_robot4.mcap")
    turtle = open_log(real_logs / "turtlebot4_mac2/turtlebot4_mac2_ros2")
    assert lego.base_T_laser is not None
    assert turtle.base_T_laser is not None
    np.testing.assert_allclose(lego.base_T_laser.as_array(), (0.03, 0.0, np.radians(-4.0)), atol=1e-6)
    assert turtle.base_T_laser.yaw_rad == pytest.approx(np.pi / 2, abs=1e-6)
    for log, name in ((lego, "lego_robot4"), (turtle, "turtlebot4_mac2")):
        truth = np.loadtxt(real_logs / name / "odometry.txt")
        assert log.odometry is not None
        at = [log.odometry.odom_T_base.at(round(t * 1e9), 10**9) for t in truth[5:-5, 0]]
        errors = [np.hypot(p.x_m - x, p.y_m - y) for p, (x, y) in zip(at, truth[5:-5, 1:3], strict=True) if p]
        assert len(errors) > 0.9 * len(at)
        assert np.median(errors) < 0.02
