"""Recordings: what is written is read back to the bit, in the same bytes every time, complete or not at all."""

from __future__ import annotations

import errno
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from rosbags.highlevel import AnyReader

from mavnav.errors import OutputError, UsageError
from mavnav.logs import open_log
from mavnav.logs.writing import recorder
from mavnav.logs.writing.recorder import Recording, check_recording
from mavnav.pose import Pose, Trajectory, yaw_of_quaternion
from mavnav.scan import Attitude, Scan
from support.synthetic import LDS_01, URG_04LX, along, drifting_odometry, furnished_rooms, record

BASE_T_LASER = Pose(0.06, -0.02, 0.1)
NAMES = {"mcap": "drive.mcap", "rosbag1": "drive.bag", "rosbag2-sqlite3": "drive"}
FORMATS = pytest.mark.parametrize(("form", "name"), NAMES.items(), ids=NAMES)
DIGESTS = {
    "/scan": "90c7ef2dc6895d81024acba2ac42f369", "/odom": "cd5e73d190d741a2f92e81eda573aca7",
    "/ground_truth": "d3812c3cbc69362b77dc0b19b345f8f5", "/tf": "94810edda583a504dfda3829e70d7eec",
    "/tf_static": "94810edda583a504dfda3829e70d7eec",
}  # fmt: skip
"""MD5 of the types, which ROS 1 compares before it plays a bag; from `rosmsg md5`."""


@pytest.fixture(scope="module")
def drive() -> Recording:
    world_T_base = along([(1.0, 1.0), (3.0, 1.0), (4.6, 3.0)])
    spec = replace(URG_04LX, angle_min_rad=float(np.float32(URG_04LX.angle_min_rad)))
    scans = record(furnished_rooms(), world_T_base.compose(BASE_T_LASER), spec, seed=3).scans
    return Recording(scans, drifting_odometry(world_T_base), world_T_base, BASE_T_LASER)


def contents(path):
    """Return the bytes of a file, or of the files of a folder by their names."""
    return {p.name: p.read_bytes() for p in sorted(path.iterdir())} if path.is_dir() else path.read_bytes()


def assert_same_poses(a: Trajectory, b: Trajectory) -> None:
    np.testing.assert_array_equal(a.stamps_ns, b.stamps_ns)
    np.testing.assert_allclose(a.xyyaw, b.xyyaw, rtol=0, atol=1e-15 * 8)  # the yaw goes through a quaternion


@FORMATS
def test_an_attitude_is_read_back(drive, form, name, tmp_path):
    attitudes = [
        (s.stamp_ns, Attitude(0.1 - 0.02 * k, 0.05 * k - 0.1, 1.0 + 0.01 * k)) for k, s in enumerate(drive.scans)
    ]
    recorder.record(replace(drive, attitudes=attitudes[:8], scans=drive.scans[:8]), tmp_path / name)
    found = open_log(tmp_path / name).attitude
    assert found.topic == "/attitude"
    read = np.column_stack((found.roll_rad, found.pitch_rad, found.height_m))
    np.testing.assert_allclose(read, [attitude for _, attitude in attitudes[:8]], atol=1e-6)
    np.testing.assert_array_equal(found.stamps_ns, [stamp_ns for stamp_ns, _ in attitudes[:8]])


@FORMATS
def test_what_is_recorded_is_read_back(drive, form, name, tmp_path):
    recorder.record(drive, tmp_path / name)
    log = open_log(tmp_path / name)
    assert (log.format, log.topic, log.frame_id, log.base_frame) == (form, "/scan", "laser", "base_link")
    assert log.stamp_source == "header"
    assert not log.damage
    assert not log.warnings
    for ours, theirs in zip(drive.scans, log.scans(), strict=True):
        assert theirs.stamp_ns == ours.stamp_ns
        np.testing.assert_array_equal(theirs.ranges_m, ours.ranges_m.astype(np.float32).astype(np.float64))
        assert theirs.spec.angle_min_rad == ours.spec.angle_min_rad
    assert log.mounting_source == "tf_static"
    assert log.base_T_laser.as_array() == pytest.approx(BASE_T_LASER.as_array(), abs=1e-15)
    assert log.odometry.topic == "/odom"
    assert_same_poses(log.odometry.odom_T_base, drive.odom_T_base)
    assert log.cleaning["zero"] == sum(int(np.isnan(scan.ranges_m).sum()) for scan in drive.scans) > 0
    assert log.cleaning["nan"] == 0


@FORMATS
def test_another_library_reads_truth_and_transforms(drive, form, name, tmp_path):
    recorder.record(drive, tmp_path / name)
    messages = {}
    with AnyReader([tmp_path / name]) as reader:
        order = []
        for connection, log_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append(message)
            stamp = (message.transforms[0] if "tf" in connection.topic else message).header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == log_ns
            order.append((log_ns, connection.topic))
    assert [t for t, _ in order] == sorted(t for t, _ in order)
    n = len(drive.scans)
    counts = {topic: len(of) for topic, of in messages.items()}
    assert counts == {"/tf_static": 1, "/tf": n, "/odom": n, "/ground_truth": n, "/scan": n}
    assert {m.header.frame_id for m in messages["/ground_truth"]} == {"world"}
    read = [(m.pose.position, m.pose.orientation) for m in messages["/ground_truth"]]
    xyyaw = [(p.x, p.y, yaw_of_quaternion(q.x, q.y, q.z, q.w)) for p, q in read]
    np.testing.assert_allclose(xyyaw, drive.world_T_base.xyyaw, atol=1e-14)
    assert {(t.header.frame_id, t.child_frame_id) for m in messages["/tf"] for t in m.transforms} == {
        ("odom", "base_link")
    }


