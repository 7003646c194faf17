"""The recipes of docs/ci.md: they parse, and what they call works."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from mavnav.batch.options import BatchOptions, request_of
from mavnav.cli import run

NIGHTLY = """
logs:
  - {log: logs/good.mcap, end_s: 0.5}
  - {log: logs/cut.mcap, end_s: 0.5, accept: 3}
runs:
  - {name: quick, grid: 5x5, azimuth: 6, final_pass: false}
baseline: baseline.json
output: runs/batch
"""


@pytest.fixture(scope="module")
def recipes(repo_root: Path) -> list[tuple[str, str]]:
    """Return the fenced blocks of the page: the language and the text."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", (repo_root / "docs/ci.md").read_text(), re.MULTILINE | re.DOTALL)


def block(recipes: list[tuple[str, str]], language: str, words: str) -> str:
    return next(text for kind, text in recipes if kind == language and words in text)


@pytest.fixture
def recorder(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put commands in the way that write down how they are called; a small manifest and its baseline are there."""
    folder = home / "bin"
    folder.mkdir()
    for name in ("mavnav", "sbatch"):
        (folder / name).write_text(f'#!/bin/sh\nprintf "%s\\n" "$*" >> {home}/{name}.calls\necho 4711\n')
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    for name in ("GITHUB_ACTIONS", "GITHUB_STEP_SUMMARY", "MAKEFLAGS", "MAKELEVEL"):
        monkeypatch.delenv(name, raising=False)
    Path("nightly.yaml").write_text(NIGHTLY)
    assert run(["batch", "nightly.yaml", "--update-baseline", "-q"]) == 0
    return home


def calls(home: Path, name: str) -> list[str]:
    return (home / f"{name}.calls").read_text().splitlines()


def test_the_manifest_is_one(recipes: list[tuple[str, str]], tmp_path: Path) -> None:
    path = tmp_path / "nightly.yaml"
    path.write_text(block(recipes, "yaml", "# nightly.yaml"))
    (tmp_path / "baseline.json").write_text('{"mavnav_version": "1", "cells": []}')
    request = request_of(BatchOptions(sources=(str(path),)))
    assert [setting.name for setting in request.settings] == ["usual", "fine", "coarse", "paper"]
    assert [setting.config.method for setting in request.settings] == ["robust", "robust", "robust", "paper"]
    assert request.rules.baseline_gate
    assert len(request.rules.gates) == 2


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("# .github/", lambda recipe: [step.get("run", "") for step in recipe["jobs"]["maps"]["steps"]]),
        ("# .gitlab-ci", lambda recipe: recipe["maps"]["script"]),
    ],
    ids=["github", "gitlab"],
)
def test_workflows_write_what_they_publish(words: str, found, recorder: Path, recipes: list[tuple[str, str]]) -> None:
    recipe = yaml.safe_load(block(recipes, "yaml", words))
    lines = [line for line in found(recipe) if line.startswith("mavnav ")]
    assert [run(shlex.split(line)[1:]) for line in lines] == [0, 0]
    assert ElementTree.parse("batch.xml").getroot().tag == "testsuites"
    assert Path("batch.md").exists() == ("batch.md" in str(recipe))


def test_make(recorder: Path, recipes: list[tuple[str, str]]) -> None:
    Path("Makefile").write_text(block(recipes, "make", ".PHONY"))
    subprocess.run(["make", "maps", "baseline"], check=True, capture_output=True)
    assert [run([*line.split(), "-q"]) for line in calls(recorder, "mavnav")] == [0, 0]


def test_slurm(recorder: Path, recipes: list[tuple[str, str]]) -> None:
    task, submit = (block(recipes, "bash", words) for words in ("#SBATCH", "--wrap"))
    for number in (1, 2):
        slurm = {"SLURM_ARRAY_TASK_ID": str(number), "SLURM_ARRAY_TASK_COUNT": "2", "SLURM_CPUS_PER_TASK": "1"}
        subprocess.run(["bash", "-eu", "-c", task], check=True, capture_output=True, env={**os.environ, **slurm})
    subprocess.run(["bash", "-eu", "-c", submit], check=True)
    assert [run([*line.split(), "-q"]) for line in calls(recorder, "mavnav")] == [0, 0]
    first, last = calls(recorder, "sbatch")
    assert first == "--parsable maps.sbatch"
    options, _, command = last.partition(" --wrap mavnav ")
    assert options == "--dependency=afterany:4711"
    assert run([*shlex.split(command), "-q"]) == 0


def test_every_command_of_the_page_has_its_options(
    repo_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (repo_root / "docs/ci.md").read_text()
    monkeypatch.setenv("COLUMNS", "200")
    for command in ("batch", "check"):
        options = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", "\n".join(re.findall(rf"mavnav {command} .*", text))))
        assert run([command, "--help"]) == 0
        shown = capsys.readouterr().out
        assert options
        assert {option for option in options if option not in shown} == set()
