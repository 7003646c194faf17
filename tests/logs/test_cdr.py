"""Messages written by their layout have the bytes of those written field by field."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.logs.messages import cdr, definitions, ros
from mavnav.pose import Pose
from mavnav.scan import Attitude, Scan
from support import ros_messages
from support.synthetic import URG_04LX

STAMP_NS = 1_282_836_370_971_000_123
POSE = Pose(1.25, -0.5, 2.0)
FRAMES = ["", "a", "map", "laser", "laser_", "laser_frame", "base_laser_link", "l\u00e4ser"]


@pytest.mark.parametrize("frame", FRAMES)
def test_poses(frame: str) -> None:
    assert cdr.poses(frame)(STAMP_NS, POSE) == ros.cdr(ros_messages.pose_stamped(STAMP_NS, frame, POSE))


@pytest.mark.parametrize("child", FRAMES)
@pytest.mark.parametrize("parent", FRAMES)
def test_transforms(parent: str, child: str) -> None:
    assert cdr.transforms(parent, child)(STAMP_NS, POSE) == ros.cdr(
        ros_messages.transform(STAMP_NS, parent, child, POSE)
    )


@pytest.mark.parametrize("child", FRAMES)
@pytest.mark.parametrize("parent", FRAMES)
def test_odometry_and_single_transforms(parent: str, child: str) -> None:
    assert cdr.odometry(parent, child)(STAMP_NS, POSE) == ros.cdr(ros_messages.odometry(STAMP_NS, parent, child, POSE))
    (single,) = ros_messages.transform(STAMP_NS, parent, child, POSE).transforms
    assert cdr.transform(parent, child)(STAMP_NS, POSE) == ros.cdr(single)


@pytest.mark.parametrize("frame", FRAMES)
def test_attitudes(frame: str) -> None:
    attitude = Attitude(0.2, -0.1, 1.5)
    assert cdr.attitudes(frame)(STAMP_NS, attitude) == ros.cdr(ros_messages.attitude(STAMP_NS, frame, attitude))


@pytest.mark.parametrize("no_return_m", [np.nan, 0.0])
@pytest.mark.parametrize("frame", FRAMES)
def test_scans(frame: str, no_return_m: float) -> None:
    ranges = np.linspace(0.1, 5.0, URG_04LX.beams)
    ranges[::7] = np.nan
    scan = Scan(STAMP_NS, ranges, URG_04LX)
    assert cdr.scans(frame, no_return_m)(scan) == ros.cdr(ros_messages.laser_scan(scan, frame, no_return_m))


@pytest.mark.parametrize("count", [0, 1, 3])
@pytest.mark.parametrize("frame", FRAMES)
def test_paths(frame: str, count: int) -> None:
    stamps = STAMP_NS + np.arange(count) * 100_000_000
    xyyaw = np.random.default_rng(0).uniform(-3, 3, (count, 3))
    poses = [ros_messages.pose_stamped(int(t), frame, Pose(*p.tolist())) for t, p in zip(stamps, xyyaw, strict=True)]
    assert cdr.path(STAMP_NS, frame, stamps, xyyaw) == ros.cdr(
        ros_messages._new(definitions.PATH, ros_messages._header(STAMP_NS, frame), poses)
    )


@pytest.mark.parametrize("frame", FRAMES)
def test_maps(frame: str) -> None:
    cells = np.random.default_rng(0).integers(-1, 101, (3, 5)).astype(np.int8)
    info = ros_messages._new(
        "nav_msgs/msg/MapMetaData", ros_messages._time(STAMP_NS), 0.02, 5, 3, ros_messages._pose(Pose(-1.5, 2.25))
    )
    slow = ros_messages._new(definitions.MAP, ros_messages._header(STAMP_NS, frame), info, cells.reshape(-1))
    assert cdr.occupancy_grid(STAMP_NS, frame, cells, 0.02, (-1.5, 2.25)) == ros.cdr(slow)


@pytest.mark.parametrize("name", definitions.fields())
def test_definitions(name: str) -> None:
    msgtype = name.replace("/", "/msg/")
    assert definitions.definition(msgtype) == ros.definition(msgtype)