def test_late_subscribers_get_the_mounting_and_ros1_finds_its_types(drive, tmp_path):
    for name in ("drive.mcap", "drive"):
        recorder.record(drive, tmp_path / name)
        with AnyReader([tmp_path / name]) as reader:
            durability = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
        assert {t for t, d in durability.items() if d == "TRANSIENT_LOCAL"} == {"/tf_static"}
    recorder.record(drive, tmp_path / "drive.bag")
    with AnyReader([tmp_path / "drive.bag"]) as reader:
        assert {c.topic: c.digest for c in reader.connections} == DIGESTS
        assert {c.topic for c in reader.connections if c.ext.latching == 1} == {"/tf_static"}


@FORMATS
def test_the_truth_is_never_taken_for_odometry(drive, form, name, tmp_path):
    silent = replace(drive, odom_T_base=Trajectory.of([], []))
    recorder.record(silent, tmp_path / name)
    assert open_log(tmp_path / name).odometry is None


@FORMATS
def test_the_same_recording_gives_the_same_bytes(drive, form, name, tmp_path):
    for folder in ("a", "b"):
        recorder.record(drive, tmp_path / folder / name)
    assert contents(tmp_path / "a" / name) == contents(tmp_path / "b" / name)


def test_in_one_stamp_truth_and_transform_come_before_the_scan(drive, tmp_path, monkeypatch):
    told = []

    def listen(path, channels):
        path.touch()
        return recorder.contextmanager(lambda: iter([lambda topic, stamp_ns, _: told.append((stamp_ns, topic))]))()

    monkeypatch.setitem(recorder.CONTAINERS, ".mcap", listen)
    recorder.record(drive, tmp_path / "x.mcap")
    assert [topic for _, topic in told[:5]] == ["/tf_static", "/ground_truth", "/tf", "/odom", "/scan"]
    assert [stamp for stamp, _ in told] == sorted(stamp for stamp, _ in told)


@settings(max_examples=15, deadline=None)
@given(data=st.data(), name=st.sampled_from(sorted(NAMES.values())))
def test_any_ranges_and_poses_come_back(tmp_path_factory, data, name):
    lengths = st.one_of(st.just(np.nan), st.floats(LDS_01.range_min_m, LDS_01.range_max_m))
    ranges = np.array([1.0, *data.draw(st.lists(lengths, min_size=3, max_size=8))])
    angle = st.floats(-3.14, 3.14)
    pose = Pose(*data.draw(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), angle)))
    scan = Scan(data.draw(st.integers(1, 2**31 * 10**9 - 1)), ranges, replace(LDS_01, beams=len(ranges)))
    path = tmp_path_factory.mktemp("any") / name
    recorder.record(Recording([scan], Trajectory.of([scan.stamp_ns], [pose]), Trajectory.of([], []), pose), path)
    read = open_log(path)
    (back,) = read.scans()
    np.testing.assert_array_equal(back.ranges_m, ranges.astype(np.float32))
    assert (back.stamp_ns, read.frame_id, read.base_frame) == (scan.stamp_ns, "laser", "base_link")
    assert read.base_T_laser.as_array() == pytest.approx(pose.as_array(), abs=1e-12)
    assert read.odometry.odom_T_base[0].as_array() == pytest.approx(pose.as_array(), abs=1e-12)


@FORMATS
def test_what_exists_stays_without_force(drive, form, name, tmp_path):
    short = replace(drive, scans=drive.scans[:3])
    recorder.record(drive, tmp_path / name)
    before = contents(tmp_path / name)
    with pytest.raises(OutputError, match="--force"):
        recorder.record(short, tmp_path / name)
    assert contents(tmp_path / name) == before
    recorder.record(short, tmp_path / name, force=True)
    assert open_log(tmp_path / name).counts.total == 3
    assert [p.name for p in tmp_path.iterdir()] == [name]


def failing(scan: Scan, error: BaseException):
    yield scan
    raise error


@FORMATS
@pytest.mark.parametrize("existing", [False, True])
def test_a_recording_that_fails_leaves_what_was_there(drive, form, name, existing, tmp_path):
    if existing:
        recorder.record(drive, tmp_path / name)
    before = {p.name: contents(p) for p in tmp_path.iterdir()}
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    for error, raised in (
        (full, OutputError),
        (RuntimeError("bug"), RuntimeError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ):
        with pytest.raises(raised):
            recorder.record(replace(drive, scans=failing(drive.scans[0], error)), tmp_path / name, force=True)
    assert {p.name: contents(p) for p in tmp_path.iterdir()} == before


def test_a_refusal_of_sqlite_is_an_output_error(drive, tmp_path, monkeypatch):
    def refuse(*_):
        raise recorder.sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr("rosbags.rosbag2.storage_sqlite3.Sqlite3Writer.write", refuse)
    with pytest.raises(OutputError, match="disk is full"):
        recorder.record(drive, tmp_path / "x")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("force", [False, True])
def test_what_is_no_log_is_never_replaced(tmp_path, force):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("precious")
    (tmp_path / "x.mcap").mkdir()
    (tmp_path / "notes").write_text("precious")
    for name in ("thesis", "x.mcap", "notes"):
        with pytest.raises(OutputError, match="another name"):
            check_recording(tmp_path / name, force=force)


@pytest.mark.parametrize("name", ["x.db3", "x.mcpa", "x.bag.zst"])
def test_a_name_of_no_format_is_a_usage_error(tmp_path, name):
    with pytest.raises(UsageError, match=r"\.mcap or \.bag"):
        check_recording(tmp_path / name, force=False)


def test_where_nothing_can_be_written_it_is_told(drive):
    from pathlib import Path

    with pytest.raises(OutputError, match="cannot be written"):
        recorder.record(drive, Path("/proc/mavnav/x.mcap"))
