"""Kernels come from the disk without the compiler."""

from __future__ import annotations

import os
import subprocess
import sys

import mavnav.kernels.hits
import mavnav.kernels.points  # noqa: F401  compiled by now


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
