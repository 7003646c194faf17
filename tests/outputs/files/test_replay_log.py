"""result.mcap, read by the mcap library and by rosbags."""

from itertools import pairwise
from math import hypot

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from mavnav.mapping.occupancy_grid import known_area, occupancy
from mavnav.outputs.files import replay_log
from mavnav.outputs.files.replay_log import write
from mavnav.pose import Pose, yaw_of_quaternion

TYPES = {
    "/tf_static": "tf2_msgs/msg/TFMessage", "/tf": "tf2_msgs/msg/TFMessage", "/scan": "sensor_msgs/msg/LaserScan",
    "/pose": "geometry_msgs/msg/PoseStamped", "/path": "nav_msgs/msg/Path", "/map": "nav_msgs/msg/OccupancyGrid",
    "/markers": "visualization_msgs/msg/MarkerArray",
}  # fmt: skip


@pytest.fixture(scope="module")
def path(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("result") / "result.mcap"
    write(run, path)
    return path


def decoded(path):
    with AnyReader([path]) as reader:
        return [(c.topic, t, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages()]


@pytest.fixture(scope="module")
def messages(path):
    return decoded(path)


def of(messages, topic):
    return [message for name, _, message in messages if name == topic]


def ns(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def pose_of(transform):
    shift, turn = transform.transform.translation, transform.transform.rotation
    return Pose(shift.x, shift.y, yaw_of_quaternion(turn.x, turn.y, turn.z, turn.w))


def test_the_container_is_what_viewers_expect(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        order = [channel.topic for _, channel, _ in reader.iter_messages(log_time_order=False)]
    assert header.profile == "ros2"
    assert {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()} == TYPES
    assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
    assert {i.compression for i in summary.chunk_indexes} == {"zstd"}
    assert order[:5] == ["/tf_static", "/tf", "/scan", "/pose", "/map"]
    assert order[-3:] == ["/markers", "/path", "/map"]


def test_late_subscribers_get_map_and_static_transforms(path):
    with AnyReader([path]) as reader:
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
    assert {t for t, d in durability.items() if d == "TRANSIENT_LOCAL"} == {"/tf_static", "/map", "/path", "/markers"}
    assert durability["/tf"] == "VOLATILE"


def test_in_time_order_the_transform_still_comes_before_its_scan(messages):
    stamps = [t for _, t, _ in messages]
    assert stamps == sorted(stamps)
    topics = [topic for topic, _, _ in messages if topic in {"/tf", "/scan"}]
    assert topics == ["/tf", "/scan"] * (len(topics) // 2)


def test_tracked_scans_alone_are_shown_with_their_own_stamps_and_ranges(run, messages):
    shown, tracked = of(messages, "/scan"), {s.stamp_ns for s in run.slam.steps if s.tracked}
    assert {ns(m.header.stamp) for m in shown} == tracked
    recorded = {scan.stamp_ns: scan for scan in run.log.recorded}
    for message in shown:
        scan = recorded[ns(message.header.stamp)]
        np.testing.assert_allclose(message.ranges, scan.ranges_m, rtol=1e-6, equal_nan=True)
        assert message.angle_min == pytest.approx(scan.spec.angle_min_rad)
        assert message.angle_max == pytest.approx(scan.spec.angles_rad[-1])
        assert message.header.frame_id == "laser"


def test_the_transforms_place_the_laser_where_the_trajectory_says(run, messages):
    (static,) = of(messages, "/tf_static")[0].transforms
    assert (static.header.frame_id, static.child_frame_id) == ("base_footprint", "laser")
    trajectory = run.slam.trajectory
    for k, message in enumerate(of(messages, "/tf")):
        (moving,) = message.transforms
        assert (moving.header.frame_id, moving.child_frame_id) == ("map", "base_footprint")
        assert ns(moving.header.stamp) == trajectory.stamps_ns[k]
        laser = pose_of(moving) @ pose_of(static)
        assert hypot(laser.x_m - trajectory[k].x_m, laser.y_m - trajectory[k].y_m) < 1e-9
    assert len(of(messages, "/pose")) == len(trajectory)
    assert len(of(messages, "/path")[0].poses) == len(trajectory)


def test_without_a_mounting_the_laser_hangs_on_the_map(run, change, tmp_path):
    write(change(run, base_T_laser=None, base_frame=None, frame_id=""), tmp_path / "r.mcap")
    messages = decoded(tmp_path / "r.mcap")
    assert not of(messages, "/tf_static")
    assert {t.child_frame_id for m in of(messages, "/tf") for t in m.transforms} == {"laser"}


def test_the_map_grows_and_ends_as_the_map_file(run, messages):
    *growing, final = of(messages, "/map")
    part = known_area(run.slam.grid)
    np.testing.assert_array_equal(final.data.reshape(final.info.height, final.info.width), occupancy(part))
    assert final.info.resolution == pytest.approx(part.cell_m)
    assert (final.info.origin.position.x, final.info.origin.position.y) == part.origin_xy_m
    walls = [int((m.data == 100).sum()) for m in growing]
    assert walls == sorted(walls)
    assert 0 < walls[0] < walls[-1] <= (final.data == 100).sum()
    assert walls[-1] > 0.99 * (final.data == 100).sum()
    assert all(set(np.unique(m.data)) <= {-1, 100} for m in growing)
    stamps = [ns(m.header.stamp) for m in growing]
    assert min(b - a for a, b in pairwise(stamps)) >= 1_000_000_000


@pytest.mark.parametrize(("limits", "most"), [({"MAX_MAPS": 3}, 5), ({"MAX_MAP_BYTES": 1}, 1)])
def test_maps_are_few_where_they_would_swell_the_file(run, tmp_path, monkeypatch, limits, most):
    for name, value in limits.items():
        monkeypatch.setattr(replay_log, name, value)
    write(run, tmp_path / "r.mcap")
    assert 1 <= len(of(decoded(tmp_path / "r.mcap"), "/map")) <= most
