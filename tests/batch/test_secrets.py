"""User names, passwords and queries of addresses reach no stream and no file, whatever command they are given to."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavnav.cli import run
from support.faults import run_here

pytest.importorskip("fsspec", reason="the extra mavnav[cluster]")

SECRETS = ("alice", "hunter2", "QUERYSECRET")
SHORT = ("--end", "0.3", "--online", "--grid", "5x5", "--azimuth", "6")


def planted(log: Path) -> str:
    """Return the address of a log with secrets; fsspec's local files take what follows the path for a part of it."""
    return f"http://alice:hunter2@127.0.0.1:9/{log.name}?sig=QUERYSECRET"


def found(place: Path) -> list[str]:
    """Return where a secret is: in names, or in files."""
    paths = sorted(place.rglob("*"))
    names = [str(path) for path in paths if any(secret in path.name for secret in SECRETS)]
    files = [path for path in paths if path.is_file()]
    return names + [str(path) for path in files if any(secret.encode() in path.read_bytes() for secret in SECRETS)]


@pytest.fixture
def address(home: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return an address with secrets, under which the good log is found, as if by a web server."""
    pytest.importorskip("aiohttp", reason="the extra mavnav[cluster]")
    monkeypatch.setattr("mavnav.batch.remote._open", lambda *_: (home / "logs" / "good.mcap").open("rb"))
    monkeypatch.setattr("mavnav.batch.runner.run_jobs", run_here)
    monkeypatch.setenv("MAVNAV_FETCH_TIMEOUT_S", "20")
    return planted(home / "logs" / "good.mcap")


@pytest.mark.parametrize(
    "words",
    [
        ("info",),
        ("info", "--json", "--debug"),
        ("convert", "new/out.mcap"),
        ("calibrate", "-o", "new/c.json"),
        ("replay", "-o", "new/run"),
        ("replay", "logs/good.mcap", "--truth"),
        ("metrics",),
        ("check",),
        ("batch", "-o", "new/batch", *SHORT, "--junit", "new/b.xml", "--summary", "new/b.md", "--annotations"),
        ("batch", "-o", "new/batch", *SHORT, "--json", "--report"),
        ("compare", "-o", "new/compare", *SHORT, "--grid", "4x4"),
    ],
    ids=" ".join,
)
def test_no_command_writes_a_secret(
    words: tuple[str, ...], address: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command, *more = words
    args = [command, *more, address] if "--truth" in more else [command, address, *more]
    Path("new").mkdir()
    fetches = command == "batch" or (
        command in ("info", "replay", "convert") and args[1] == address and "--debug" not in args
    )
    assert run(args, debug="--debug" in args) == (0 if fetches else 1 if command == "calibrate" else 2)
    captured = capsys.readouterr()
    assert not [secret for secret in SECRETS if secret in captured.out + captured.err]
    assert found(Path("new")) == []
    if command == "batch":
        assert list(Path("new").rglob("run.json"))


def test_a_manifest_keeps_its_secrets(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("m.yaml").write_text(f"logs: [{{log: '{address}', end_s: 0.3}}, 'ftp://alice:hunter2@h/x?QUERYSECRET']\n")
    run(["batch", "m.yaml", "-o", "new", "--online"])
    captured = capsys.readouterr()
    assert not [secret for secret in SECRETS if secret in captured.out + captured.err]
    assert found(Path("new")) == []
