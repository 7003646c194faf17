"""Cases of tests that repeat a cheaper one, and run with the slow tests only: by ``make test SELECT=``, as in CI."""

from __future__ import annotations

from typing import Any

import pytest


def slow(*values: object) -> Any:
    """Return a case of ``pytest.mark.parametrize`` that the default run leaves out."""
    return pytest.param(*values, marks=pytest.mark.slow)
