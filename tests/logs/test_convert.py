"""`mavnav convert`: what can be read, as a sound MCAP that reads back the same."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader

from mavnav.cli import run
from mavnav.errors import NoScansError, OutputError, UsageError
from mavnav.logs import Topic, open_log
from mavnav.logs.writing.convert import convert_log
from support.log_files import LASER, ODOM, WRITERS, drive, foxglove_json, laser, write_bag1, write_bag2, write_mcap

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_becomes_an_mcap_with_the_same_scans_odometry_and_mounting(name: str, tmp_path: Path) -> None:
    source = WRITERS[name][1](tmp_path / "a", drive())
    done = convert_log(source, tmp_path / "b.mcap")
    assert (done.messages, done.left_out, done.damage) == (51, {}, ())
    before, after = open_log(source), open_log(tmp_path / "b.mcap")
    assert {(t.encoding, t.type.split("/")[1]) for t in after.topics} == {("cdr", "msg")}
    assert (after.counts, after.cleaning, after.base_T_laser) == (before.counts, before.cleaning, before.base_T_laser)
    assert (after.damage, after.warnings) == ((), ())
    for one, other in zip(before.scans(), after.scans(), strict=True):
        assert (one.stamp_ns, one.spec, one.ranges_m.tobytes()) == (
            other.stamp_ns,
            other.spec,
            other.ranges_m.tobytes(),
        )


def test_the_new_file_is_indexed_and_names_its_definitions(tmp_path: Path) -> None:
    convert_log(write_bag1(tmp_path / "a.bag", drive()), tmp_path / "b.mcap")
    with (tmp_path / "b.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics.message_count == 51
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        assert all(b"Header" in s.data for s in summary.schemas.values() if s.name == ODOM)
        assert sum(1 for _ in reader.iter_messages(topics=["/scan"])) == 25


def test_damaged_log_becomes_a_sound_one(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k) for k in range(60)], compression="NONE")
    data = bytearray(path.read_bytes()[:-2000])
    data[data.index(laser(20).fields["ranges"].tobytes()) + 3] ^= 1
    path.write_bytes(data)
    damaged = open_log(path)
    kept = convert_log(path, tmp_path / "kept.mcap")
    strict = convert_log(path, tmp_path / "strict.mcap", strict=True)
    assert kept.messages == damaged.counts.usable
    assert strict.left_out == {"suspect": damaged.counts.suspect}
    assert strict.messages == kept.messages - damaged.counts.suspect
    for name in ("kept.mcap", "strict.mcap"):
        assert open_log(tmp_path / name).damage == ()


def test_encodings_of_others_are_copied(tmp_path: Path) -> None:
    scan = {"timestamp": {"sec": 1, "nsec": 0}, "start_angle": 0.0, "end_angle": 1.0, "ranges": [1.0, 2.0]}
    result = convert_log(foxglove_json(tmp_path / "a", [scan]), tmp_path / "b.mcap")
    assert open_log(tmp_path / "b.mcap").topics[0].encoding == "json"
    said = "/scan: copied as they are (json), no messages of ROS 2; 'ros2 bag' refuses the file"
    assert result.warnings == (said,)
    assert convert_log(write_bag1(tmp_path / "c.bag", drive()), tmp_path / "d.mcap").warnings == ()


def test_the_same_log_gives_the_same_bytes(tmp_path: Path) -> None:
    source = write_bag1(tmp_path / "a.bag", drive())
    for name in ("b.mcap", "c.mcap"):
        convert_log(source, tmp_path / name)
    assert (tmp_path / "b.mcap").read_bytes() == (tmp_path / "c.mcap").read_bytes()


def test_refusals_say_why_and_leave_everything_alone(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "a.mcap", drive(3))
    before = source.read_bytes()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "there.mcap").write_text("old")
    with pytest.raises(UsageError, match="is the log itself; choose another name for the output"):
        convert_log(source, source, force=True)
    with pytest.raises(UsageError, match=r"end in \.mcap"):
        convert_log(source, tmp_path / "b.bag")
    with pytest.raises(UsageError, match="no such file"):
        convert_log(tmp_path / "absent", tmp_path / "b.mcap")
    with pytest.raises(NoScansError, match="the file is empty"):
        convert_log(tmp_path / "empty.mcap", tmp_path / "b.mcap")
    with pytest.raises(OutputError, match="--force"):
        convert_log(source, tmp_path / "there.mcap")
    assert {p.name for p in tmp_path.iterdir()} == {"a.mcap", "empty.mcap", "there.mcap"}
    assert (source.read_bytes(), (tmp_path / "there.mcap").read_text()) == (before, "old")
    convert_log(source, tmp_path / "there.mcap", force=True)
    assert open_log(tmp_path / "there.mcap").counts.usable == 3


def test_a_part_of_the_log_is_not_overwritten(tmp_path: Path) -> None:
    bag = write_bag2(tmp_path / "bag", drive(3), "MCAP")
    (part,) = bag.glob("*.mcap")
    before = part.read_bytes()
    with pytest.raises(UsageError, match="in the folder of the log"):
        convert_log(bag, part, force=True)
    assert part.read_bytes() == before


def test_the_folder_of_the_log_gets_no_new_files(tmp_path: Path) -> None:
    bag = write_bag2(tmp_path / "bag", drive(3))
    before = {file.name for file in bag.iterdir()}
    with pytest.raises(UsageError, match="in the folder of the log"):
        convert_log(bag, bag / "new.mcap")
    assert {file.name for file in bag.iterdir()} == before


def test_a_folder_is_no_target(tmp_path: Path) -> None:
    (tmp_path / "b.mcap").mkdir()
    with pytest.raises(UsageError, match="is not a file"):
        convert_log(write_mcap(tmp_path / "a.mcap", drive(3)), tmp_path / "b.mcap", force=True)


def test_a_log_without_messages_is_named_as_that(tmp_path: Path) -> None:
    with pytest.raises(NoScansError, match=r"a\.mcap: the log holds no messages; nothing to convert"):
        convert_log(write_mcap(tmp_path / "a.mcap", []), tmp_path / "b.mcap")


def test_a_source_that_cannot_be_read_is_not_blamed_on_the_target(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").symlink_to("/proc/self/mem")
    with pytest.raises(UsageError, match=r"a\.mcap: cannot be read \(Input/output error\)"):
        convert_log(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_what_does_not_read_back_gets_no_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    topics = (Topic("/scan", LASER, "cdr", 99),)
    monkeypatch.setattr("mavnav.logs.writing.convert._Writing.topics", lambda _: topics)
    with pytest.raises(OutputError, match="reads back differently"):
        convert_log(write_mcap(tmp_path / "a.mcap", drive(3)), tmp_path / "b.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_the_command_prints_one_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_mcap(tmp_path / "a.mcap", drive(30))
    source.write_bytes(source.read_bytes()[:-3000])
    assert run(["convert", str(source), str(tmp_path / "b.mcap"), "--json"]) == 3
    document = json.loads(capsys.readouterr().out)
    assert document["messages"] == sum(t["count"] for t in document["topics"])
    assert document["exit_code"] == 3
    assert document["damage"]
    assert run(["convert", str(source), str(tmp_path / "b.mcap"), "--force"]) == 3
    assert "b.mcap" in capsys.readouterr().out
