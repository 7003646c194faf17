"""Messages read by their layout are those that their definitions tell."""

from __future__ import annotations

from functools import partial

import pytest
from msgspec.structs import replace

from mavnav.logs.messages.decode import _deserialize, decoder
from mavnav.logs.messages.definitions import ODOMETRY, POSE, SCAN, TF, TRANSFORM, DecodeError, TransformMessage
from mavnav.logs.messages.fast_cdr import COVARIANCE, TWIST, exactly, laser_of, read_pose, read_transforms
from mavnav.logs.records import Channel
from mavnav.scan import Attitude
from support.log_files import PATH, POSE_COVARIANCE, START_NS, Message, build, drive, laser, serialized, store
from support.tilted import attitude_message

BY_LAYOUT = {
    TF: exactly(read_transforms),
    ODOMETRY: exactly(partial(read_pose, child=True, covariances=2 * COVARIANCE + TWIST)),
}
MESSAGES = [message for message in drive(2) if message.type in BY_LAYOUT]


def by_definition(data, encoding, kind):
    """Decode a message by its definition: the slow twin of what reads its layout."""
    message = _deserialize(data, encoding, kind)
    if kind == TF:
        return [transform(one) for one in message.transforms]
    if kind == TRANSFORM:
        return [transform(message)]
    pose = message.pose.pose if kind == ODOMETRY else message.pose
    return [transform_message(message.header, getattr(message, "child_frame_id", ""), pose.position, pose.orientation)]


def transform(message):
    moved = message.transform
    return transform_message(message.header, message.child_frame_id, moved.translation, moved.rotation)


def transform_message(header, child, p, q):
    stamp_ns = header.stamp.sec * 10**9 + header.stamp.nanosec
    return TransformMessage(stamp_ns, header.frame_id, child, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("frame", ["a", "odom", "base_link", "läser", ""])
def test_transforms_and_odometry(ros, frame) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    for message in MESSAGES:
        told = replace(message, fields=message.fields | {"child": frame})
        data = serialized(told, ros)
        found = BY_LAYOUT[message.type](data, encoding)
        assert found == by_definition(data, encoding, message.type)
        assert found[0].child == frame


@pytest.mark.parametrize("ros", [1, 2])
def test_poses(ros) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    data = serialized(attitude_message(START_NS + 5, Attitude(0.1, -0.2, 1.5)), ros)
    found = exactly(read_pose)(data, encoding)
    assert found == by_definition(data, encoding, POSE)
    assert (found[0].stamp_ns, found[0].xyz) == (START_NS + 5, (0.0, 0.0, 1.5))
    for broken in (*(data[:end] for end in range(0, len(data), 7)), data + bytes(8)):
        assert exactly(read_pose)(broken, encoding) is None


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize(("kind", "count"), [(POSE_COVARIANCE, 1), (PATH, 3)])
def test_poses_with_covariances_and_paths(ros, kind, count) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    poses = [Message("/p", POSE, START_NS + k, {"x": float(k), "y": 2.0, "yaw": 0.1 * k}) for k in range(count)]
    data = serialized(replace(poses[0], type=kind, fields=poses[0].fields | {"poses": poses}), ros)
    expected = [exactly(read_pose)(serialized(pose, ros), encoding)[0] for pose in poses]
    decode = decoder(Channel("/p", kind, encoding), poses=True)
    assert decode is not None
    assert decode(data) == expected
    for broken in (*(data[:end] for end in range(0, len(data), 7)), data + bytes(8)):
        with pytest.raises(DecodeError):
            decode(broken)


@pytest.mark.parametrize("ros", [1, 2])
def test_what_is_cut_or_goes_on_is_none(ros) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    for message in MESSAGES:
        data = serialized(message, ros)
        for broken in (*(data[:end] for end in range(0, len(data), 7)), data + bytes(8)):
            assert BY_LAYOUT[message.type](broken, encoding) is None
        with pytest.raises(DecodeError):
            decoder(Channel("/t", message.type, encoding))(data[: len(data) // 2])


@pytest.mark.parametrize("ros", [1, 2])
def test_one_transform(ros) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    types = store(ros)
    one = build(next(message for message in MESSAGES if message.type == TF), ros).transforms[0]
    data = bytes((types.serialize_ros1 if ros == 1 else types.serialize_cdr)(one, TRANSFORM))
    found = decoder(Channel("/t", TRANSFORM, encoding), poses=True)(data)
    assert found == exactly(partial(read_pose, child=True))(data, encoding) == by_definition(data, encoding, TRANSFORM)
    assert found[0].child == one.child_frame_id


@pytest.mark.parametrize("ros", [1, 2])
def test_a_scan_of_more_than_a_second_of_nanoseconds_is_one_if_its_type_says_so(ros) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    data = bytearray(serialized(laser(0), ros))  # 4 bytes, seconds, nanoseconds
    data[8:12] = (2_000_000_001).to_bytes(4, "little")
    assert laser_of(bytes(data), encoding) is None
    scan = decoder(Channel("/scan", SCAN, encoding))(bytes(data))
    stamp = _deserialize(bytes(data), encoding, SCAN).header.stamp
    assert scan.stamp_ns == stamp.sec * 10**9 + 2_000_000_001


def test_a_transform_of_ros1_may_be_later_than_2038() -> None:
    types = store(1)
    one = build(next(message for message in MESSAGES if message.type == TF), 1).transforms[0]
    data = bytearray(types.serialize_ros1(one, TRANSFORM))
    data[4:8] = (2**31 + 5).to_bytes(4, "little")  # seconds after the sequence number, without a sign in ROS 1
    (found,) = decoder(Channel("/t", TRANSFORM, "ros1"), poses=True)(bytes(data))
    assert found.stamp_ns // 10**9 == 2**31 + 5
