"""What the pages of the site show: commands that run, settings that exist, pages that are there."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest
import yaml

from mavnav.cli import run
from mavnav.config.loading import fields

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
TUTORIAL = [
    shlex.split(line)[1:] for line in re.findall(r"^    (mavnav .*)$", (DOCS / "tutorial.md").read_text(), re.MULTILINE)
]


def test_the_commands_of_the_tutorial_run_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(ROOT / "sample_logs" / "complex.bag", tmp_path / "drive.bag")
    monkeypatch.chdir(tmp_path)
    assert len(TUTORIAL) == 5
    for words in TUTORIAL:
        assert run(words) == 0, capsys.readouterr().err
        capsys.readouterr()
    for file in ("map.png", "wall_thickness.png", "map.yaml", "trajectory.tum", "result.mcap"):
        assert (tmp_path / "runs/drive" / file).is_file()
    assert (tmp_path / "runs/grids/report.html").is_file()


def test_settings_on_the_pages_exist() -> None:
    known = {".".join(key) for key, _ in fields()}
    for page in ("settings.md", "problems.md"):
        named = set(re.findall(r"\b(?:robust|paper)\.[a-z_]+", (DOCS / page).read_text()))
        assert named <= known


def pages(nav: object) -> set[str]:
    if isinstance(nav, str):
        return {nav}
    return set().union(*(pages(each) for each in (nav.values() if isinstance(nav, dict) else nav)))  # type: ignore[attr-defined]


def test_every_page_is_in_the_navigation() -> None:
    nav = yaml.load((ROOT / "mkdocs.yml").read_text(), Loader=yaml.BaseLoader)["nav"]
    assert pages(nav) == {path.name for path in DOCS.glob("*.md")}
