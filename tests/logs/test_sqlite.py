"""sqlite3 storage that a recorder left half written: journals, and pages of all sizes cut anywhere."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from mavnav.logs import open_log
from support.log_files import laser, write_bag2

if TYPE_CHECKING:
    from pathlib import Path

SCANS = 40


@pytest.fixture
def sound(tmp_path: Path) -> Path:
    return next(write_bag2(tmp_path / "bag", [laser(k, beams=100) for k in range(SCANS)]).glob("*.db3"))


def crashed(source: Path, folder: Path) -> tuple[Path, Path]:
    """Leave a file and its write-ahead log as a recorder that is killed does; every scan is a write of its own."""
    target = folder / "crashed.db3"
    with closing(sqlite3.connect(folder / "live.db3")) as live, closing(sqlite3.connect(source)) as old:
        live.execute("PRAGMA journal_mode=WAL")
        live.execute("PRAGMA wal_autocheckpoint=0")
        for table in ("topics", "messages"):
            live.execute(old.execute("SELECT sql FROM sqlite_master WHERE name = ?", [table]).fetchone()[0])
            for row in old.execute(f"SELECT * FROM {table}"):
                live.execute(f"INSERT INTO {table} VALUES ({','.join('?' * len(row))})", row)
                live.commit()
        shutil.copyfile(folder / "live.db3", target)
        shutil.copyfile(folder / "live.db3-wal", folder / "crashed.db3-wal")
    return target, folder / "crashed.db3-wal"


@pytest.mark.parametrize("linked", [False, True])
def test_a_log_of_writes_beside_the_file_is_taken_in_whole(sound: Path, tmp_path: Path, *, linked: bool) -> None:
    path = crashed(sound, tmp_path)[0]
    if linked:
        (link := tmp_path / "logs" / "drive.db3").parent.mkdir()
        link.symlink_to(path)
        path = link
    log = open_log(path)
    assert (log.counts.usable, log.counts.suspect, log.damage) == (SCANS, 0, ())
    assert any("beside it was read too" in warning for warning in log.warnings)


@pytest.mark.parametrize("fault", ["cut", "flip"])
def test_writes_that_are_lost_with_a_broken_page_are_told(fault: str, sound: Path, tmp_path: Path) -> None:
    path, wal = crashed(sound, tmp_path)
    data = bytearray(wal.read_bytes())
    middle = len(data) // 2
    wal.write_bytes(data[:middle] if fault == "cut" else data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :])
    log = open_log(path)
    assert 10 < log.counts.usable < SCANS
    assert any("pages in crashed.db3-wal are broken" in d.what for d in log.damage)


@pytest.mark.parametrize("page_bytes", [512, 4096, 16384])
def test_of_a_page_that_is_cut_the_rows_that_are_left_are_read(page_bytes: int, sound: Path) -> None:
    with closing(sqlite3.connect(sound, isolation_level=None)) as connection:
        connection.execute("DROP INDEX timestamp_idx")
        connection.execute(f"PRAGMA page_size={page_bytes}")
        connection.execute("VACUUM")  # the last page holds the last rows, its first row at its end
    sound.write_bytes(sound.read_bytes()[:-100])
    log = open_log(sound)
    assert SCANS - 2 <= log.counts.usable < SCANS
    assert log.damage


@pytest.mark.parametrize("change", ["serialization_format = 'CDR'", "type = ''"])
def test_topics_that_do_not_tell_what_they_hold_are_scans_by_their_bytes(change: str, sound: Path) -> None:
    with closing(sqlite3.connect(sound, isolation_level=None)) as connection:
        connection.execute(f"UPDATE topics SET {change}")
    log = open_log(sound)
    assert (log.topic, log.counts.usable, len(log.damage)) == ("/scan", SCANS, 1)
