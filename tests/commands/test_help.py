"""What help shows, and what a shell completes."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from mavnav.cli import COMMANDS
from mavnav.config.models import Config

ROOT = Path(__file__).parents[2]


@pytest.fixture
def page(mavnav: Callable, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Return the help of a command, each option on one line."""
    monkeypatch.setenv("COLUMNS", "300")
    return lambda *words: mavnav(*words, "--help")[1]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_names_its_page_and_no_types(page: Callable[..., str], command: str) -> None:
    text = page(command)
    assert not re.findall(r"<\w+(?:\[\w+\])?>", text)
    file, _, anchor = COMMANDS[command].partition("#")
    assert text.rstrip().endswith(f"Documentation  mavnav docs {COMMANDS[command].replace('.md', '')}")
    headings = re.findall(r"^#+ (.*)$", (ROOT / "docs" / file).read_text(), re.MULTILINE)
    assert anchor in {"", *(heading.lower().replace(" ", "-") for heading in headings)}


def test_pages_of_help_without_a_command_of_their_own(page: Callable[..., str]) -> None:
    assert page().rstrip().endswith("Documentation  mavnav docs index")
    assert page("config", "show").rstrip().endswith("mavnav docs cli#configuration")


def test_help_says_why_it_has_no_descriptions_without_docstrings(spawn: Callable) -> None:
    for level, said in (("2", True), ("1", False)):
        out, _ = spawn("docs", "--help", PYTHONOPTIMIZE=level).communicate(timeout=60)
        assert ("Show the page in the browser" not in out) == ("Without descriptions" in out) == said


def test_help_shows_the_defaults_of_the_configuration(page: Callable[..., str]) -> None:
    lines = dict(re.findall(r"^│ --([a-z-]+) (.*)$", page("replay"), re.MULTILINE))
    config = Config()
    assert config.robust.deskew == "auto"
    for option in ("method", "grid", "search", "odom", "deskew", "loop-closure"):
        default = "auto" if option == "deskew" else getattr(config, option.replace("-", "_"))
        assert f"default {default}" in lines[option], option


def test_help_offers_nothing_that_the_command_refuses(page: Callable[..., str]) -> None:
    calibrate, metrics, replay = page("calibrate"), page("metrics"), page("replay")
    assert "merge" not in calibrate
    assert "auto|TOPIC " in calibrate
    assert "robust only" not in calibrate
    assert "FILE.tum " in metrics
    assert "topic:" not in metrics
    assert all(words in replay for words in ("merge", "auto|TOPIC|off", "FILE.tum|auto|topic:NAME"))


def completed(mavnav: Callable, monkeypatch: pytest.MonkeyPatch, shell: str, line: str) -> list[str]:
    """Return what a shell offers for the last word of a line."""
    words = line.split(" ")
    monkeypatch.setenv("_MAVNAV_COMPLETE", f"complete_{shell}")
    monkeypatch.setenv("COMP_WORDS", "\n".join(words))
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    monkeypatch.setenv("_TYPER_COMPLETE_ARGS", line)
    code, out, _ = mavnav()
    assert code == 0
    return out.split() if shell == "bash" else re.findall(r'"([^"]+)"', out)


@pytest.mark.parametrize("shell", ["bash", "zsh"])
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("replay --method ", ["robust", "paper"]),
        ("replay --method p", ["paper"]),
        ("batch --config pa", ["paper", "paper-literal"]),
        ("simulate cor", ["corner", "corner-paper", "corridor"]),
        ("replay {log} --topic ", ["/scan"]),
        ("compare nothing.mcap {log} --topic /s", ["/scan"]),
        ("replay nothing.mcap --topic ", []),
        ("replay {log} --odom ", ["auto", "off", "/odom"]),
        ("calibrate {log} --odom ", ["auto", "/odom"]),
    ],
)
def test_values_are_completed(
    mavnav: Callable, monkeypatch: pytest.MonkeyPatch, shell: str, line: str, offered: list[str]
) -> None:
    log = ROOT / "sample_logs" / "complex.bag"
    assert completed(mavnav, monkeypatch, shell, "mavnav " + line.format(log=log)) == offered


def test_a_summary_ends_with_the_run_and_the_next_step(mavnav: Callable, tmp_path: Path) -> None:
    run = tmp_path / "my run"
    common = ("replay", ROOT / "sample_logs" / "complex.bag", "--end", "0.5", "--online", "-q", "-o", run)
    rows = mavnav(*common, "--outputs", "trajectory,map,mcap")[1].splitlines()
    assert [row.split(None, 1)[0] for row in rows[-2:]] == ["open", "next"]
    assert rows[-2].endswith(f"  {run}")
    assert rows[-1].endswith(f"  mavnav metrics '{run}'")
    rows = mavnav(*common, "--force", "--outputs", "trajectory")[1].splitlines()
    assert rows[-1].endswith(f"  mavnav check '{run}'")
    assert mavnav("check", run, "--gate", "tracking.lost==false")[0] == 0
