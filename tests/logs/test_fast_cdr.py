"""Messages read by their layout are those that their definitions tell."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavnav.logs.messages.decode import decoder
from mavnav.logs.messages.definitions import ODOMETRY, TF
from mavnav.logs.messages.fast_cdr import odometry_of, transforms_of
from mavnav.logs.messages.records import DecodeError
from mavnav.logs.records import Channel
from support.log_files import drive, serialized

BY_LAYOUT = {TF: transforms_of, ODOMETRY: odometry_of}
MESSAGES = [message for message in drive(2) if message.type in BY_LAYOUT]


@pytest.fixture
def by_definition(monkeypatch: pytest.MonkeyPatch):
    """Return what decodes a message by its definition alone."""

    def decode(data, encoding, kind):
        from mavnav.logs.messages import decode as room

        convert = {TF: room._transforms, ODOMETRY: room._odometry}[kind]
        return convert(room._deserialized(data, encoding, kind))

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
def test_what_is_cut_or_goes_on_is_left_to_the_definition(ros) -> None:
    encoding = {1: "ros1", 2: "cdr"}[ros]
    for message in MESSAGES:
        data = serialized(message, ros)
        for broken in (*(data[:end] for end in range(0, len(data), 7)), data + bytes(8)):
            assert BY_LAYOUT[message.type](broken, encoding) is None
        with pytest.raises(DecodeError):
            decoder(Channel("/t", message.type, encoding))(data[: len(data) // 2])
