"""``mavnav docs``: every page by name, sections, and pages in the browser that lead to one another."""

from __future__ import annotations

import re
import webbrowser
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def test_a_page_is_printed_by_its_name_or_file(mavnav):
    text = (DOCS / "problems.md").read_text().rstrip()
    for name in ("problems", "problems.md"):
        code, out, _ = mavnav("docs", name)
        assert (code, out.rstrip()) == (0, text)


def test_a_section_ends_where_the_next_one_begins(mavnav):
    code, out, _ = mavnav("docs", "cli#exit-codes")
    assert code == 0 and out.startswith("## Exit codes\n") and "tracking was lost for good" in out
    assert len(re.findall("^## ", out, re.MULTILINE)) == 1


@pytest.mark.parametrize(
    ("page", "advice"),
    [
        ("problem", "error: problem.md: no such file; did you mean problems.md?"),
        ("xyz", "error: xyz.md: no such file; 'mavnav docs' names the pages"),
        ("notes/xyz", "error: xyz.md: no such file; 'mavnav docs' names the pages"),
        ("cli#nothing", "error: cli.md has no section 'nothing'; see 'mavnav docs cli'"),
    ],
)
def test_what_there_is_not_is_answered_by_what_there_is(mavnav, page, advice):
    code, _, err = mavnav("docs", page)
    assert code == 2 and advice in err
    advised = re.search("'mavnav docs ?([a-z]*)'", err)
    code, out, _ = mavnav("docs", *(advised[1].split() if advised else ()))
    assert code == 0 and out.startswith("# ") and "(problems.md" in out + "(problems.md" * (page[:3] == "cli")


def test_a_command_without_a_page_of_its_own_has_its_section(mavnav):
    for command, start in (("plan", "## Floor plan\n"), ("compare", "# "), ("batch", "# ")):
        code, out, _ = mavnav("docs", command)
        assert code == 0 and out.startswith(start)


def test_the_page_that_ends_the_help_of_a_command_is_there(mavnav):
    for command in ("replay", "plan", "docs"):
        code, out, _ = mavnav(command, "--help")
        page = re.search(r"Documentation +mavnav docs (\S+)", out)
        assert code == 0 and page and mavnav("docs", page[1])[0] == 0


def test_pages_in_the_browser_lead_to_one_another(mavnav, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    code, out, _ = mavnav("docs", "cli#verdict", "--open")
    assert (code, opened) == (0, [out.strip()]) and out.strip().endswith("/cli.html#verdict")
    folder = Path(unquote(urlparse(opened[0]).path)).parent
    pages = {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*.html")}
    assert len(pages) == len(list(DOCS.rglob("*.md")))
    generated = {"commands.html", "run_json.html"}  # of the site alone
    for name, text in pages.items():
        for target in re.findall(r'(?:href|src)="([^"#]+)', text):
            if target.startswith("file:"):
                assert Path(unquote(urlparse(target).path)).exists(), (name, target)
            elif "://" not in target and target not in generated:
                assert (folder / name).parent.joinpath(target).resolve().is_file(), (name, target)
    assert 'id="exit-codes"' in pages["cli.html"]
