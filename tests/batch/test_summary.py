"""What people see in CI: the summary, and GitHub's annotations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mavnav.batch.ci import MAX_ROWS, github_commands, to_summary
from mavnav.cli import run


def table(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_summary_is_a_headline_what_went_wrong_and_a_table(document: dict[str, Any]) -> None:
    text = to_summary(document)
    assert text.startswith("## ❌ mavnav batch\n\n1 of 4 runs passed, 2 could not be made.\n\n- **gone.bag")
    head, rule, *rows = table(text)
    assert {len(row) for row in (head, rule, *rows)} == {7}
    assert [row[0] for row in rows] == ["❌", "❌", "❌", "✅"]
    assert rows[-1][1].startswith("logs/good.mcap robust")
    assert rows[-1][2:4] == ["good", "100.0"]
    assert rows[0][2:] == ["-"] * 5


def test_runs_of_an_earlier_call_are_called_reused(document: dict[str, Any]) -> None:
    document["counts"]["cached"] = 2
    assert "2 could not be made, 2 reused.\n" in to_summary(document)


def test_names_are_no_markdown(document: dict[str, Any]) -> None:
    document["cells"][3].update(name="a|b <img> *c*\nd", error="x|y")
    rows = to_summary(document).splitlines()
    assert not [line for line in rows if "<img>" in line or "*c*" in line or line == "d"]


def test_a_long_batch_shows_the_worst(document: dict[str, Any]) -> None:
    good, bad = document["cells"][2], document["cells"][3]
    document["cells"] = [{**good, "name": f"good {k}"} for k in range(MAX_ROWS)] + [bad]
    text = to_summary(document)
    assert len(table(text)) == MAX_ROWS + 2
    assert table(text)[2][0] == "❌"
    assert "\n\n|  | run |" in text  # or the table belongs to the list before it
    assert text.endswith("\n1 more are in batch.html and batch.csv.\n")


def test_annotations_are_one_line_each(document: dict[str, Any]) -> None:
    document["cells"][3].update(log="a,b:c.bag", error="100% bad\n::error::forged")
    document["baseline"] = {"missing": ["old.bag"]}
    lines = github_commands(document)
    assert len(lines) == 4
    assert lines[0].startswith("::error file=a%2Cb%3Ac.bag,title=")
    assert lines[0].endswith("::100%25 bad%0A::error::forged")
    assert lines[-1] == "::warning title=mavnav::old.bag: in the baseline, not in this batch"
    assert not [line for line in lines if "\n" in line]
    document["baseline"]["gate"] = True
    assert github_commands(document)[-1] == "::error title=mavnav::old.bag: in the baseline, not in this batch"


def test_in_github_the_summary_and_the_annotations_are_there_by_themselves(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(home / "step.md"))
    Path("step.md").write_text("before\n")
    assert run(["batch", "gone.bag", "-o", "runs/gone", "-q"]) == 2
    assert Path("step.md").read_text().startswith("before\n## ❌ mavnav batch")
    assert "::error file=gone.bag,title=gone.bag robust 20/10x10::gone.bag: no such file" in capsys.readouterr().err
