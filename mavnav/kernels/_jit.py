"""The decorators of all kernels, and the disk cache of their machine code."""

from __future__ import annotations

import re
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

import numba
from numba.core.runtime import rtsys

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")

_IMPORT = re.compile(rb"^from ([\w.]+) import ", re.MULTILINE)


def kernel(signature: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:  # noqa: ANN401
    """Compile what Python calls, for one explicit signature, once a machine: cached on disk.

    Division is C-like, and the GIL is released.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        compiled = numba.njit(error_model="numpy", nogil=True, no_cfunc_wrapper=True)(function)
        if not numba.config.DISABLE_JIT:
            _enable_cache(compiled)
            if not _on_disk(compiled, signature):
                compiled.compile(signature)
            compiled.disable_compile()
        return cast("Callable[P, R]", compiled)

    return decorate


def helper(function: Callable[P, R]) -> Callable[P, R]:
    """Compile what only kernels call, when the first of them is compiled.

    Its machine code is part of theirs; alone it is neither kept on disk nor callable from Python.
    """
    compiled = numba.njit(error_model="numpy", nogil=True, no_cfunc_wrapper=True, no_cpython_wrapper=True)(function)
    return cast("Callable[P, R]", compiled)


def _enable_cache(compiled: Any) -> None:  # noqa: ANN401
    """Keep a kernel's machine code on disk until a file that it depends on changes.

    Without it kernels compile at every start: numba's own cache would miss an edit of an imported file. This is the
    case where a numba has moved these parts of its inside.
    """
    try:
        compiled._cache = _kernel_cache()(compiled.py_func)  # noqa: SLF001
    except (AttributeError, ImportError, KeyError, OSError, TypeError):
        return


@cache
def _kernel_cache() -> Any:  # noqa: ANN401
    """Return numba's disk cache, but for the stamp by which it tells that an entry is out of date."""
    from numba.core.caching import CompileResultCacheImpl, FunctionCache  # noqa: PLC0415

    class StampedImpl(CompileResultCacheImpl):  # type: ignore[misc]
        def __init__(self, function: Callable[..., Any]) -> None:
            super().__init__(function)
            stamp = source_stamp(function.__module__)
            self.locator.get_source_stamp = lambda: stamp

    class StampedCache(FunctionCache):  # type: ignore[misc]
        _impl_class = StampedImpl

    return StampedCache


def source_stamp(module: str) -> bytes:
    """Hash a module's source, and those of the modules of its package and of this one that it imports, at any depth.

    Imports count in the form ``from package.module import name`` at the start of a line; the modules are loaded.
    """
    packages = {name.partition(".")[0].encode() for name in (module, __name__)}
    digests: dict[str, bytes] = {}
    left = [module]
    while left:
        name = left.pop()
        if name not in digests:
            digests[name], imported = _source(name)
            left += [other.decode() for other in imported if other.split(b".")[0] in packages]
    return sha256(b"".join(name.encode() + digests[name] for name in sorted(digests))).digest()


@cache
def _source(module: str) -> tuple[bytes, list[bytes]]:
    """Return the hash of a loaded module's source, and the names of the modules that it imports from."""
    source = Path(cast("str", sys.modules[module].__file__)).read_bytes()
    return sha256(source).digest(), _IMPORT.findall(source)


def _on_disk(compiled: Any, signature: Any) -> bool:  # noqa: ANN401
    """Load a kernel's machine code from the disk; tell whether it was there.

    This is what ``compile`` would do, without the compiler's knowledge of all of Python and NumPy, which it loads
    first, in 0.3 s. A numba that has moved these parts compiles, and loads, as it always did.
    """
    try:
        context, disk = compiled.targetctx, compiled._cache  # noqa: SLF001
        rtsys.initialize(context)
        found = disk._load_overload(signature, context)  # noqa: SLF001
    except AttributeError:
        return False
    if found is None:
        return False
    context.insert_user_function(found.entry_point, found.fndesc, [found.library])
    compiled.add_overload(found)
    return True
