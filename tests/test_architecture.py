"""The rules of docs/architecture.md, executed: who imports whom, who may print, what --help may import."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from mavnav.cli import COMMANDS, EPILOG
from mavnav.errors import ExitCode

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "mavnav"
FILES = sorted(PACKAGE.rglob("*.py"))

SHARED = {"atomic_files", "errors", "pose", "profiling", "scan", "units", "version"}
"""Modules that import nothing of ours but errors, and that every package but the kernels may import."""

ALLOWED: dict[str, set[str]] = {
    "kernels": {"version"},
    "config": SHARED,
    "mapping": SHARED | {"kernels"},
    "logs": SHARED,
    "slam": SHARED | {"config", "kernels", "mapping"},
    "sessions": SHARED | {"config", "kernels", "mapping", "slam"},
    "simulation": SHARED | {"mapping", "simulation.planner", "simulation.world", "slam"},
    "simulation.planner": SHARED | {"config", "kernels", "mapping"},
    "simulation.world": SHARED | {"config"},
    "metrics": SHARED | {"kernels", "mapping"},
    "outputs": SHARED | {"config", "kernels", "logs", "mapping", "metrics", "sessions", "slam"},
    "ground_truth": SHARED | {"config", "mapping", "metrics", "simulation.world"},
    "pipelines": SHARED
    | {"config", "ground_truth", "kernels", "logs", "mapping", "metrics", "outputs"}
    | {"sessions", "simulation", "simulation.world", "slam"},
    "jobs": SHARED | {"config", "ground_truth", "outputs", "pipelines"},
    "batch": SHARED
    | {"config", "ground_truth", "jobs", "kernels", "logs", "mapping", "metrics", "outputs", "pipelines", "slam"},
    "comparison": SHARED
    | {"batch", "config", "ground_truth", "jobs", "logs", "metrics", "outputs", "pipelines", "simulation"}
    | {"simulation.world"},
    "commands": SHARED
    | {"batch", "comparison", "config", "ground_truth", "jobs", "kernels", "logs", "metrics", "outputs", "pipelines"}
    | {"simulation.world"},
    "api": SHARED
    | {
        "batch",
        "comparison",
        "config",
        "ground_truth",
        "jobs",
        "logs",
        "mapping",
        "metrics",
        "outputs",
        "pipelines",
        "simulation.world",
        "slam",
    },
    "cli": {"commands", "errors", "version"},
    "__main__": {"cli", "errors"},
} | {module: {"errors"} if module == "atomic_files" else set() for module in SHARED}
"""Package -> packages that it may import besides itself."""

SPEAKING = {"__main__", "cli", "commands"}
"""Packages that may print and exit."""

MOST_LINES = 360
MOST_ENTRIES = {"": 27, "kernels": 9, "outputs": 8, "slam": 14}
"""How many files and folders a package may have, without those of Python."""


def name_of(path: Path) -> str:
    """Return the dotted name of a module within mavnav, "" for mavnav itself."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in FILES}


def package(module: str) -> str:
    """Return the row of the table that a module belongs to: the longest that its name begins with."""
    parts = module.split(".")
    rows = (".".join(parts[:length]) for length in range(len(parts), 0, -1))
    return next((row for row in rows if row in ALLOWED), module)


@cache
def names_in(path: Path) -> tuple[frozenset[str], frozenset[str]]:
    """Return the full dotted names that a file imports, anywhere in it, for typing only, too; and what it calls."""
    names: set[str] = set()
    calls: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call):
            calls.add(dotted(node.func))
    return frozenset(names), frozenset(calls)


def dotted(node: ast.expr) -> str:
    return f"{dotted(node.value)}.{node.attr}" if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def imports(path: Path) -> frozenset[str]:
    return names_in(path)[0]


def calls(path: Path) -> frozenset[str]:
    return names_in(path)[1]


def imported(module: str) -> set[str]:
    """Return the modules of ours that a module imports."""
    ours = [name.split(".")[1:] for name in imports(MODULES[module]) if name.split(".")[0] == "mavnav"]
    found = {name if (name := ".".join(parts)) in MODULES else ".".join(parts[:-1]) for parts in ours}
    return found - {module}


