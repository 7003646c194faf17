"""The type stores of ROS: definitions of all standard messages, and what (de)serializes by them."""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavnav.logs.messages.definitions import TF

OLDER = ("iron", "humble", "galactic", "foxy", "eloquent", "dashing")
"""The distributions of ROS 2 before the newest, the newest of them first."""


@cache
def types_ros2(distribution: str = "jazzy") -> Any:  # noqa: ANN401  rosbags' types are made at run time
    """Return the type store of a distribution of ROS 2, by default of the newest."""
    return get_typestore(Stores(f"ros2_{distribution}"))


@cache
def types_ros1() -> Any:  # noqa: ANN401
    """Return the type store of ROS 1, extended by TFMessage, which rosbags does not define for it."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return store


def definition(msgtype: str, types: Any = None) -> str:  # noqa: ANN401
    """Return the definition of a message type with the types that it contains (MCAP's ``ros2msg``)."""
    text, _ = (types or types_ros2()).generate_msgdef(msgtype, ros_version=2)
    return str(text)


def cdr(message: Any) -> bytes:  # noqa: ANN401
    """Serialize a message for ROS 2."""
    return bytes(types_ros2().serialize_cdr(message, message.__msgtype__))
