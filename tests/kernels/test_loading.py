"""Kernels come from the disk without the compiler, and are compiled again when what they are made of has changed."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import mavnav.kernels.hits
import mavnav.kernels.points  # noqa: F401  compiled by now

if TYPE_CHECKING:
    from pathlib import Path


def test_machine_code_is_loaded_without_the_compiler() -> None:
    code = (
        "import sys, numba\nbefore = set(sys.modules)\nfrom mavnav.kernels.hits import add_scan\n"
        "assert len(add_scan.overloads) == 1\n"
        "print(*(set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "numba.np.polynomial.polynomial_core" not in done.stdout.split()


def test_a_numba_that_keeps_its_code_in_another_way_loads_it_as_it_does() -> None:
    code = (
        "from unittest.mock import patch\nimport mavnav.kernels._jit as jit, numpy as np\n"
        "with patch.object(jit, 'rtsys', None):\n"
        "    from mavnav.kernels.points import extent\n"
        "assert sum(extent.stats.cache_hits.values()) == 1\n"
        "assert extent(np.ones((3, 2))) == (1.0, 1.0, 1.0, 1.0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_kernels_are_plain_functions_where_nothing_is_compiled() -> None:
    code = (
        "import numpy as np\nfrom mavnav.kernels.points import extent\n"
        "assert extent(np.ones((3, 2))) == (1.0, 1.0, 1.0, 1.0)\nassert not hasattr(extent, 'overloads')"
    )
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


JIT = "from mavnav.kernels._jit import helper, kernel\n"
SOURCES = {
    "constants": "FACTOR = 2.0\n",
    "helping": JIT + "from trial.constants import FACTOR\n\n@helper\ndef scaled(x):\n    return FACTOR * x\n",
    "calling": JIT
    + "from trial.helping import scaled\n\n@kernel('float64(float64)')\ndef f(x):\n    return scaled(x)\n",
    "apart": JIT + "\n@kernel('float64(float64)')\ndef g(x):\n    return x + 1.0\n",
}
CALL = (
    "from trial.apart import g\nfrom trial.calling import f\n"
    "print(f(21.0), g(1.0), sum(f.stats.cache_misses.values()), sum(g.stats.cache_misses.values()))"
)


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    """Return the folder of a package of two kernels, of which one calls a helper of another file."""
    folder = tmp_path / "trial"
    folder.mkdir()
    for name, source in SOURCES.items():
        (folder / f"{name}.py").write_text(source)
    return folder


def called(trial: Path, before: str = "") -> list[float]:
    """Run both kernels in a process of its own; returns their results, and how often each was compiled."""
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", before + CALL]
    done = subprocess.run(command, cwd=trial.parent, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return [float(word) for word in done.stdout.split()]


@pytest.mark.parametrize(
    ("edited", "old", "new"), [("helping", "FACTOR * x", "100.0 * FACTOR * x"), ("constants", "2.0", "200.0")]
)
def test_a_kernel_is_compiled_again_where_a_file_that_it_imports_was_edited(
    trial: Path, edited: str, old: str, new: str
) -> None:
    assert called(trial) == [42.0, 2.0, 1, 1]
    assert called(trial) == [42.0, 2.0, 0, 0]
    path = trial / f"{edited}.py"
    path.write_text(path.read_text().replace(old, new))
    assert called(trial) == [4200.0, 2.0, 1, 0]
    assert called(trial) == [4200.0, 2.0, 0, 0]


CACHING = "import numba.core.ccallback\nfrom numba.core import caching\n"


@pytest.mark.parametrize(
    "moved",
    [CACHING + "del caching.CompileResultCacheImpl\n", CACHING + "del caching.CacheImpl.locator\n"],
    ids=["import", "attribute"],
)
def test_a_numba_without_these_parts_compiles_at_every_start(trial: Path, moved: str) -> None:
    assert called(trial)[:2] == [42.0, 2.0]
    path = trial / "helping.py"
    path.write_text(path.read_text().replace("FACTOR * x", "FACTOR * x + 1.0"))
    for _ in range(2):
        assert called(trial, moved)[:2] == [43.0, 2.0]
    assert not list(trial.glob("**/*.tmp*"))
