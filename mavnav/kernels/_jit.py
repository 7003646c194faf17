"""The one decorator of all kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")


def kernel(signature: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:  # noqa: ANN401
    """Compile for one explicit signature, once a machine: cached on disk, C-like division, free of the GIL."""
    return numba.njit(signature, cache=True, error_model="numpy", nogil=True)  # type: ignore[no-any-return]
