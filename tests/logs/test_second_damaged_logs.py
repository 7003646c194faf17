"""The second set of damaged logs, as its README says."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from mavnav.cli import run
from mavnav.errors import NoScansError
from mavnav.logs import open_log

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.real_logs

BASES = ("cdr_chunk_lz4.mcap", "json_foxglove.mcap", "proto_foxglove.mcap")
BROKEN = {
    "del0_cdr_chunk_lz4.mcap": (88, 0),
    "del5_proto_foxglove.mcap": (94, 0),
    "dup5_json_foxglove.mcap": (93, 0),
    "ins1_json_foxglove.mcap": (93, 0),
    "len_and_bit.mcap": (88, 1),
    "two_bits.mcap": (88, 1),
    "burst0_cdr_chunk_none.mcap.zst": (0, 100),
    "ff4_cdr_chunk_none.mcap.zst": (0, 100),
}
"""File -> intact scans that no doubt is cast on, and how many may be altered if marked."""

REFUSED = {
    "protobuf_frame_repeated_wire.mcap": "field frame_id",
    "protobuf_nanos_string_empty.mcap": "field timestamp.nanos",
    "protobuf_ranges_single_wire.mcap": "field ranges",
    "protobuf_ts_string_strsec.mcap": "field timestamp.seconds",
    "sqlite_generated_hex.db3": "is computed",
}


def scans(path: Path, *, strict: bool = False) -> tuple[set[tuple[int, bytes]], int]:
    """Return the scans by content, and how many are suspect; none where all are left out."""
    try:
        log = open_log(path, strict=strict)
    except NoScansError:
        return set(), 0
    return {(scan.stamp_ns, scan.ranges_m.tobytes()) for scan in log.scans()}, log.counts.suspect


@pytest.mark.parametrize("name", BROKEN)
def test_intact_scans_come_out_and_no_altered_one_is_unmarked(name: str, real_logs: Path) -> None:
    sound = {scan for base in BASES for scan in scans(real_logs / "variants" / base)[0]}
    path = real_logs / "damaged" / "second" / name
    (found, suspect), (kept, _) = scans(path), scans(path, strict=True)
    intact, most_altered = BROKEN[name]
    assert kept <= sound
    assert len(kept) == intact
    assert len(found - sound) <= min(most_altered, suspect)


@pytest.mark.parametrize("name", [*BROKEN, "sqlite_topic_null.db3"])
def test_damage_is_reported(name: str, real_logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(real_logs / "damaged" / "second" / name), "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["damage"]


@pytest.mark.parametrize("name", REFUSED)
def test_the_field_or_column_is_named(name: str, real_logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(real_logs / "damaged" / "second" / name), "--quiet"]) == 4
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert REFUSED[name] in error


def test_a_topic_without_a_name_is_converted_as_damaged(real_logs: Path, tmp_path: Path) -> None:
    path = real_logs / "damaged" / "second" / "sqlite_topic_null.db3"
    assert run(["convert", str(path), str(tmp_path / "a.mcap"), "--quiet"]) == 3
