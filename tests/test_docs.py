"""What the pages of the site show: commands that run, settings that exist, pages that are there."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer
import yaml
from typer.main import get_command

from mavnav.batch.manifest import read_manifest
from mavnav.batch.request import swept
from mavnav.cli import app_for, run
from mavnav.comparison.document import RELATIVE_COSTS
from mavnav.config.loading import fields, load_config
from mavnav.metrics.gates import check_names, judge, parse_gate, renaming
from mavnav.outputs.documents.schema import number_names, run_keys
from mavnav.pipelines.diff import NUMBERS as DIFF_NUMBERS
from mavnav.simulation.world.scenario_file import load_scenario

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.rglob("*.md"), ROOT / "sample_logs/README.md", ROOT / "README.md", ROOT / "CONTRIBUTING.md"])
SEARCH = ("method", "grid", "azimuth", "search", "odom", "loop_closure")
"""Options of a replay that are keys of its configuration."""
TUTORIAL = [
    shlex.split(line)[1:] for line in re.findall(r"^    (mavnav .*)$", (DOCS / "tutorial.md").read_text(), re.MULTILINE)
]

GATE_WORDS = {"baseline", "identical"}
"""Gates of a batch that are no bounds."""


@pytest.mark.slow
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
    _, example = blocks("howto.md", "python")
    exec(compile(example, "howto.md", "exec"), {})
    assert capsys.readouterr().out


def test_a_run_is_put_into_a_recording_of_rerun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun", reason="no rerun: pip install rerun-sdk")
    monkeypatch.chdir(tmp_path)
    assert run(["replay", str(ROOT / "sample_logs/complex.bag"), "--end", "2", "-o", "runs/drive", "-q"]) == 0
    example, _ = blocks("howto.md", "python")
    exec(compile(example, "howto.md", "exec"), names := {})
    assert len(names["run"].trajectory) == len(list(names["log"])) > 10  # a pose for each scan
    recording = (tmp_path / "drive.rrd").read_bytes()
    assert all(name in recording for name in (b"/map", b"/seen", b"/track"))


def blocks(page: str, language: str) -> list[str]:
    """Return the fenced blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", (DOCS / page).read_text(), re.MULTILINE | re.DOTALL)


def shown_commands(page: Path) -> list[list[str]]:
    """Return the calls of mavnav that a page shows in code blocks, a list of words each, shell variables as 1."""
    text = re.sub(r"\$\{?\w+\}?", "1", page.read_text())
    code = [*re.findall(r"^```.*?^```", text, re.MULTILINE | re.DOTALL), *re.findall(r"^ {4}.*$", text, re.MULTILINE)]
    lines = re.findall(r"^\s*(?:\$ |- |- run: )?(mavnav [^|`\n]*)", "\n".join(code), re.MULTILINE)
    found = []
    for line in lines:
        lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, "&&"]:
            if set(word) <= set("&;<>()"):
                found += [words[1:]] if words[:1] == ["mavnav"] else []
                words = []
            else:
                words.append(word)
    return found


@cache
def program() -> Any:
    return get_command(app_for([]))


def parsed(words: list[str]) -> dict[str, Any]:
    """Return the values of a command line as the program reads them, and the name of the command."""
    command, context, names = program(), program().make_context("mavnav", list(words)), []
    while hasattr(command, "commands"):
        name, command, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        names.append(name)
        context = command.make_context(name, rest, parent=context)
    return {"command": " ".join(names), **context.params}


