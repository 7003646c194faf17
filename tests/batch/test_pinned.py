"""Pinned logs: fetched once from a server on the loopback, checked, gone on with; and the set that is shipped."""

from __future__ import annotations

import time
from collections.abc import Iterator
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from mavnav.batch import remote
from mavnav.batch.baseline import read_baseline
from mavnav.batch.manifest import read_manifest
from mavnav.batch.options import SETS, BatchOptions, request_of
from mavnav.batch.remote import Pin, pinned_file
from mavnav.errors import ConfigError, ExitCode, UsageError
from support.html_page import Page
from support.small_batch import NAME, batch

pytest.importorskip("fsspec", reason="the extra mavnav[cluster]")
pytest.importorskip("aiohttp", reason="the extra mavnav[cluster]")


class Server:
    """A server of one file: how much of it is sent before the connection ends, and the ranges that were asked for."""

    def __init__(self, content: bytes) -> None:
        self.content, self.share, self.knows_ranges = content, 1.0, True
        self.ranges: list[str | None] = []
        self.address, self.cache = "", Path()


@pytest.fixture
def server(home: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Server]:
    served = Server((home / "logs" / "good.mcap").read_bytes())
    served.cache = tmp_path / "cache"
    monkeypatch.setattr(remote, "user_directory", lambda: served.cache)  # kernels stay where they are

    class Handler(BaseHTTPRequestHandler):
        def do_HEAD(self) -> None:
            self.send_response(200 if self.path.startswith("/good") else 404)
            self.send_header("Content-Length", str(len(served.content)))
            self.end_headers()

        def do_GET(self) -> None:
            wanted = self.headers.get("Range")
            served.ranges.append(wanted)
            if not self.path.startswith("/good"):
                self.send_error(404)
                return
            begin = int(wanted.removeprefix("bytes=").removesuffix("-")) if wanted and served.knows_ranges else 0
            rest = served.content[begin:]
            self.send_response(206 if begin else 200)
            self.send_header("Content-Length", str(len(rest)))
            self.end_headers()
            self.wfile.write(rest[: round(served.share * len(rest))])
            time.sleep(0.2 if served.share < 1.0 else 0.0)  # so that it arrives before the end does

        def log_message(self, *words: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        thread = Thread(target=http.serve_forever, args=(0.01,))
        thread.start()
        served.address = f"http://127.0.0.1:{http.server_port}/good.mcap"
        yield served
        http.shutdown()
        thread.join()


def pin_of(content: bytes) -> Pin:
    return Pin(sha256(content).hexdigest(), len(content))


def fetched(server: Server, copies: Path | None = None) -> Path:
    return pinned_file(server.address, pin_of(server.content), copies, lambda *_: None)


def test_a_file_is_fetched_once(server: Server) -> None:
    path = fetched(server)
    assert path.read_bytes() == server.content
    assert fetched(server) == path
    assert server.ranges == [None]
    assert [file.name for file in path.parent.iterdir()] == ["good.mcap"]


def test_a_copy_is_used_by_its_content_whatever_its_name(server: Server, tmp_path: Path) -> None:
    (tmp_path / "copies" / "deep").mkdir(parents=True)
    (tmp_path / "copies" / "good.mcap").write_bytes(bytes(len(server.content)))
    (tmp_path / "copies" / "deep" / "x").write_bytes(server.content)
    with pytest.raises(UsageError, match="is no folder; name that of your copies"):
        fetched(server, tmp_path / "copies" / "good.mcap")
    assert fetched(server, tmp_path / "copies") == tmp_path / "copies" / "deep" / "x"
    assert server.ranges == []


@pytest.mark.parametrize("knows_ranges", [True, False])
def test_an_interrupted_download_goes_on_where_it_ended(server: Server, *, knows_ranges: bool) -> None:
    server.share = 0.4
    with pytest.raises(UsageError, match="cannot be read"):
        fetched(server)
    server.share, server.knows_ranges = 1.0, knows_ranges
    (part,) = (server.cache / "logs").rglob("*.part")
    there = part.stat().st_size
    assert 0 < there < len(server.content)
    assert fetched(server).read_bytes() == server.content
    assert server.ranges == [None, f"bytes={there}-"]


def test_other_content_is_refused_and_removed(server: Server) -> None:
    pin = pin_of(server.content)
    server.content = server.content[:-1] + bytes([server.content[-1] ^ 1])
    for _ in range(2):  # what was wrong is not gone on with
        with pytest.raises(UsageError, match=f"its SHA-256 is {sha256(server.content).hexdigest()}, not {pin.sha256}"):
            pinned_file(server.address, pin, None, lambda *_: None)
    assert server.ranges == [None, None]
    assert not [path for path in (server.cache / "logs").rglob("*") if path.is_file()]


def test_longer_and_shorter_content_is_refused(server: Server) -> None:
    pin = pin_of(server.content)
    whole = server.content
    server.content = whole + bytes(3_000_000)
    with pytest.raises(UsageError, match="its SHA-256 is"):
        pinned_file(server.address, pin, None, lambda *_: None)
    server.content = whole[:-5]
    with pytest.raises(UsageError, match=f"it ended after {len(whole) - 5} of {len(whole)} bytes"):
        pinned_file(server.address, pin, None, lambda *_: None)


def test_progress_is_that_of_the_whole_file(server: Server) -> None:
    calls: list[tuple[str, int, int | None]] = []
    pinned_file(server.address, pin_of(server.content), None, lambda *call: calls.append(call))
    assert calls[0] == ("fetching good.mcap, kB", 0, len(server.content) // 1000)
    assert all(0 <= done <= len(server.content) // 1000 for _, done, _ in calls)


def manifest(server: Server, *, sha256_of: bytes | None = None, more: str = "") -> Path:
    pin = pin_of(sha256_of or server.content)
    path = Path("set.yaml")
    path.write_text(
        f"""
baseline: set.json
gates: baseline
logs:
  - name: fine
    log: {server.address}
    sha256: {pin.sha256}
    size_bytes: {pin.size_bytes}
    licence: CC0
    peers: {{other: {{map.accepted_share: 0.5}}}}
  - name: lost
    log: {server.address.replace("good", "gone")}
    sha256: {pin.sha256}
    size_bytes: {pin.size_bytes}
{more}"""
    )
    return path


def test_results_stand_beside_the_baseline_and_the_peers(server: Server) -> None:
    source = str(manifest(server))
    first, _ = batch(sources=(source,), directory=Path("runs/set"), update_baseline=True)
    assert [row["exit_code"] for row in first["cells"]] == [0, ExitCode.USAGE]
    assert "gone.mcap: there is no such file; check the address" in first["cells"][1]["error"]
    again, ran = batch(sources=(source,), directory=Path("runs/set"), only=("fine",))
    assert ran == []
    assert again["exit_code"] == 0
    assert again["baseline"]["missing"] == []
    (row,) = again["cells"]
    assert (row["name"], row["log"], row["baseline"]["change"]) == (f"fine robust {NAME}", "fine", "same")
    page = Page(Path("runs/set/batch.html").read_text())
    accepted = f"{100 * row['run']['map']['accepted_share']:.1f}"
    assert f"baseline {accepted}" in page.rows[1]
    assert "other 50.0" in page.rows[1]
    assert "licence CC0" in page.rows[1]


def test_names_and_digests_that_cannot_be_meant_are_refused(server: Server) -> None:
    with pytest.raises(UsageError, match="--only x: no log of the manifest has this name; known are fine, lost"):
        request_of(BatchOptions(sources=(str(manifest(server)),), only=("x",)))
    with pytest.raises(UsageError, match="--only x: no log of the manifest has this name; known are none"):
        request_of(BatchOptions(sources=("a.bag",), only=("x",)))
    for entry, said in {
        "{name: a, log: [a.bag, b.bag]}": "it should be a single log to have a name or sha256, the",
        f"{{log: a.bag, sha256: {'a' * 64}, size_bytes: 3}}": "the latter one at an address",
        f"{{log: 'http://x/a.bag', sha256: {'a' * 64}}}": "it should have both sha256 and size_bytes, or neither",
        "{log: 'http://x/a.bag', sha256: abc, size_bytes: 3}": r"sha256 is 'abc', it should fit \^\[0-9a-f\]\{64\}\$; ",
        "{log: []}": r"logs.0.log is \[\], it should name a log; ",
        "{log: [a.bag, '']}": "it should name a log; ",
        "''": "it should name each log; ",
    }.items():
        Path("odd.yaml").write_text(f"logs:\n  - {entry}\n")
        with pytest.raises(ConfigError, match=said):
            read_manifest(Path("odd.yaml"))


def test_the_set_of_the_package_has_what_it_promises() -> None:
    request = request_of(BatchOptions(sources=("benchmark",)))
    assert request.directory == Path("runs/batch-benchmark")
    assert len(request.entries) >= 15
    assert all(entry.pin and entry.licence and entry.log[0].startswith("https://") for entry in request.entries)
    baseline = read_baseline(SETS / "benchmark.json")
    assert {name.partition(" ")[0] for name in baseline.runs} == {entry.name for entry in request.entries}
    assert all(run["exit_code"] in {0, 3, 5} for run in baseline.runs.values())
    assert sum(bool(entry.peers) for entry in request.entries) >= 4
    assert not [path for path in SETS.iterdir() if path.suffix not in {".yaml", ".json"}]


def test_a_folder_or_file_of_that_name_is_not_the_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("benchmark").mkdir()
    assert request_of(BatchOptions(sources=("benchmark",))).entries[0].log == ("benchmark",)