def test_imports_follow_the_table() -> None:
    pairs = {(module, other) for module in MODULES if module for other in imported(module) if other}
    wrong = [
        f"{module} imports {other}"
        for module, other in sorted(pairs)
        if package(other) not in {package(module), *ALLOWED.get(package(module), set())}
    ]
    assert wrong == []
    assert {package(module) for module in MODULES if module} == set(ALLOWED)


def test_the_table_allows_nothing_that_is_not_used() -> None:
    used = {(package(module), package(other)) for module in MODULES for other in imported(module)}
    unused = [
        (row, other)
        for row, others in ALLOWED.items()
        for other in others - SHARED - {"kernels"}
        if (row, other) not in used
    ]
    assert sorted(unused) == []


def test_the_table_of_the_document_is_this_one() -> None:
    text = (ROOT / "docs/architecture.md").read_text()
    rows = re.findall(r"^\| `([a-z_.]+)` \|([^|]*)\|", text, re.MULTILINE)
    documented = {name: set(re.findall(r"`([a-z_.]+)`", cells)) for name, cells in rows if name in ALLOWED}
    assert documented == {row: others - SHARED for row, others in ALLOWED.items() if row not in {*SHARED, "__main__"}}


def test_no_modules_import_each_other() -> None:
    left = {module: imported(module) for module in MODULES if module}  # mavnav itself only passes on names of the api
    while free := [module for module, others in left.items() if not others & set(left)]:
        for module in free:
            del left[module]
    assert sorted(left) == []  # each imports another of them, round in a circle


def beneath(package: str) -> dict[str, set[str]]:
    """Return the folders and files of a package, each with those of them that it imports."""
    depth = package.count(".") + 1
    inside = [module for module in MODULES if module.startswith(f"{package}.")]
    entries: dict[str, set[str]] = {module.split(".")[depth]: set() for module in inside}
    for module in inside:
        entry = module.split(".")[depth]
        others = {other.split(".")[depth] for other in imported(module) if other in inside}
        entries[entry] |= others - {entry}
    return entries


PARENTS = sorted(
    {name.rpartition(".")[0] for name, path in MODULES.items() if path.name == "__init__.py"} - {"", "logs"}
)
"""Packages with folders, but logs, whose folders hold what its files need, and import their records."""


@pytest.mark.parametrize("package", PARENTS)
def test_folders_import_each_other_in_one_direction(package: str) -> None:
    left = beneath(package)
    while free := [entry for entry, others in left.items() if not others & set(left)]:
        for entry in free:
            del left[entry]
    assert left == {}


def test_sizes() -> None:
    entries = {name: len({path.name for path in (PACKAGE / name).iterdir()} - {"__pycache__"}) for name in MOST_ENTRIES}
    lines = {module: len(path.read_text().splitlines()) for module, path in MODULES.items()}
    long = [module for module, count in lines.items() if count > MOST_LINES]
    assert [name for name, most in MOST_ENTRIES.items() if entries[name] > most] == []
    assert long == []


def test_only_kernels_import_numba() -> None:
    wrong = [
        module
        for module, path in MODULES.items()
        if package(module) != "kernels" and {name.split(".")[0] for name in imports(path)} & {"numba", "llvmlite"}
    ]
    assert wrong == []


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


def test_kernels_call_no_kernel() -> None:
    """The cache keeps only what runs a kernel, not what would be linked into another: that would crash."""
    every = kernels()
    for path in KERNEL_FILES:
        file = ".".join(path.relative_to(PACKAGE / "kernels").with_suffix("").parts)
        imported = {name.removeprefix("mavnav.kernels.") for name in imports(path)}
        assert not imported & every
        assert not {f"{file}.{name}" for name in calls(path)} & every


def test_pictures_need_no_plotting_library() -> None:
    assert [m for m, path in MODULES.items() if any(name.startswith("matplotlib") for name in imports(path))] == [
        "api.results"  # for whoever has it
    ]


