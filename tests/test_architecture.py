"""The picture of docs/architecture.md, executed: arrows between rooms, who may print, what --help may import."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mavnav.cli import COMMANDS
from mavnav.errors import ExitCode

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "mavnav"
FILES = sorted(PACKAGE.rglob("*.py"))

GROUND = {"errors", "units", "pose", "scan", "config", "memory", "staging", "stages"}
CORE = {"lattice", "grid", "linemap", "matcher", "relocalise", "motion", "belief", "firing", "methods", "slam"} | {
    "steps",
    "pose_graph",
    "degeneracy",
    "known_map",
    "localise",
    "loop_closure",
    "redrawing",
    "second_opinion",
    "steadying",
}
RUNS = {"", "cells", "config_file", "figures", "gates", "jobs", "logs", "markdown", "outputs", "references", "replay"}
ALLOWED: dict[str, set[str]] = {
    "": set(),
    "errors": set(),
    "units": set(),
    "pose": set(),
    "scan": set(),
    "memory": set(),
    "staging": set(),
    "stages": set(),
    "config": {"errors", "units"},
    "gates": {"errors"},
    "figures": {"errors", "gates"},
    "jobs": {"errors"},
    "layers": {"errors"},
    "config_file": {"errors", "config", "layers"},
    "kernels": set(),
    "logs": GROUND | {""},
    "world": GROUND | {"config_file", "layers", "planner_config"},
    "lattice": GROUND | {"kernels"},
    "grid": GROUND | {"kernels", "lattice"},
    "linemap": GROUND | {"lattice", "kernels"},
    "matcher": GROUND | {"kernels", "linemap"},
    "motion": GROUND,
    "pose_graph": GROUND,
    "relocalise": GROUND | {"kernels", "lattice", "grid", "linemap", "matcher"},
    "belief": GROUND | {"motion"},
    "firing": GROUND | {"matcher"},
    "methods": GROUND | {"kernels", "grid", "linemap", "matcher", "relocalise", "motion", "belief"},
    "steps": GROUND | {"matcher"},
    "degeneracy": GROUND | {"steps"},
    "known_map": GROUND | {"grid"},
    "localise": GROUND | {"grid", "linemap", "matcher", "relocalise", "motion", "methods", "known_map"},
    "loop_closure": GROUND | {"grid", "linemap", "matcher", "relocalise", "pose_graph"},
    "steadying": GROUND | {"kernels", "steps"},
    "second_opinion": GROUND | {"methods", "steps"},
    "redrawing": GROUND | {"motion", "methods", "steps", "loop_closure"},
    "slam": GROUND
    | {"grid", "matcher", "relocalise", "motion", "belief", "firing", "methods", "steps", "loop_closure", "redrawing"}
    | {"degeneracy", "known_map", "localise", "second_opinion", "steadying"},
    "metrics": GROUND | {"kernels", "lattice", "grid"},
    "references": GROUND | {"grid", "layers", "metrics", "world"},
    "planner_config": GROUND,
    "routes": GROUND | {"kernels", "planner_config"},
    "techniques": GROUND | {"kernels", "planner_config", "routes"},
    "planner": GROUND | {"kernels", "grid", "planner_config", "techniques"},
    "flight": GROUND | {"planner", "world"} | CORE,
    "outputs": GROUND | {"", "figures", "logs", "metrics"} | CORE,
    "evaluate": GROUND | {"", "grid", "logs", "metrics", "outputs", "references"},
    "replay": GROUND | {"logs", "metrics", "outputs", "references"} | CORE,
    "simulate": GROUND | {"flight", "logs", "metrics", "outputs", "references", "replay", "world"} | CORE,
    "markdown": set(),
    "cells": GROUND | {"", "jobs", "logs", "outputs", "references", "replay"},
    "cluster": {"", "cells", "errors", "jobs"},
    "batch": GROUND | RUNS | {"cluster", "layers"},
    "compare": GROUND | RUNS | {"flight", "simulate", "world"},
    "commands": GROUND
    | RUNS
    | {"batch", "cluster", "compare", "evaluate", "kernels", "metrics", "simulate", "world"}
    | CORE,
    "cli": {"", "commands", "errors"},
}
"""Room -> rooms that it may import; "" is the package itself (its version)."""

ABOVE_THE_ROOMS = {"commands", "cli"}


def room(path: Path) -> str:
    first = path.relative_to(PACKAGE).parts[0]
    return {"__init__.py": "", "__main__.py": "cli"}.get(first) if first.startswith("__") else first.removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Return the full dotted names that a file imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def rooms_imported(path: Path) -> set[str]:
    ours = [name.split(".")[1:] for name in imports(path) if name.split(".")[0] == "mavnav"]
    known = {room(file) for file in FILES}
    return {parts[0] if parts and parts[0] in known else "" for parts in ours}


def test_every_room_has_a_line_in_the_table() -> None:
    assert {room(path) for path in FILES} <= set(ALLOWED)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_arrows(path: Path) -> None:
    here = room(path)
    assert rooms_imported(path) - {here} <= ALLOWED[here]


def test_the_table_has_no_cycle() -> None:
    left, order = dict(ALLOWED), []
    while free := [name for name, needs in left.items() if not needs & set(left) - {name}]:
        order += free
        for name in free:
            del left[name]
    assert left == {}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_kernels_import_numba(path: Path) -> None:
    if room(path) != "kernels":
        assert not {name for name in imports(path) if name.split(".")[0] in {"numba", "llvmlite"}}


KERNEL_FILES = sorted(PACKAGE.glob("kernels/**/*.py"))


@pytest.mark.parametrize("path", KERNEL_FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_the_cache_sees_what_a_kernel_imports(path: Path) -> None:
    """The stamp of the disk cache follows imports of this form alone: anything else would miss an edit."""
    text = path.read_text()
    for node in ast.parse(text).body:
        if isinstance(node, ast.Import):
            assert not any(alias.name.startswith("mavnav") for alias in node.names)
    seen = {module for module in re.findall(r"^from ([\w.]+) import ", text, re.MULTILINE) if "mavnav" in module}
    typing = {"mavnav." + name for name in re.findall(r"^ +from mavnav\.([\w.]+) import ", text, re.MULTILINE)}
    assert all((ROOT / Path(*module.split("."))).with_suffix(".py").is_file() for module in seen | typing)
    assert {name.rpartition(".")[0] for name in imports(path) if name.startswith("mavnav")} <= seen | typing


def test_constants_of_maps_load_no_numba() -> None:
    code = "import sys, mavnav.kernels.layout\nassert not {'numba', 'numpy'} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_rooms_neither_print_nor_exit(path: Path) -> None:
    if room(path) in ABOVE_THE_ROOMS:
        return
    called = {ast.unparse(node.func) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)}
    assert not called & {"print", "exit", "quit", "sys.exit", "os._exit", "sys.stdout.write", "sys.stderr.write"}
    assert not {name for name in imports(path) if name.split(".")[0] in {"rich", "typer"}}


@pytest.mark.parametrize(
    "args",
    [["--help"], *([name, "--help"] for name in COMMANDS)],
    ids=" ".join,
)
def test_help_imports_no_heavy_library(args: list[str]) -> None:
    code = (
        "import sys\nfrom mavnav.cli import run\nassert run(sys.argv[1:]) == 0\n"
        "print(*(m.partition('.')[0] for m in sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code, *args], capture_output=True, text=True, check=True)
    heavy = {"numpy", "numba", "scipy", "matplotlib", "jinja2", "yaml", "rosbags", "mcap", "google", "zstandard", "lz4"}
    if args == ["--help"]:  # for a command with parameters typer imports pydantic itself
        heavy |= {"pydantic"}
    assert not heavy & set(done.stderr.split())
    assert "Usage" in done.stdout


def test_every_exit_code_is_documented_and_exists() -> None:
    for document in ("README.md", "docs/cli.md"):
        text = (ROOT / document).read_text().partition("## Exit codes")[2].partition("\n## ")[0]
        assert {int(code) for code in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)} == {
            int(code) for code in ExitCode
        }


def documented_commands() -> list[str]:
    """Return the subcommands that README and docs/cli.md show in code, by their words before any option."""
    text = (ROOT / "README.md").read_text() + (ROOT / "docs/cli.md").read_text()
    calls = re.findall(r"(?:^ {4}|`)(?:\$ )?mavnav ([a-z]+(?: (?:show|schema))?)", text, re.MULTILINE)
    return sorted(set(calls))


def test_documented_commands_answer_help() -> None:
    found = documented_commands()
    assert {"replay", "compare", "simulate", "info", "config show"} <= set(found)
    for command in found:
        subprocess.run(
            [sys.executable, "-m", "mavnav", *command.split(), "--help"], check=True, capture_output=True, timeout=30
        )


def documented_options() -> set[str]:
    text = (ROOT / "README.md").read_text() + (ROOT / "docs/cli.md").read_text()
    return set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text))


def test_documented_options_exist() -> None:
    helps = "".join(
        subprocess.run(
            [sys.executable, "-m", "mavnav", *command, "--help"],
            check=True,
            capture_output=True,
            text=True,
            env={"COLUMNS": "200", "PATH": ""},
        ).stdout
        for command in ([], *([name] for name in COMMANDS), ["config", "show"])
    )
    assert {option for option in documented_options() if option not in helps} == set()


TWINS = {
    "linemap.rebuild": "insert_points",
    "line_search.search.search": "coarse_to_fine",
    "polar_search.search.search": "coarse_to_fine",
    "thickness.column_runs": "naive_sections",
    "thickness.run_moments": "naive_sections",
}
"""Kernels whose slow twin in the tests bears another name."""


def kernels() -> set[str]:
    """Return ``file.function`` of what carries the kernel decorator: what Python calls."""
    return {
        ".".join((*path.relative_to(PACKAGE / "kernels").with_suffix("").parts, node.name))
        for path in KERNEL_FILES
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef) and any("kernel(" in ast.unparse(d) for d in node.decorator_list)
    }


def test_every_kernel_has_a_twin() -> None:
    helpers = [path for path in (ROOT / "tests").rglob("*.py") if not path.name.startswith("test_")]
    twins = {
        node.name
        for path in helpers
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
    }
    assert len(kernels()) > 5
    assert {kernel for kernel in kernels() if TWINS.get(kernel, kernel.rpartition(".")[2]) not in twins} == set()
    assert set(TWINS) <= kernels()
