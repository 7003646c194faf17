"""Runs that are repeated: the same bytes, or which differ."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavnav.batch.document import file_differences
from mavnav.batch.options import BatchOptions, request_of
from mavnav.errors import ExitCode, UsageError
from support.html_page import Page
from support.small_batch import NAME, batch


def test_a_run_that_is_repeated_has_the_same_bytes(home: Path) -> None:
    more = {"sources": ("logs/good.mcap",), "repeat": 2, "gates": ("identical",)}
    document, ran = batch(**more)
    name = f"logs/good.mcap robust {NAME}"
    assert ran == [f"{name} #2"]  # the first is reused
    first, second = document["cells"]
    assert first["repeat"] is None
    assert second["repeat"] == {"of": name, "differs": []}
    assert [gate["gate"] for gate in second["gates"]][-1:] == ["identical"]
    assert document["exit_code"] == 0
    assert first["directory"] != second["directory"]
    assert f"the same bytes as {name}" in Page(Path("runs/batch/batch.html").read_text()).rows[2]


def test_bytes_that_differ_fail_the_gate_and_are_named(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = "map.pgm: 1 of 9 bytes differ, from byte 4 to 4"
    monkeypatch.setattr("mavnav.batch.document.file_differences", lambda *_: [said])
    document, _ = batch(sources=("logs/good.mcap",), repeat=2, gates=("identical",))
    assert [row["code"] for row in document["cells"]] == [0, ExitCode.GATE_FAILED]
    assert document["exit_code"] == ExitCode.GATE_FAILED
    assert said in Page(Path("runs/batch/batch.html").read_text()).rows[1]
    document, _ = batch(sources=("logs/good.mcap",), repeat=2)
    assert document["exit_code"] == 0
    assert said in Page(Path("runs/batch/batch.html").read_text()).rows[2]


def test_the_bytes_that_differ(tmp_path: Path) -> None:
    contents = {"a": (b"same", b"same"), "b": (b"0123456", b"0x23y56"), "c": (b"01", b"0123"), "d": (b"x", None)}
    for side, name in enumerate(("one", "other")):
        folder = tmp_path / name
        folder.mkdir()
        files = {key: content for key, both in contents.items() if (content := both[side]) is not None}
        for key, content in files.items():
            (folder / key).write_bytes(content)
        outputs = ", ".join(f'"{key}": "-"' for key in files)
        (folder / "run.json").write_text(f'{{"outputs": {{{outputs}}}}}')
    assert file_differences(tmp_path / "one", tmp_path / "other") == [
        "b: 2 of 7 bytes differ, from byte 1 to 4",
        "c: the same up to byte 2, sizes 2 and 4",
        "d: only in one",
    ]


def test_a_log_that_cannot_be_read_is_not_repeated(home: Path) -> None:
    document, _ = batch(sources=("gone.bag",), directory=Path("new"), repeat=3)
    assert len(document["cells"]) == 1


def test_the_gate_needs_repetitions() -> None:
    with pytest.raises(UsageError, match="add --repeat 2"):
        request_of(BatchOptions(sources=("logs",), gates=("identical",)))