def test_constants_of_maps_load_no_numba() -> None:
    code = "import sys, mavnav.kernels.maps.layout\nassert not {'numba', 'numpy'} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_examining_a_log_loads_nothing_that_maps_it() -> None:
    code = "import sys, mavnav.pipelines.info\nprint(*{'.'.join(name.split('.')[:2]) for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    heavy = {"numba", "llvmlite", "rosbags", "PIL"} | {f"mavnav.{name}" for name in ("kernels", "outputs", "slam")}
    assert not heavy & set(done.stdout.split())


def test_only_the_command_line_prints_and_exits() -> None:
    ways = {"print", "exit", "quit", "sys.exit", "os._exit", "sys.stdout.write", "sys.stderr.write"}
    wrong = []
    for module, path in MODULES.items():
        used = calls(path) & ways | {name.split(".")[0] for name in imports(path)} & {"rich", "typer"}
        wrong += [(module, sorted(used))] if used and package(module) not in SPEAKING else []
    assert wrong == []


HELPS = ["--help", *(f"{name} --help" for name in COMMANDS)]
PRINT_HELPS = (
    "import sys\nfrom mavnav.cli import run\n"
    "for words in sys.argv[1:]:\n"
    "    assert run(words.split()) == 0\n"
    "    print('\\f', *(m.partition('.')[0] for m in sys.modules), '\\f')\n"
)


@pytest.fixture(scope="module")
def helped() -> dict[str, tuple[str, set[str]]]:
    """Return what each of the helps prints, and the modules that were loaded by then; of one process."""
    done = subprocess.run([sys.executable, "-c", PRINT_HELPS, *HELPS], capture_output=True, text=True, check=True)
    texts, modules = done.stdout.split("\f")[:-1:2], done.stdout.split("\f")[1::2]
    return {words: (text, set(loaded.split())) for words, text, loaded in zip(HELPS, texts, modules, strict=True)}


@pytest.mark.parametrize("words", HELPS)
def test_help_imports_no_heavy_library(words: str, helped: dict[str, tuple[str, set[str]]]) -> None:
    text, loaded = helped[words]
    heavy = {
        "numpy",
        "numba",
        "scipy",
        "PIL",
        "jinja2",
        "yaml",
        "rosbags",
        "mcap",
        "msgspec",
        "google",
        "zstandard",
        "lz4",
        "pydantic",
    }
    assert not heavy & loaded
    assert f"Usage: mavnav {words.removesuffix('--help')}".strip() in text


def test_every_exit_code_is_documented_and_exists() -> None:
    helped = dict(re.findall(r"(\d+) ([^;]+)[;.]", EPILOG.partition("Exit codes[/bold]")[2]))
    assert set(map(int, helped)) == set(ExitCode)
    for document in ("README.md", "docs/cli.md"):
        text = (ROOT / document).read_text().partition("## Exit codes")[2].partition("\n## ")[0]
        codes = dict(re.findall(r"^\| (\d+) \| (.*) \|", text, re.MULTILINE))
        assert set(map(int, codes)) == set(ExitCode)
        assert helped["1"] in codes["1"].replace("`", "")


TWINS = {
    "maps.linemap.rebuild": "insert_points",
    "planning.potential.wall_centres": "occupied",
    "scans.points.place_points": "placed",
    "scans.sweep_shift.sweep_shift": "naive_sweep_shift",
    "walls.smoothing.smooth_image": "smoothed",
    "line_search.search.search": "coarse_to_fine",
    "polar_search.search.search": "coarse_to_fine",
    "walls.thickness.column_runs": "naive_sections",
    "walls.thickness.run_moments": "naive_sections",
}
"""Kernels whose slow twin in the tests bears another name."""


@cache
def kernels() -> set[str]:
    """Return ``file.function`` of what carries the kernel decorator: what Python calls."""
    return {
        ".".join((*path.relative_to(PACKAGE / "kernels").with_suffix("").parts, node.name))
        for path in KERNEL_FILES
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef) and "kernel" in map(ast.unparse, node.decorator_list)
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
