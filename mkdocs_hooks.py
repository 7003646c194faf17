"""Pages of the site that are generated from the program and never committed: every option, every key of run.json."""

from __future__ import annotations

import inspect
import re
from itertools import groupby
from typing import TYPE_CHECKING, Any

from typer.main import get_command

from mavnav.cli import app_for
from mavnav.outputs.documents.schema import run_keys, run_schema

if TYPE_CHECKING:
    from collections.abc import Iterator

    import typer
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the generated pages to those of docs/."""
    from mkdocs.structure.files import File  # noqa: PLC0415  the tests make pages without mkdocs

    for name, text in (("commands.md", commands_page()), ("run_json.md", run_json_page())):
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Remove the backslash before bars in code: GitHub needs it in tables, Python-Markdown would show it."""
    return re.sub(r"`[^`\n]*`", lambda code: code[0].replace("\\|", "|"), markdown)


def commands_page() -> str:
    """Return the reference of all commands and options, as ``--help`` shows them."""
    group = get_command(app_for([]))
    context = group.make_context("mavnav", [], resilient_parsing=True)
    parts = [
        "# All commands and options\n\nGenerated from the program; `mavnav COMMAND --help` shows the same. "
        "[Command line](cli.md) explains what the options do."
    ]
    return "\n\n".join([*parts, *_command(group, context)]) + "\n"


def _command(command: Any, context: typer.Context) -> Iterator[str]:  # noqa: ANN401  typer's
    """Yield the parts of a command and of the commands below it."""
    yield f"## {context.command_path}"
    yield _plain(inspect.cleandoc(command.help or ""))
    yield f"    {' '.join([context.command_path, *command.collect_usage_pieces(context)])}"
    shown = [param for param in command.get_params(context) if not param.hidden]
    for panel, params in groupby(shown, lambda param: getattr(param, "rich_help_panel", None)):
        rows = [f"| {_names(param)} | {_cell(param.metavar or '')} | {_cell(_plain(param.help))} |" for param in params]
        yield "\n".join([f"| {panel or 'general'} | value | meaning |", "|---|---|---|", *rows])
    if examples := re.findall(r"^mavnav .*$", command.epilog or "", re.MULTILINE):
        yield "Examples:\n\n" + "\n".join(f"    {line}" for line in examples)
    if page := re.search(r"mavnav docs (\w+)(\S*)$", command.epilog or ""):
        yield f"More: [{page[1]}.md{page[2]}]({page[1]}.md{page[2]})"
    for name, below in getattr(command, "commands", {}).items():
        yield from _command(below, below.make_context(name, [], parent=context, resilient_parsing=True))


def _names(param: Any) -> str:  # noqa: ANN401
    if param.param_type_name == "argument":
        return f"`{param.metavar}`".replace("|", "\\|")
    return ", ".join(f"`{name}`" for name in param.opts)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def _plain(text: str | None) -> str:
    """Return a help text without the markup of terminals."""
    return re.sub(r"\[/?bold\]", "", text or "").replace("\\[", "[")


def run_json_page() -> str:
    """Return the reference of run.json, a table a section."""
    keys, needed = run_keys(), run_schema()["required"]
    parts = [
        "# run.json\n\nGenerated from the model that writes the file. `mavnav config schema run` prints the JSON "
        "Schema. `*` stands for any key, or any place of a list. Quality gates use the full names; "
        "[Metrics](metrics.md) defines what they mean."
    ]
    sections: dict[str, list[str]] = {"values": []}
    for name, node in keys.items():
        section = name.partition(".")[0]
        plain = not any(other.startswith(f"{section}.") for other in keys)
        sections.setdefault("values" if plain else section, []).append(_row(name, node))
    for section, rows in sections.items():
        parts.append(f"## {section}" + ("" if section in {"values", *needed} else "\n\nOnly in runs that have it."))
        parts.append("\n".join(["| key | type | unit | meaning |", "|---|---|---|---|", *rows]))
    return "\n\n".join(parts) + "\n"


def _row(name: str, node: dict[str, Any]) -> str:
    kinds = [option.get("type") or "" for option in node.get("anyOf", [node])]
    unit = node.get("unit", "")
    better = f" ({node['better']} is better)" if "better" in node else ""
    words = f"one of {', '.join(map(str, node['enum']))}" if "enum" in node else ""
    description = " ".join((node.get("description") or "").split()).replace("``", "`")
    meaning = ": ".join(filter(None, (description, words))) + better
    return f"| `{name}` | {' or '.join(filter(None, kinds))} | {'' if unit == '1' else unit} | {_cell(meaning)} |"
