"""The decorators of all kernels, whose machine code is loaded from the disk, or compiled, at their first call."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from functools import cache, cached_property
from hashlib import sha256
from sys import version_info
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

import numba
from numba.core.runtime import rtsys

from mavnav.kernels._cache import read_code, source_stamp, write_code
from mavnav.kernels._compiler import whole_kernels

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(eq=False)
class Kernel:
    """A numba function with its one signature, and where its machine code is kept."""

    compiled: Any
    signature: Any

    @property
    def module(self) -> str:
        """The full name of the module that defines it."""
        return str(self.compiled.py_func.__module__)

    @cached_property
    def _entry(self) -> tuple[str, str]:
        """Key and name of its entry in the cache."""
        function = self.compiled.py_func
        return cache_key(), f"{self.module}.{function.__name__}-{source_stamp(self.module).hex()[:24]}"

    @cached_property
    def code(self) -> bytes | None:
        """What the disk has of it, None where that is nothing whole."""
        return read_code(*self._entry)

    def look_again(self) -> None:
        """Forget that the disk had nothing: another process may have compiled it since."""
        if self.code is None:
            del self.code

    def load(self) -> None:
        """Make it callable: from the disk, or else by compiling it, which keeps it there for the next time."""
        if not self.compiled.overloads:
            if not self._from_disk():
                self._compile()
            self.compiled.disable_compile()
            self.code = None

    def _from_disk(self) -> bool:
        """Load the code as numba's cache would, but without its compiler; tell whether that was possible.

        A numba that has moved these parts cannot, and compiles. Nor can one that finds other content than it wrote.
        """
        if self.code is None:
            return False
        context = self.compiled.targetctx
        try:
            _initialize(context)
            found = numba.core.compiler.CompileResult._rebuild(context, *pickle.loads(self.code))  # noqa: S301, SLF001
            context.insert_user_function(found.entry_point, found.fndesc, [found.library])
            self.compiled.add_overload(found)
            self.compiled._cache_hits[self.signature] += 1  # noqa: SLF001
        except Exception:  # whatever is wrong with the entry, it is made anew
            return bool(self.compiled.overloads)
        return True

    def _compile(self) -> None:
        with whole_kernels(self.compiled.targetctx):
            self.compiled.compile(self.signature)
        (result,) = self.compiled.overloads.values()
        try:
            write_code(*self._entry, _packed(result))
        except (AttributeError, ImportError, TypeError, ValueError):
            return  # a numba that has moved these parts: kernels compile at every start


KERNELS: list[Kernel] = []
"""All kernels of the modules that are loaded."""


def kernel(signature: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:  # noqa: ANN401
    """Make a kernel of a function that Python calls: compiled for one explicit signature, once a machine.

    Its machine code is loaded by the first call. Division is C-like, and the GIL is released.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        compiled = numba.njit(error_model="numpy", nogil=True, no_cfunc_wrapper=True)(function)
        if not numba.config.DISABLE_JIT:
            made = Kernel(compiled, signature)
            KERNELS.append(made)

            def first_call(*_: Any, **__: Any) -> Any:  # noqa: ANN401
                """Return what numba then calls with the same arguments."""
                made.load()
                return compiled

            compiled._compile_for_args = first_call  # noqa: SLF001
        return cast("Callable[P, R]", compiled)

    return decorate


def helper(function: Callable[P, R]) -> Callable[P, R]:
    """Compile what only kernels call, when the first of them is compiled.

    Its machine code is part of theirs; alone it is neither kept on disk nor callable from Python.
    """
    compiled = numba.njit(error_model="numpy", nogil=True, no_cfunc_wrapper=True, no_cpython_wrapper=True)(function)
    return cast("Callable[P, R]", compiled)


@cache
def cache_key() -> str:
    """Return what machine code depends on besides its source: numba, Python, the system and the processor.

    ``NUMBA_BOUNDSCHECK=1`` compiles with checked indices, which takes longer; that code is kept apart.
    """
    from numba.core.registry import cpu_target  # noqa: PLC0415

    processor = repr(cpu_target.target_context.codegen().magic_tuple())
    digest = sha256(processor.encode()).hexdigest()[:16]
    checked = "-bounds" if numba.config.BOUNDSCHECK else ""
    return f"numba-{numba.__version__}-py{version_info.major}{version_info.minor}-{digest}{checked}"


def _initialize(context: Any) -> None:  # noqa: ANN401
    """Load numba's runtime, but not its knowledge of all of Python and NumPy, which takes 0.3 s."""
    try:
        rtsys.initialize(context)
    except AttributeError:
        context.refresh()


def _packed(result: Any) -> bytes:  # noqa: ANN401
    """Return the machine code of a compiled function, without what only other functions that call it would need."""
    from llvmlite.binding import parse_assembly  # noqa: PLC0415
    from numba.core.serialize import dumps  # noqa: PLC0415

    (name, kind, (code, _)), *rest = result._reduce()  # noqa: SLF001
    names = f'define void @"{result.fndesc.llvm_cpython_wrapper_name}"() {{ ret void }}'
    return cast("bytes", dumps(((name, kind, (code, parse_assembly(names).as_bitcode())), *rest)))
