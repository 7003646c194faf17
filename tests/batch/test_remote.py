"""Logs by address: the same run as by path; what cannot be opened fails alone."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from small_batch import batch

from mavnav.batch.remote import fetched
from mavnav.errors import ExitCode, UsageError

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
    assert json.loads((far / "run.json").read_text())["input"]["path"] == address.replace("///", "/")
    assert len(ran) == 1
    assert batch(sources=(address,), directory=Path("runs/far"))[1] == []


def test_memory_is_an_address_too() -> None:
    with fsspec.open("memory://a/b.mcap", "wb") as file:
        file.write(b"\x00" * 3_000_000)
    with fetched("memory://a/b.mcap") as folder:
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
    with pytest.raises(UsageError, match=said), fetched(address):
        pass


def test_without_fsspec(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(UsageError, match=r"install mavnav\[cluster\]"), fetched("memory://a"):
        pass
