"""Messages read in columns are those that are read one by one, whatever layouts follow each other on a topic."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from mavnav.logs.messages import fast_cdr
from mavnav.logs.messages.decode import decode_together, decoder
from mavnav.logs.messages.definitions import ODOMETRY, TF, DecodeError, ImuMessage
from mavnav.logs.records import Channel
from support.log_files import IMU, START_NS, Message, serialized

FRAMES = ("base_link", "/base_link", "läser", "")


def message(kind: str, k: int, rng: np.random.Generator) -> Message:
    x, y, yaw = rng.normal(size=3).tolist()
    names = {"parent": "odom", "child": FRAMES[rng.integers(len(FRAMES))]}
    fields = {"rates": (x, y, yaw), **({"xyzw": (0.0, 0.6, 0.8, x)} if k % 3 else {})}
    return Message("/t", kind, START_NS + k, fields if kind == IMU else names | {"x": x, "y": y, "yaw": yaw})


def one_by_one(datas: list[bytes], channel: Channel) -> tuple[list[tuple[object, ...]], set[int]]:
    """Return what single messages hold, a line for each pose or measurement, and which do not decode."""
    decode, lines, wrong = decoder(channel), [], set()
    for row, data in enumerate(datas):
        try:
            value = decode(data)
        except DecodeError:
            wrong.add(row)
            continue
        for each in [value] if isinstance(value, ImuMessage) else value:
            xyzw = each.xyzw or (np.nan,) * 4
            parts = (
                (each.angular_velocity_rad_s, each.acceleration_m_s2) if isinstance(each, ImuMessage) else (each.xyz,)
            )
            frames = (each.frame_id,) if isinstance(each, ImuMessage) else (each.parent, each.child)
            lines.append((row, each.stamp_ns, frames, repr([float(v) for part in (xyzw, *parts) for v in part])))
    return lines, wrong


def in_columns(datas: list[bytes], channel: Channel) -> tuple[list[tuple[object, ...]], set[int]]:
    log_ns, lines = np.arange(len(datas)) * 7, []
    parts, errors = decode_together(channel, datas, log_ns, decoder(channel))
    for part in parts:
        assert (part.log_ns == log_ns[part.rows]).all()
        frames = tuple(value for value in part if isinstance(value, str))
        vectors = [value.T for name, value in zip(part._fields, part, strict=True) if getattr(value, "ndim", 1) == 2]
        order = vectors if channel.type == IMU else vectors[::-1]
        for k, row in enumerate(part.rows.tolist()):
            numbers = [float(v) for vector in order for v in vector[k]]
            lines.append((row, int(part.stamps_ns[k]), frames, repr(numbers)))
    return lines, set(errors)


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("kind", [ODOMETRY, TF, IMU])
@pytest.mark.parametrize("layouts", [fast_cdr.MOST_LAYOUTS, 1])
def test_columns_hold_what_single_messages_do(
    kind: str, ros: int, layouts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fast_cdr, "MOST_LAYOUTS", layouts)
    rng = np.random.default_rng(ros)
    datas = [serialized(message(kind, k, rng), ros) for k in range(60)]
    for row in (0, 7, 30):
        datas[row] = datas[row][:-9]
    datas[11], datas[12], datas[13] = b"", b"\xff" * len(datas[10]), datas[10][:9] + b"\xff" + datas[10][10:]
    channel = Channel("/t", kind, {1: "ros1", 2: "cdr"}[ros])
    expected, wrong = one_by_one(datas, channel)
    lines, errors = in_columns(datas, channel)
    assert len(expected) > 50
    assert Counter(lines) == Counter(expected)
    assert errors == wrong >= {0, 7, 11, 30}


def test_poses_of_one_frame_keep_the_order_of_their_messages() -> None:
    rng = np.random.default_rng(3)
    datas = [serialized(message(ODOMETRY, k, rng), 2) for k in range(40)]
    channel = Channel("/t", ODOMETRY, "cdr")
    parts, _ = decode_together(channel, datas, np.arange(40), decoder(channel))
    assert len(parts) == len(FRAMES)
    poses = fast_cdr.merge(parts)
    assert poses.rows.tolist() == [*range(40)]
    assert poses.stamps_ns.tolist() == [START_NS + k for k in range(40)]
    assert poses.child == decoder(channel)(datas[0])[0].child
    groups = fast_cdr.merge_by(parts, lambda part: part.child.lstrip("/"))
    assert sum(len(group.rows) for group in groups.values()) == 40
    assert all((np.diff(group.rows) > 0).all() for group in groups.values())
    assert (np.diff([group.rows[0] for group in groups.values()]) > 0).all()
