"""``mavnav docs [PAGE]``: the documentation that ships with the program, on the terminal or in the browser.

Examples
--------
mavnav docs
mavnav docs problems
mavnav docs cli#exit-codes
mavnav docs report --open
"""

from __future__ import annotations

import os
import re
import sys
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavnav.commands import COMMANDS, shared
from mavnav.commands.terminal import console, emit, note
from mavnav.errors import UsageError, missing

if TYPE_CHECKING:
    from markdown_it.token import Token


def docs(
    page: Annotated[str, typer.Argument(metavar="PAGE", show_default=False)] = "index",
    *,
    in_browser: Annotated[bool, shared.output_option("--open")] = False,
) -> None:
    """Show a page of the documentation.

    Parameters
    ----------
    page
        Page, PAGE#SECTION, or a command (default the first page).
    in_browser
        Show the page in the browser.
    """
    from mavnav.config.loading import package_folder

    if not (package_folder("docs") / f"{page}.md").is_file():
        page = COMMANDS.get(page, page)
    name, _, anchor = page.partition("#")
    path = package_folder("docs") / f"{name.removesuffix('.md')}.md"
    if not path.is_file():
        raise UsageError(missing(path, "'mavnav docs' names the pages").replace(f"{path.parent}{os.sep}", ""))
    text = _section(path.read_text(encoding="utf-8"), anchor)
    if not text:
        raise UsageError(f"{path.name} has no section {anchor!r}; see 'mavnav docs {name}'")
    if in_browser:
        _open_page(path, anchor)
    elif sys.stdout.isatty():
        from rich.markdown import Markdown

        console().print(Markdown(text, hyperlinks=False), soft_wrap=False)
    else:
        for line in text.splitlines():
            emit(line)


def _slug(heading: str) -> str:
    """Return the name of a section in links."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def _section(text: str, anchor: str) -> str:
    """Return a page from a heading to the next one of its level; the page without an anchor, '' if it has none."""
    if not anchor:
        return text
    headings = [(h.start(), len(h[1]), _slug(h[2])) for h in re.finditer(r"^(#+) (.*)$", text, re.MULTILINE)]
    for k, (start, level, slug) in enumerate(headings):
        if slug == anchor:
            return text[start : next((at for at, depth, _ in headings[k + 1 :] if depth <= level), None)]
    return ""


def _open_page(path: Path, anchor: str) -> None:
    """Write all pages as HTML to a temporary folder, and open one of them."""
    import webbrowser
    from tempfile import mkdtemp

    folder = Path(mkdtemp(prefix="mavnav-docs-"))
    for each in path.parent.rglob("*.md"):
        target = folder / each.relative_to(path.parent).with_suffix(".html")
        target.parent.mkdir(exist_ok=True)
        target.write_text(_html(each), encoding="utf-8")
    address = (folder / f"{path.stem}.html").as_uri() + (f"#{anchor}" if anchor else "")
    emit(address)
    if not webbrowser.open(address):
        note("mavnav: warning: no browser could be started; open this address in one")


def _html(path: Path) -> str:
    """Return a page as HTML, with links to the others, in the style of reports."""
    from importlib.resources import files

    from markdown_it import MarkdownIt

    style = (files("mavnav.outputs.report") / "templates" / "report.css").read_text(encoding="utf-8")
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = parser.parse(path.read_text(encoding="utf-8"))
    for token, text in pairwise(tokens):
        if token.type == "heading_open":
            token.attrSet("id", _slug(re.sub(r"\[([^]]*)\]\([^)]*\)|[`*]", r"\1", text.content)))
    for token in tokens:
        _redirect(token.children or [], path.parent)
    body = parser.renderer.render(tokens, parser.options, {})
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{path.stem}</title>'
    return f'<!doctype html><html lang="en"><head>{head}<style>{style}</style></head><body>{body}</body></html>'


def _redirect(tokens: list[Token], folder: Path) -> None:
    """Lead links to pages to those in HTML, and pictures and other files to where they are."""
    for token in tokens:
        for name in ("href", "src"):
            target = str(token.attrGet(name) or "")
            file, mark, anchor = target.partition("#")
            if target and file.endswith(".md"):
                token.attrSet(name, f"{file.removesuffix('.md')}.html{mark}{anchor}")
            elif file and "://" not in file:
                token.attrSet(name, (folder / file).resolve().as_uri())
