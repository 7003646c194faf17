"""Logs by address: the same run as by path; what cannot be opened fails alone."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from mavnav.batch.remote import download
from mavnav.errors import ExitCode, UsageError
from support.small_batch import batch

fsspec = pytest.importorskip("fsspec", reason="the extra mavnav[cluster]")


def test_a_log_at_an_address_is_the_log(home: Path) -> None:
    address = f"file://{home}/logs/good.mcap"
    document, ran = batch(sources=(address, "file:///nowhere/x.mcap"), directory=Path("runs/far"))
    assert [row["log"] for row in document["cells"]] == [address, "file:///nowhere/x.mcap"]
    assert [row["exit_code"] for row in document["cells"]] == [0, ExitCode.USAGE]
    assert document["cells"][1]["error"] == "file:///nowhere/x.mcap: there is no such file; check the address"
    (far,) = Path("runs/far/cells").iterdir()
    near = Path("runs/batch/cells") / far.name  # the same key
    for name in ("trajectory.tum", "map.pgm", "hits.npz", "result.mcap"):
        assert (far / name).read_bytes() == (near / name).read_bytes()
    assert json.loads((far / "run.json").read_text())["input"]["path"] == address
    assert len(ran) == 1
    assert batch(sources=(address,), directory=Path("runs/far"))[1] == []


@pytest.fixture
def served(home: Path) -> Iterator[str]:
    """Serve the logs over HTTP on the loopback, and return the address of their folder."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *words: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=home / "logs")) as server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_log_on_a_web_server(served: str) -> None:
    pytest.importorskip("aiohttp", reason="the extra mavnav[cluster]")
    sources = tuple(f"{served}/{name}.mcap" for name in ("good", "empty", "gone"))
    document, _ = batch(sources=sources, directory=Path("runs/far"))
    assert [row["exit_code"] for row in document["cells"]] == [0, ExitCode.NO_SCANS, ExitCode.USAGE]
    assert [row["error"] and row["error"].partition(": ")[0] for row in document["cells"]] == [None, *sources[1:]]
    (far,) = Path("runs/far/cells").iterdir()
    run = json.loads((far / "run.json").read_text())
    assert run["input"]["path"] == sources[0]
    assert (far / "map.pgm").read_bytes() == (Path("runs/batch/cells") / far.name / "map.pgm").read_bytes()


def test_a_log_in_a_bucket(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs where s3fs and moto[server] are installed; development does not need them for anything else."""
    s3fs, moto = pytest.importorskip("s3fs"), pytest.importorskip("moto.server")
    server = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    try:
        for name, value in {"KEY_ID": "x", "SECRET_ACCESS_KEY": "x"}.items():
            monkeypatch.setenv(f"AWS_ACCESS_{name}" if name == "KEY_ID" else f"AWS_{name}", value)
        monkeypatch.setenv("AWS_ENDPOINT_URL", "http://{}:{}".format(*server.get_host_and_port()))
        bucket = s3fs.S3FileSystem()
        bucket.mkdir("drives")
        bucket.put("logs/good.mcap", "drives/day 1/good.mcap")
        sources = ("s3://drives/day 1/good.mcap", "s3://drives/gone.mcap", "s3://nobody/gone.mcap")
        document, _ = batch(sources=sources, directory=Path("runs/far"))
    finally:
        server.stop()
    assert [row["exit_code"] for row in document["cells"]] == [0, ExitCode.USAGE, ExitCode.USAGE]
    (far,) = Path("runs/far/cells").iterdir()
    assert json.loads((far / "run.json").read_text())["input"]["path"] == sources[0]
    assert (far / "map.pgm").read_bytes() == (Path("runs/batch/cells") / far.name / "map.pgm").read_bytes()


def test_secrets_of_an_address_are_written_nowhere(served: str, home: Path) -> None:
    pytest.importorskip("aiohttp", reason="the extra mavnav[cluster]")
    address = served.replace("http://", "http://alice:hunter2@")
    sources = (f"{address}/good.mcap?sig=SECRET", f"{address}/good.mcap?sig=SECRET2", f"{address}/gone.mcap?sig=SECRET")
    words = ("mavnav", "batch", *sources)
    document, _ = batch(sources=sources, words=words, directory=Path("runs/far"))
    shown = f"{served}/good.mcap"
    assert [row["log"] for row in document["cells"]] == [shown, f"{shown} (2)", f"{served}/gone.mcap"]
    assert document["cells"][2]["error"] == f"{served}/gone.mcap: there is no such file; check the address"
    (far,) = Path("runs/far/cells").iterdir()
    run = json.loads((far / "run.json").read_text())
    assert run["input"]["path"] == shown
    assert run["provenance"]["command"] == f"mavnav batch {shown} {shown} {served}/gone.mcap"
    assert run["provenance"]["again"].startswith(f"mavnav batch {shown} --end=0.5 ")
    assert run["provenance"]["folder"] == str(home)
    for path in Path("runs/far").rglob("*"):
        assert not any(secret in str(path) for secret in ("alice", "hunter2", "SECRET"))
        if path.is_file():
            assert not any(secret in path.read_bytes() for secret in (b"alice", b"hunter2", b"SECRET")), path


def test_memory_is_an_address_too() -> None:
    with fsspec.open("memory://a/b.mcap", "wb") as file:
        file.write(b"\x00" * 3_000_000)
    with download("memory://a/b.mcap") as folder:
        assert (folder / "memory:/a/b.mcap").stat().st_size == 3_000_000
    assert not folder.exists()


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("memory://a/none.mcap", "memory://a/none.mcap: there is no such file"),
        ("carrier-pigeon://a", "carrier-pigeon://a: cannot be read"),
        ("file:///a/../../b", "an address with '..'"),
    ],
)
def test_addresses_that_lead_nowhere(address: str, said: str) -> None:
    with pytest.raises(UsageError, match=said), download(address):
        pass


@pytest.mark.parametrize(
    ("module", "address", "advice"),
    [
        ("fsspec", "memory://a", "pip install 'mavnav[cluster]', or download the log"),
        ("aiohttp", "http://127.0.0.1:1/a.mcap", "pip install 'mavnav[cluster]', or download the log"),
        ("s3fs", "s3://a/b.mcap", "(Install s3fs to access S3); install it, or download the log"),
    ],
)
def test_what_is_not_installed_is_named(
    module: str, address: str, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError) as caught, download(address):
        pass
    assert str(caught.value).startswith(f"{address}: cannot be read (") and module in str(caught.value)
    assert advice in str(caught.value)
