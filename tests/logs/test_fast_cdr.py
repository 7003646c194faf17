"""Messages read by their layout are those that their definitions tell."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from mavnav.logs.messages.decode import decoder
from mavnav.logs.messages.definitions import ODOMETRY, POSE, TF
from mavnav.logs.messages.fast_cdr import odometry_of, pose_of, transforms_of
from mavnav.logs.messages.records import DecodeError
from mavnav.logs.records import Channel
from mavnav.scan import Attitude
from support.log_files import START_NS, drive, serialized
from support.tilted import attitude_message

BY_LAYOUT = {TF: transforms_of, ODOMETRY: odometry_of}
MESSAGES = [message for message in drive(2) if message.type in BY_LAYOUT]


@pytest.fixture
def by_definition(monkeypatch: pytest.MonkeyPatch):
    """Return what decodes a message by its definition alone."""

    def decode(data, encoding, kind):
        from mavnav.logs.messages import decode as room

        convert = {TF: room._transforms, ODOMETRY: room._odometry, POSE: room._pose}[kind]
        return convert(room._deserialize(data, encoding, kind))

    return decode


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("frame", ["a", "odom", "base_link", "läser", ""])
def test_transforms_and_odometry(by_definition, ros, frame) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    for message in MESSAGES:
        told = replace(message, fields=message.fields | {"child": frame})
        data = serialized(told, ros)
        found = BY_LAYOUT[message.type](data, encoding)
        assert found == by_definition(data, encoding, message.type)
        assert found[0].child == frame


@pytest.mark.parametrize("ros", [1, 2])
def test_poses(by_definition, ros) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    data = serialized(attitude_message(START_NS + 5, Attitude(0.1, -0.2, 1.5)), ros)
    found = pose_of(data, encoding)
    assert found == by_definition(data, encoding, POSE)
    assert (found[0].stamp_ns, found[0].xyz) == (START_NS + 5, (0.0, 0.0, 1.5))
    for broken in (*(data[:end] for end in range(0, len(data), 7)), data + bytes(8)):
        assert pose_of(broken, encoding) is None


@pytest.mark.parametrize("ros", [1, 2])
def test_what_is_cut_or_goes_on_is_left_to_the_definition(ros) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    for message in MESSAGES:
        data = serialized(message, ros)
        for broken in (*(data[:end] for end in range(0, len(data), 7)), data + bytes(8)):
            assert BY_LAYOUT[message.type](broken, encoding) is None
        with pytest.raises(DecodeError):
            decoder(Channel("/t", message.type, encoding))(data[: len(data) // 2])
