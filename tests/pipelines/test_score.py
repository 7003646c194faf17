"""Poses of other programs are judged by the scans: the truth is best, every error shows, and no pose is moved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavnav.config.loading import load_config
from mavnav.config.models import Config
from mavnav.errors import UsageError
from mavnav.logs import Log, open_log
from mavnav.metrics.wall_spread import wall_report
from mavnav.outputs.documents.sections import PoseJump
from mavnav.outputs.files.document import track_verdict
from mavnav.pipelines.maps import measured_map
from mavnav.pipelines.score import ScoreRequest, difference_section, own_run, score_log
from mavnav.pipelines.trajectory_source import TrajectorySource, read_source
from mavnav.pose import Pose, Trajectory
from mavnav.profiling import silent
from mavnav.slam import given_poses
from mavnav.slam.doubt import judge
from mavnav.slam.findings import SECOND_LOST
from mavnav.slam.given_poses import draw_at_poses
from mavnav.slam.result import SlamResult
from mavnav.slam.track import Track
from support.field_logs import START_S, drive_log
from support.log_files import write_mcap
from support.synthetic import along

CORNERS = [(1.0, 0.8), (4.9, 0.8), (4.6, 2.9), (1.2, 2.6), (1.0, 0.8), (4.9, 0.8)]
PATH = along(CORNERS, 0.02, 0.8, 1.5, START_S * 10**9)


def planted(xyyaw: np.ndarray, error: str) -> Trajectory:
    """Return the true path with an error in its second half."""
    stamps_ns, poses, half = PATH.stamps_ns, xyyaw.copy(), len(xyyaw) // 2
    if error == "slip of 0.1 m":
        poses[half:, 0] += 0.1
    elif error == "bend of 2 deg":
        bend = Pose(*poses[half]) @ Pose(yaw_rad=np.radians(2.0)) @ Pose(*poses[half]).inverse()
        poses[half:] = [bend @ Pose(*pose) for pose in poses[half:]]
    elif error == "scale of 1.02":
        poses[:, :2] *= 1.02
    elif error == "0.2 s late":
        stamps_ns = stamps_ns + 200_000_000
    return Trajectory(stamps_ns, poses)


ERRORS = ("slip of 0.1 m", "bend of 2 deg", "scale of 1.02", "0.2 s late")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    messages = drive_log(path=PATH, beams=180, noise_m=0.005)
    return open_log(write_mcap(tmp_path_factory.mktemp("log") / "log.mcap", messages))


def drawn(log: Log, path: Trajectory) -> tuple[SlamResult, Pose]:
    """Return what comes of poses that hold at their stamps."""
    config, mid_sweep_ns = load_config(None, [], {}), round(log.mid_sweep_s * 1e9)
    return draw_at_poses(log.scans, config, log.period_s, path, log.stamps_ns, mid_sweep_ns)[:2]


def quality(log: Log, outcome: SlamResult) -> tuple[float, float]:
    """Return the distance at revisits and the 95 % quantile of the wall thickness, mm."""
    measured = measured_map(outcome, log)
    walls = wall_report(measured.sections, measured.published, measured.cuts, outcome.grid.cell_m)
    return measured.quality.revisits.nn_l_mm, walls.spread.p95_mm


@pytest.fixture(scope="module")
def true(log: Log) -> tuple[SlamResult, Pose]:
    return drawn(log, PATH)


@pytest.mark.parametrize("error", ERRORS)
def test_every_planted_error_shows(log: Log, true: tuple[SlamResult, Pose], error: str) -> None:
    outcome, *_ = drawn(log, planted(PATH.xyyaw, error))
    (best_mm, thin_mm), (revisits_mm, thick_mm) = quality(log, true[0]), quality(log, outcome)
    assert thick_mm > 1.25 * thin_mm
    assert revisits_mm > best_mm


def test_the_truth_is_good_and_stays_where_it_is(log: Log, true: tuple[SlamResult, Pose]) -> None:
    outcome, world_T_map = true
    assert track_verdict(outcome, log, load_config(None, [], {})).word == "good"
    expected = PATH.poses_at(outcome.trajectory.stamps_ns + round(log.mid_sweep_s * 1e9), 10**9)
    np.testing.assert_allclose(outcome.trajectory.seen_from(world_T_map).xyyaw, expected, atol=1e-9)
    assert outcome.tracked_share == 1.0


@pytest.fixture(scope="module")
def own(log: Log) -> Trajectory | None:
    run = own_run(log, whole=False, config=load_config(None, [], {}), progress=silent)
    return run.trajectory if run else None


@pytest.mark.parametrize("error", ERRORS)
def test_every_planted_error_is_told(log: Log, own: Trajectory | None, error: str) -> None:
    differs = difference_section(drawn(log, planted(PATH.xyyaw, error))[0].trajectory, own, log)
    (jump,) = differs["jumps"] or [PoseJump(0.0, 0.0, 0.0)]
    late_s, scale = differs["late_s"], differs["distance_scale"]
    assert late_s == pytest.approx(0.2 if error == "0.2 s late" else 0.0, abs=0.02)
    assert scale == pytest.approx(1.02 if error == "scale of 1.02" else 1.0, abs=0.005)
    assert jump.moved_m == pytest.approx(0.1 if error == "slip of 0.1 m" else 0.0, abs=0.03)
    assert jump.turned_deg == pytest.approx(2.0 if error == "bend of 2 deg" else 0.0, abs=0.4)
    if jump.at_s:
        half_s = (PATH.stamps_ns[len(PATH) // 2] - log.first_ns) / 1e9
        assert jump.at_s == pytest.approx(half_s, abs=0.2)


def test_nothing_is_told_of_the_truth_nor_without_a_track(
    log: Log, true: tuple[SlamResult, Pose], own: Trajectory | None
) -> None:
    assert difference_section(true[0].trajectory, own, log) == {"late_s": 0.0, "distance_scale": 1.0, "jumps": []}
    assert difference_section(true[0].trajectory, None, log) == {}


def half_lost(track: Track) -> np.ndarray:
    """Return the poses of another track that goes astray, and is lost in the second half."""
    poses = track.steps.column("map_T_laser")[track.steps.column("tracked")] * 1.5
    poses[len(poses) // 2 :] = np.nan
    return poses


def test_a_second_track_that_is_lost_says_nothing(
    log: Log, true: tuple[SlamResult, Pose], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(given_poses, "UNDECIDED", (0.0, 1.0))
    monkeypatch.setattr(judge, "resampled_poses", half_lost)
    assert drawn(log, PATH)[0].doubt == true[0].doubt
    monkeypatch.setattr(given_poses, "SECOND_LOST", "")  # what it would say
    doubt = drawn(log, PATH)[0].doubt
    assert doubt is not None
    assert SECOND_LOST in {reason.name for reason in doubt.reasons}


def test_stamps_that_a_text_file_has_rounded_are_those_of_the_scans(log: Log) -> None:
    at_scans = log.stamps_ns + np.where(np.arange(len(log.stamps_ns)) < 5, 400, -400)  # just inside
    path = Trajectory(at_scans, PATH.poses_at(log.stamps_ns, 10**9))
    config = load_config(None, [], {})
    outcome, *_ = draw_at_poses(log.scans, config, log.period_s, path, log.stamps_ns)
    assert outcome.tracked_share == 1.0
    early = Trajectory(at_scans[:-3], path.xyyaw[:-3])
    outcome, *_ = draw_at_poses(log.scans, config, log.period_s, early, log.stamps_ns)
    assert len(outcome.steps) - len(outcome.trajectory) == 3


def test_poses_that_begin_near_their_origin_keep_their_frame(log: Log) -> None:
    first = Pose(*PATH.xyyaw[0])
    for off in (Pose(0.05, 0.0, np.radians(0.5)), Pose(0.2, 0.0, 0.0), Pose(0.0, 0.0, np.radians(2.0))):
        moved = Trajectory(PATH.stamps_ns, np.array([off @ first.inverse() @ Pose(*pose) for pose in PATH.xyyaw]))
        _, world_T_map = drawn(log, moved)
        assert (world_T_map == Pose()) == (off.x_m < 0.1 and off.yaw_rad < np.radians(1.0))


@pytest.mark.parametrize(("step", "placed"), [(2, 0.5), (3, 1.0)])
def test_scans_between_poses_have_none_where_most_scans_have_their_own(log: Log, step: int, placed: float) -> None:
    stamps_ns = log.stamps_ns[::step]
    path = Trajectory(stamps_ns, PATH.poses_at(stamps_ns, 10**9))
    config = load_config(None, [], {})
    outcome, *_ = draw_at_poses(log.scans, config, log.period_s, path, log.stamps_ns)
    assert outcome.tracked_share == pytest.approx(placed, abs=0.03)
    lacking = [text for text in outcome.warnings if "spread over the log, have no pose with their stamp" in text]
    assert len(lacking) == (placed < 1.0)


def test_poses_of_another_time_give_no_map(log: Log) -> None:
    outcome, *_ = drawn(log, Trajectory(PATH.stamps_ns - 10**12, PATH.xyyaw))
    assert len(outcome.trajectory) == 0
    assert outcome.lost_for_good


def test_names_frames_and_instants_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a,b.tum").touch()
    for text, source in {
        "x=poses.tum": TrajectorySource("x", "poses.tum", "laser", "whole"),
        "poses.tum,base@first": TrajectorySource("poses", "poses.tum", "base", "first"),
        "a,b.tum": TrajectorySource("a,b", "a,b.tum", "laser", "whole"),
        "me@home=poses.tum@last": TrajectorySource("me@home", "poses.tum", "laser", "last"),
        "slam=tf:map,base_link": TrajectorySource("slam", "tf:map,base_link", "", "whole"),
        "topic:/a/odom@first": TrajectorySource("odom", "topic:/a/odom", "", "first"),
    }.items():
        assert read_source(text) == source
    with pytest.raises(UsageError, match="names no directory"):
        read_source("a/b=poses.tum")


def test_the_folder_of_programs_names_no_trajectory(tmp_path: Path) -> None:
    source = TrajectorySource("programs", str(tmp_path / "poses.tum"), "laser")
    with pytest.raises(UsageError, match="programs is the folder of what programs write"):
        score_log(ScoreRequest(tmp_path / "log.mcap", tmp_path / "out", Config(), sources=(source,)), silent)
