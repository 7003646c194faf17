"""ROS 1 bags whose first declaration of a topic is lost: the name is taken from wherever the file repeats it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mavnav.logs import survey
from support.log_files import laser, write_bag1

if TYPE_CHECKING:
    from pathlib import Path


def damaged(path: Path, compression: str, *, index: bool) -> bytes:
    """Return a bag without its first connection record, and with a wrong position of the index."""
    data = bytearray(write_bag1(path, [laser(k, topic="/front") for k in range(30)], compression).read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    end = int.from_bytes(data[at : at + 8], "little")
    data[at : at + 8] = bytes(8)
    first = data.index(b"topic=/front") if not compression else data.index(b"compression=bz2") + 200
    data[first : first + 12] = bytes(12)
    return bytes(data if index else data[:end])


@pytest.mark.parametrize("compression", ["", "BZ2"])
def test_a_topic_keeps_its_name(compression: str, tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(damaged(tmp_path / "sound.bag", compression, index=True))
    found = survey(path)
    assert set(found.scans) == {"/front"}
    assert found.scans["/front"].total > 15
    assert found.damage


def test_without_any_declaration_it_gets_one(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(damaged(tmp_path / "sound.bag", "BZ2", index=False))
    (name,) = survey(path).scans
    assert name.startswith("/connection_")
