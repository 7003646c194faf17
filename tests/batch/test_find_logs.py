"""Which logs paths, patterns, folders and addresses stand for."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavnav.batch.cases import check_found, find_logs
from mavnav.errors import NoScansError, UsageError
from mavnav.outputs.documents.addresses import is_address


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    for name in ("a.mcap", "b.bag", "notes.txt", "sub/c.db3.zst", "sub/deep/a.mcap", ".hidden/x.mcap", "odd[1].bag"):
        path = tmp_path / "logs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    bag = tmp_path / "logs" / "drive"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("")
    (bag / "drive_0.db3").write_bytes(b"")
    done = tmp_path / "logs" / "run"
    done.mkdir()
    (done / "run.json").write_text("{}")
    (done / "result.mcap").write_bytes(b"")
    merged = tmp_path / "logs" / "sub" / "merged"
    merged.mkdir()
    (merged / "merge.json").write_text("{}")
    (merged / "session_a.mcap").write_bytes(b"")
    return tmp_path


ALL = ["logs/a.mcap", "logs/b.bag", "logs/drive", "logs/odd[1].bag", "logs/sub/c.db3.zst", "logs/sub/deep/a.mcap"]


def test_a_folder_stands_for_the_logs_in_it(logs: Path) -> None:
    assert find_logs(["logs"], logs) == ALL
    assert find_logs(["logs/sub/"], logs) == ALL[4:]


@pytest.mark.parametrize(
    ("link", "target"),
    [
        ("loop", "."),
        ("sub/up", ".."),
        ("sub/deep/up", "../.."),
        ("aaa", "sub"),
        ("aaa", "drive"),
        ("sub/aaa", "../run"),
    ],
)
@pytest.mark.parametrize("pattern", ["logs", "logs/*[!x]"])
def test_a_folder_that_links_lead_to_counts_once(logs: Path, pattern: str, link: str, target: str) -> None:
    (logs / "logs" / "notes.txt").unlink()
    (logs / "logs" / "run").rename(logs / "logs" / "sub" / "run")
    (logs / "logs" / link).symlink_to(target.replace("run", "sub/run"), target_is_directory=True)
    assert find_logs([pattern], logs) == ALL


def test_a_pattern_that_reaches_a_folder_by_a_link_too(logs: Path) -> None:
    (logs / "logs" / "aaa").symlink_to("sub")
    assert find_logs(["logs/*/*.zst"], logs) == ["logs/sub/c.db3.zst"]
    assert find_logs(["logs/aaa/*.zst"], logs) == ["logs/aaa/c.db3.zst"]


def test_links_to_logs_elsewhere_are_followed(logs: Path) -> None:
    (logs / "mine").mkdir()
    (logs / "mine" / "link").symlink_to("../logs/sub")
    assert find_logs(["mine"], logs) == find_logs(["m*"], logs) == ["mine/link/c.db3.zst", "mine/link/deep/a.mcap"]
    assert find_logs(["mine/link"], logs) == ["mine/link/c.db3.zst", "mine/link/deep/a.mcap"]


def test_a_folder_whose_logs_another_one_has_as_well_is_not_empty(logs: Path) -> None:
    (logs / "other").mkdir()
    (logs / "other" / "link").symlink_to("../logs/sub")
    assert find_logs(["[lo]*"], logs) == ALL


def test_patterns(logs: Path) -> None:
    assert find_logs(["logs/*.mcap"], logs) == ["logs/a.mcap"]
    assert find_logs(["logs/**/a.mcap"], logs) == ["logs/a.mcap", "logs/sub/deep/a.mcap"]
    assert find_logs([str(logs / "logs" / "?.bag")], logs) == ["logs/b.bag"]
    assert find_logs(["logs/d*"], logs) == ["logs/drive"]


def test_patterns_leave_out_what_runs_have_left_and_what_is_hidden(logs: Path) -> None:
    """Or the results of a batch would be logs of the next."""
    (logs / "logs/run/own.mcap").write_bytes(b"")
    (logs / "logs/sub/result.mcap").write_bytes(b"")
    found = ["logs/a.mcap", "logs/run/own.mcap", "logs/sub/deep/a.mcap", "logs/sub/result.mcap"]
    assert find_logs(["**/*.mcap"], logs) == found
    assert find_logs(["*/.hidden/*.mcap"], logs) == ["logs/.hidden/x.mcap"]
    assert find_logs(["logs/run/result.mcap"], logs) == ["logs/run/result.mcap"]


def test_a_name_with_brackets_is_a_name_first(logs: Path) -> None:
    assert find_logs(["logs/odd[1].bag"], logs) == ["logs/odd[1].bag"]


def test_each_once_in_order(logs: Path) -> None:
    assert find_logs(["logs/b.bag", "logs", "logs/a.mcap"], logs) == ["logs/b.bag", ALL[0], *ALL[2:]]


def test_a_way_round_leads_to_the_same_log(logs: Path) -> None:
    assert find_logs(["logs/b.bag", "logs/sub/../b.bag", f"../{logs.name}/logs/b.bag"], logs) == ["logs/b.bag"]
    (logs / "far").mkdir()
    (logs / "far" / "in").mkdir()
    (logs / "link").symlink_to("far/in", target_is_directory=True)
    assert find_logs(["link/../a.bag", "a.bag"], logs) == ["link/../a.bag", "a.bag"]


def test_what_stands_for_nothing_stays(logs: Path) -> None:
    (logs / "empty").mkdir()
    assert find_logs(["nothing/*.bag", "gone.bag", "empty"], logs) == ["nothing/*.bag", "gone.bag", "empty"]


def test_elsewhere_is_told_in_full(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    other = tmp_path_factory.mktemp("other")
    assert find_logs([str(logs / "logs" / "a.mcap")], other) == [str(logs / "logs" / "a.mcap")]


def test_addresses_are_left_alone(logs: Path) -> None:
    assert find_logs(["s3://bucket/*.mcap"], logs) == ["s3://bucket/*.mcap"]
    assert is_address("HTTPS://host/a.bag")
    assert is_address("simplecache::s3://bucket/a.bag")
    assert is_address("zip://a.bag::https://host/logs.zip")
    assert not is_address("C:/logs/a.bag")
    assert not is_address("logs/s3://a.bag")


def test_a_folder_that_cannot_be_read(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(UsageError, match="logs cannot be read: Permission denied"):
        find_logs(["logs"], logs)


@pytest.mark.parametrize(
    ("pattern", "error", "said"),
    [("empty", NoScansError, "empty: no logs in this folder"), ("*.mcapp", UsageError, "nothing fits this pattern")],
)
def test_what_stands_for_no_log_says_so(logs: Path, pattern: str, error: type, said: str) -> None:
    (logs / "empty").mkdir()
    (found,) = find_logs([pattern], logs)
    with pytest.raises(error, match=said):
        check_found(found, logs / found)