def check_values(given: dict[str, Any]) -> None:
    """Raise what the program would say of gates and settings, before it looks for any file."""
    gates = [gate for gate in given.get("gates") or () if gate not in GATE_WORDS]
    sections = {"mission", "truth", "localisation"}
    more = [key for key in run_keys() if key.partition(".")[0] in sections]
    costs = [f"price.{name}" for name in RELATIVE_COSTS]
    check_names(
        (parse_gate(gate).name for gate in gates), [*number_names(reference=True), *more, *costs, *DIFF_NUMBERS]
    )
    if given["command"] == "simulate":
        load_scenario("corner", given["sets"] or (), {"planner.technique": given["planner"], "seed": given["seed"]})
    else:
        sets = given.get("sets") or ()
        for chosen in swept(sets) if given["command"] in ("compare", "batch") else [sets]:
            load_config(None, chosen, {name: given.get(name) for name in SEARCH})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_on_a_page_is_one_that_the_program_takes(page: Path) -> None:
    for words in shown_commands(page):
        try:
            check_values(parsed(words))
        except typer.Exit:
            assert {"--help", "--version"} & set(words)


def test_commands_on_pages_are_found() -> None:
    found = {str(page.relative_to(ROOT)): shown_commands(page) for page in PAGES}
    assert sum(map(len, found.values())) > 80
    assert found["docs/fr079.md"][0] == ["info", "freiburg-079-corrected.log.gz"]
    assert ["batch", "nightly.yaml", "--part", "1/1", "-j", "1"] in found["docs/ci.md"]
    with pytest.raises(typer.TyperException):
        parsed(["replay", "drive.bag", "--cell", "3"])
    with pytest.raises(Exception, match="did you mean"):
        check_values(parsed(["replay", "drive.bag", "--set", "robust.cel_mm=3"]))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_tables_are_whole(page: Path) -> None:
    """A table has a rule below its head, stands alone, and has as many cells in each row; else it is shown as text."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for block in re.findall(r"(?:^.*\S.*\n?)+", text, re.MULTILINE):
        rows = [row for row in block.splitlines() if row.startswith("|")]
        cells = [len(re.sub(r"\\\||`[^`]*`", "", row).split("|")) for row in rows]
        if rows:
            assert re.fullmatch(r"[|: -]+", rows[1] if len(rows) > 1 else ""), rows[0]
            assert len(set(cells)) == 1, rows[0]
            assert rows == block.splitlines(), rows[0]


def test_commands_and_options_in_texts_exist() -> None:
    known = {"show", "schema", *program().commands}
    given = [param for command in commands() for param in command.params]
    options = {"--help", *(name for param in given for name in (*param.opts, *param.secondary_opts))}
    for page in PAGES:
        text = page.read_text()
        assert set(re.findall(r"`mavnav ([a-z]+)", text)) <= known, page
        if page in {ROOT / "README.md", DOCS / "cli.md"}:
            assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)) <= options, page


def commands() -> list[Any]:
    top = [program(), *program().commands.values()]
    return [*top, *program().commands["config"].commands.values()]


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_the_scenarios_of_their_page_run(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.yaml").write_text(blocks("scenarios.md", "yaml")[number])
    assert run(["simulate", "room.yaml", "-q", "-o", "room", "--outputs", "trajectory"]) == 0


def test_manifest_and_configuration_of_their_pages_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "nightly.yaml").write_text(blocks("ci.md", "yaml")[0])
    manifest, _ = read_manifest(tmp_path / "nightly.yaml")
    assert (len(manifest.logs), len(manifest.runs)) == (4, 4)
    (settings,) = blocks("settings.md", "yaml")
    (tmp_path / "my.yaml").write_text(settings)
    assert run(["config", "show", "my.yaml"]) == 0
    assert "grid: 20x20" in capsys.readouterr().out


@cache
def hooks() -> ModuleType:
    spec = spec_from_file_location("mkdocs_hooks", ROOT / "mkdocs_hooks.py")
    assert spec
    assert spec.loader
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_generated_pages_have_every_option_and_every_key() -> None:
    text = hooks().commands_page()
    for command in commands():
        for param in command.params:
            assert all(f"`{name}`" in text for name in param.opts if name.startswith("--"))
    assert "## mavnav config show" in text
    assert "More: [cli.md#replay](cli.md#replay)" in text
    assert {f"`{name}`" for name in run_keys()} <= set(
        re.findall(r"^\| (`.*?`) \|", hooks().run_json_page(), re.MULTILINE)
    )


def test_code_in_the_tables_of_the_site_has_no_backslash() -> None:
    page = hooks().on_page_markdown((DOCS / "cli.md").read_text())
    assert "| `mavnav metrics RUN|MAP.yaml ...` |" in page
    assert "\\|" not in page


def test_settings_on_the_pages_exist() -> None:
    known = {".".join(key) for key, _ in fields()}
    for page in ("settings.md", "problems.md"):
        named = set(re.findall(r"\b(?:robust|paper)\.[a-z_]+", (DOCS / page).read_text()))
        assert named <= known


def test_files_and_folders_on_the_page_of_the_architecture_exist() -> None:
    named = re.findall(r"`([a-z_]+/(?:[a-z_/]+(?:\.py)?)?)`", (DOCS / "architecture.md").read_text())
    assert len(named) > 40
    assert [name for name in named if not (ROOT / "mavnav" / name).exists() and not (ROOT / name).exists()] == []


def pages(nav: object) -> set[str]:
    if isinstance(nav, str):
        return {nav}
    return set().union(*(pages(each) for each in (nav.values() if isinstance(nav, dict) else nav)))  # type: ignore[attr-defined]


def test_every_page_is_in_the_navigation() -> None:
    nav = yaml.load((ROOT / "mkdocs.yml").read_text(), Loader=yaml.BaseLoader)["nav"]
    assert pages(nav) == {path.name for path in DOCS.glob("*.md")} | {"commands.md", "run_json.md"}


def test_the_search_of_the_site_needs_no_network() -> None:
    config = yaml.load((ROOT / "mkdocs.yml").read_text(), Loader=yaml.BaseLoader)
    (script,) = config["extra"]["polyfills"]
    assert "iframe-worker" in script  # the plugin offline adds an address unless one has this name
    text = (DOCS / script).read_text()
    assert "Copyright (c) 2020-2022 Martin Donath" in text
    assert "window.Worker=" in text


def shown_gates() -> set[str]:
    """Return every gate on a page: of a command or of a manifest."""
    commands = [words for page in PAGES for words in shown_commands(page)]
    given = {gate for words in commands for flag, gate in pairwise(words) if flag == "--gate"}
    manifests = [yaml.safe_load(block) for block in blocks("ci.md", "yaml")]
    sections = [block for block in manifests if isinstance(block, dict)]
    listed = [entry for block in sections for entry in (block, *(block.get("logs") or [])) if isinstance(entry, dict)]
    texts = [entry.get("gates") or [] for entry in listed]
    return given | {gate for text in texts for gate in ([text] if isinstance(text, str) else text)}


def test_every_gate_on_a_page_is_judged_on_a_run(tmp_path: Path) -> None:
    """Each finds its number in the documents that the page says it is for: a run, a comparison, or a diff."""
    log, truth = ROOT / "sample_logs/corridor.mcap", ROOT / "configs/corridor.yaml"
    assert run(["replay", str(log), "--end", "3", "-q", "--truth-map", str(truth), "-o", str(tmp_path / "r")]) == 0
    document = json.loads((tmp_path / "r" / "run.json").read_text())
    document["price"] = dict.fromkeys(RELATIVE_COSTS, 1.0)
    document |= dict.fromkeys(DIFF_NUMBERS, 0.0)
    document["reference"]["ate"] = {"rmse_m": 0.01}
    gates = [parse_gate(gate) for gate in shown_gates() - GATE_WORDS]
    assert len(gates) >= 12
    assert {"verdict", "verdict==good", "wall_thickness.p95_mm<=150"} <= {gate.text for gate in gates}
    for gate, row in zip(gates, judge(gates, document), strict=True):
        assert row["value"] is not None, gate.text
        assert not renaming(gate.name), gate.text
