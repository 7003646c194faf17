"""The one decorator of all kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")


def kernel(signature: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:  # noqa: ANN401
    """Compile for one explicit signature, once a machine: cached on disk, C-like division, free of the GIL.

    What is private to its file (``_name``) is part of the machine code of the kernels that call it, and is not loaded
    from the disk by itself: a third of the time that kernels take to load.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        signatures = () if function.__name__.startswith("_") else (signature,)
        compiled: Callable[P, R] = numba.njit(*signatures, cache=True, error_model="numpy", nogil=True)(function)
        return compiled

    return decorate
