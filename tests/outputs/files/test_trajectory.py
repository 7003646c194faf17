"""Trajectory files, read back by evo and by the csv module."""

import csv
import warnings

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.outputs.files.trajectory import seconds, tum_lines, write_base_tum, write_csv, write_tum
from mavnav.pose import Pose, Trajectory, yaw_of_quaternion
from mavnav.slam.findings import Doubt, Reason


def read_tum(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from evo.tools.file_interface import read_tum_trajectory_file

        return read_tum_trajectory_file(str(path))


def test_tum_is_read_by_evo(run, tmp_path):
    write_tum(run, tmp_path / "t.tum")
    read, written = read_tum(tmp_path / "t.tum"), run.slam.trajectory
    assert read.check()[0]
    np.testing.assert_allclose(read.positions_xyz[:, :2], written.xyyaw[:, :2], atol=1e-9)
    yaw = [yaw_of_quaternion(x, y, z, w) for w, x, y, z in read.orientations_quat_wxyz]
    np.testing.assert_allclose(np.sin(yaw - written.xyyaw[:, 2]), 0.0, atol=1e-9)
    assert len(read.timestamps) == sum(s.tracked for s in run.slam.steps) == len(run.slam.steps) - 2


def test_tum_keeps_every_nanosecond(run, tmp_path):
    write_tum(run, tmp_path / "t.tum")
    first_columns = [line.split()[0] for line in (tmp_path / "t.tum").read_text().splitlines()]
    assert [int(c.replace(".", "")) for c in first_columns] == run.slam.trajectory.stamps_ns.tolist()


def test_base_tum_is_the_laser_moved_by_the_mounting(run, tmp_path):
    write_base_tum(run, tmp_path / "b.tum")
    read, mounting = read_tum(tmp_path / "b.tum"), run.log.base_T_laser
    for k, (w, x, y, z) in enumerate(read.orientations_quat_wxyz):
        map_T_base = Pose(*read.positions_xyz[k, :2], yaw_of_quaternion(x, y, z, w))
        laser = map_T_base @ mounting
        assert (laser.x_m, laser.y_m) == pytest.approx(tuple(run.slam.trajectory.xyyaw[k, :2]), abs=1e-8)


def test_base_tum_needs_the_mounting(run, change, tmp_path):
    with pytest.raises(ValueError, match="mounting"):
        write_base_tum(change(run, base_T_laser=None), tmp_path / "b.tum")


def test_csv_has_a_row_for_every_scan_and_poses_for_the_tracked(run, tmp_path):
    write_csv(run, tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(r["index"]) for r in rows] == [s.index for s in run.slam.steps]
    for row, step in zip(rows, run.slam.steps, strict=True):
        assert (row["x_m"] != "") == (row["cost_m2"] != "") == bool(int(row["tracked"])) == step.tracked
        assert bool(int(row["accepted"])) == step.tracked
        assert int(row["evaluations"]) == step.match.evaluations
        if step.tracked:
            assert float(row["x_m"]) == pytest.approx(step.match.map_T_laser.x_m, abs=1e-9)


def test_csv_marks_the_doubtful_scans(run, tmp_path):
    stamps_ns = run.slam.steps.column("stamp_ns")
    doubt = Doubt(0.9, (Reason("slip", int(stamps_ns[3]), int(stamps_ns[5]), 2.0),))
    write_csv(replace(run, slam=replace(run.slam, doubt=doubt)), tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as file:
        marked = [row["index"] for row in csv.DictReader(file) if row["doubtful"] == "1"]
    assert marked == ["3", "4", "5"]


@pytest.mark.parametrize(
    ("stamp_ns", "text"),
    [(0, "0.000000000"), (1_700_000_000_123_456_789, "1700000000.123456789"), (-1, "-0.000000001")],
)
def test_seconds(stamp_ns, text):
    assert seconds(stamp_ns) == text


def test_csv_has_the_covariance_where_it_is_known(run, tmp_path):
    covariances = np.full((len(run.slam.steps), 6), np.nan)
    covariances[0] = np.arange(6) * 1e-6
    write_csv(replace(run, slam=replace(run.slam, covariances=covariances)), tmp_path / "t.csv")
    with (tmp_path / "t.csv").open() as file:
        first, second, *_ = csv.DictReader(file)
    assert (float(first["cov_xy_m2"]), float(first["cov_yawyaw_rad2"])) == (1e-6, 5e-6)
    assert second["cov_xx_m2"] == ""


def test_no_negative_zeros_are_written():
    poses = [Pose(-0.0, -1e-12, -1e-15), Pose(-0.5, -0.0, 0.0)]
    assert [line.split()[1:] for line in tum_lines(Trajectory.of([0, 1], poses))] == [
        ["0.000000000", "0.000000000", "0", "0", "0", "0.000000000000", "1.000000000000"],
        ["-0.500000000", "0.000000000", "0", "0", "0", "0.000000000000", "1.000000000000"],
    ]


def test_the_table_has_no_negative_zeros(run, tmp_path):
    zeros = replace(
        run,
        slam=replace(
            run.slam, trajectory=Trajectory(run.slam.trajectory.stamps_ns.copy(), run.slam.trajectory.xyyaw * -1e-15)
        ),
    )
    write_csv(zeros, tmp_path / "t.csv")
    assert "-0.000000000," not in (tmp_path / "t.csv").read_text()
