"""The one decorator of all kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

import numba
from numba.core.runtime import rtsys

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
        compiled = numba.njit(cache=True, error_model="numpy", nogil=True)(function)
        if not (function.__name__.startswith("_") or numba.config.DISABLE_JIT):
            if not _on_disk(compiled, signature):
                compiled.compile(signature)
            compiled.disable_compile()
        return cast("Callable[P, R]", compiled)

    return decorate


def _on_disk(compiled: Any, signature: Any) -> bool:  # noqa: ANN401
    """Load a kernel's machine code from the disk; tell whether it was there.

    This is what ``compile`` would do, without the compiler's knowledge of all of Python and NumPy, which it loads
    first, in 0.3 s. A numba that has moved these parts compiles, and loads, as it always did.
    """
    try:
        context, cache = compiled.targetctx, compiled._cache  # noqa: SLF001
        rtsys.initialize(context)
        found = cache._load_overload(signature, context)  # noqa: SLF001
    except AttributeError:
        return False
    if found is None:
        return False
    context.insert_user_function(found.entry_point, found.fndesc, [found.library])
    compiled.add_overload(found)
    return True
