"""Odometry that mavnav's own track confirms is evidence of what walls leave open, and shows the floor."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.loading import load_config
from mavnav.logs import open_log
from mavnav.logs.writing.recorder import Recording as Recorded
from mavnav.logs.writing.recorder import record as write
from mavnav.outputs.files.trajectory import write_poses
from mavnav.pipelines.score import ScoreRequest, confirmed_odometry, own_run, score_log
from mavnav.pipelines.trajectory_source import LASER, TrajectorySource
from mavnav.pose import Pose, Trajectory
from mavnav.profiling import silent
from support.field_logs import drive_log, tour, wheels
from support.log_files import TF, Message, write_mcap
from support.synthetic import NOTHING, SHORT, Recording, along, box, past_cupboards, polyline, record

CORRIDOR = np.vstack(
    (
        polyline((0.0, -1.2), (30.0, -1.2), (30.0, 1.2), (0.0, 1.2), closed=True),
        *(box(x_m, side * 1.2, 0.9, 0.24) for x_m, side in ((5.0, -1), (13.0, 1), (22.0, -1))),
    )
)
"""Between its cupboards a laser of 4 m sees two bare walls."""

FLOOR = polyline((4.0, -9.0), (4.0, 9.0))
PATH = along([(4.0, 0.0), (22.0, 0.1)], speed_m_s=0.8)


@pytest.fixture(scope="module", params=["level", "pitched"])
def drive(request: pytest.FixtureRequest) -> Recording:
    return record(CORRIDOR, PATH, SHORT, 0.003, carried=FLOOR if request.param == "pitched" else NOTHING)


def scores(drive: Recording, odometry: Trajectory, folder: Path, **options: str) -> dict[str, dict[str, Any]]:
    """Return run.json of the truth, and of a laser that stands still."""
    write(Recorded(drive.scans, drive.map_T_laser, odometry), folder / "log.mcap")
    still = replace(drive.map_T_laser, xyyaw=np.zeros_like(drive.map_T_laser.xyyaw))
    sources = []
    for name, path in (("truth", drive.map_T_laser), ("still", still)):
        write_poses(path, folder / f"{name}.tum")
        sources.append(TrajectorySource(name, str(folder / f"{name}.tum"), LASER))
    config = load_config(None, [], options)
    request = ScoreRequest(folder / "log.mcap", folder / "scores", config, sources=tuple(sources))
    return {each.name: each.document for each in score_log(request, silent) if each.document}


def test_true_poses_between_bare_walls_are_good(drive: Recording, tmp_path: Path) -> None:
    """They were probably wrong, as the walls leave a direction open, and a pitched laser seemed to be followed."""
    runs = scores(drive, drive.map_T_laser, tmp_path)
    assert runs["truth"]["verdict"]["word"] == "good"
    assert runs["truth"]["tracking"]["odometry"]["used"]
    assert runs["still"]["verdict"]["word"] == "wrong"
    assert "odometry shows another motion" in runs["still"]["verdict"]["reason"]


def test_odometry_that_is_not_asked_for_is_no_evidence(tmp_path: Path) -> None:
    """The scans cannot tell either of them, which makes neither wrong."""
    drive = record(CORRIDOR, PATH, SHORT, 0.003)
    runs = scores(drive, drive.map_T_laser, tmp_path, odom="off")
    assert {run["verdict"]["word"] for run in runs.values()} == {"suspect"}
    assert "the walls leave a direction open" in runs["truth"]["verdict"]["reason"]
    assert "odometry" not in runs["truth"]["tracking"]


def test_the_floor_is_left_out_and_named(tmp_path: Path) -> None:
    """The own track with poses at mid-sweep, in which nothing shows it, stood still."""
    drive = record(CORRIDOR, PATH, SHORT, 0.003, carried=FLOOR)
    truth = scores(drive, drive.map_T_laser, tmp_path)["truth"]
    assert any("moves along with the vehicle, as the floor does" in text for text in truth["warnings"])
    log, own = open_log(tmp_path / "log.mcap"), partial(own_run, config=load_config(None, [], {}), progress=silent)
    _, cut = confirmed_odometry(log, own(log, whole=True))
    at_mid_sweep = own(cut, whole=False)
    assert at_mid_sweep is not None
    assert at_mid_sweep.trajectory.length_m == pytest.approx(drive.map_T_laser.length_m, rel=0.02)


def test_odometry_is_no_evidence_where_the_own_track_leaves_it_out(tmp_path: Path) -> None:
    """Wheels that stand still for 5 s past cupboards made the truth wrong."""
    drive = past_cupboards(bare_m=24.0)
    true, poses = drive.map_T_laser, [Pose()]
    for k in range(1, len(true)):
        poses.append(poses[-1] if 100 <= k < 150 else poses[-1] @ true[k - 1].between(true[k]))
    odometry = Trajectory.of(true.stamps_ns.tolist(), poses)
    truth = scores(drive, odometry, tmp_path)["truth"]
    assert truth["verdict"]["word"] == "good"
    assert truth["tracking"]["odometry"]["used"]


def test_poses_of_the_base_are_read_where_odometry_is_of_another_frame(tmp_path: Path) -> None:
    """The mounting was not known then."""
    path = tour(10.0)
    mounting = {"parent": "base_link", "child": "laser", "x": 0.1, "y": 0.0, "yaw": 0.0}
    messages = [Message("/tf_static", TF, int(path.stamps_ns[0]), mounting), *drive_log(path=path)]
    log = write_mcap(tmp_path / "log.mcap", [*messages, *wheels(path, child="base_footprint")])
    write_poses(path, tmp_path / "base.tum")
    source = TrajectorySource("base", str(tmp_path / "base.tum"), "base_link")
    request = ScoreRequest(log, tmp_path / "scores", load_config(None, [], {}), sources=(source,))
    assert score_log(request, silent)[0].document
