"""numba's compiler, without separate optimization and code generation of each helper of a kernel.

Only modules that compile kernels import this one, and numba with it.

numba makes machine code of each helper, and of each of its own functions that a kernel needs, although only the
kernel's is ever run; and at every depth of calls it optimizes all called code again. Here such parts are linked
unoptimized, and the kernel is optimized once with all code that it calls.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Final

import numba
import numpy as np

from mavnav.kernels.machine.loader import MachineCode, link

_OPTIONS: Final = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}


def load_typing_tables() -> None:
    """Load numba's tables of Python and NumPy functions."""
    from numba.core.registry import cpu_target  # noqa: PLC0415

    cpu_target.target_context.refresh()
    cpu_target.typing_context.refresh()


def as_helper(function: Callable[..., Any]) -> Any:  # noqa: ANN401
    """Return numba's form of a function that only kernels call."""
    return numba.njit(no_cpython_wrapper=True, **_OPTIONS)(function)


def compile_kernel(function: Callable[..., Any], signature: object) -> tuple[Callable[..., Any], MachineCode | None]:
    """Compile a kernel for a signature of numba.

    Returns the callable, and its code, None if this numba does not provide it.
    """
    made = numba.njit(**_OPTIONS)(function)
    with whole_kernels(made.targetctx):
        made.compile(signature)
    made.disable_compile()
    (result,) = made.overloads.values()
    try:
        return made, _machine_code(function, result)
    except (AttributeError, ImportError, TypeError, ValueError):
        return made, None  # a numba with other internals: kernels compile at every start


def load_by_numba(code: bytes, function: Callable[..., Any]) -> Callable[..., Any]:
    """Load the code of a kernel as numba's own cache does; may raise any exception if it is not valid."""
    made: Any = numba.njit(**_OPTIONS)(function)
    context = made.targetctx
    context.refresh()
    result = numba.core.compiler.CompileResult._rebuild(context, *pickle.loads(code))  # noqa: S301, SLF001
    context.insert_user_function(result.entry_point, result.fndesc, [result.library])
    made.add_overload(result)
    made.disable_compile()
    return made  # type: ignore[no-any-return]


def _machine_code(function: Callable[..., Any], result: Any) -> MachineCode:  # noqa: ANN401
    """Return the machine code of a compiled function: an object file if it can be linked, else all that numba needs."""
    try:
        entry = _object_file(result)
        link(entry, function.__module__, function.__qualname__)
    except Exception:  # another system, other internals of numba
        from numba.core.serialize import dumps  # noqa: PLC0415

        return MachineCode(dumps(result._reduce()))  # noqa: SLF001
    return entry


def _object_file(result: Any) -> MachineCode:  # noqa: ANN401
    """Return the object file of a compiled function.

    Raises LookupError if its environment holds anything but types of arrays, which only numba can restore.
    """
    (_, _, (code, _)), *_ = result._reduce()  # noqa: SLF001
    module, kept = result.library._final_module, result.environment.consts  # noqa: SLF001
    if not all(isinstance(one, np.dtype) and one.isbuiltin for one in kept):
        raise LookupError(kept)
    declared = (one.name for one in (*module.functions, *module.global_variables) if one.is_declaration)
    return MachineCode(
        code,
        result.fndesc.llvm_cpython_wrapper_name,
        result.target_context.get_env_name(result.fndesc),
        tuple(one.str for one in kept),
        tuple(name for name in declared if not name.startswith("llvm.")),
    )


@contextmanager
def whole_kernels(context: Any) -> Iterator[None]:  # noqa: ANN401
    """Link parts unoptimized within the block, and vectorize statements as well as loops, which saves 2 % of the time.

    A numba with other internals compiles as usual.

    ``context`` is the target context of a numba function.
    """
    codegen = context.codegen()
    try:
        before, codegen._library_class = codegen._library_class, _part_library()  # noqa: SLF001
    except (AttributeError, ImportError):
        yield
        return
    codegen.set_env = _set_env_of_loaded(codegen)
    vectorized = getattr(numba.config, "SLP_VECTORIZE", 0)
    numba.config.SLP_VECTORIZE = 1
    try:
        yield
    finally:
        codegen._library_class = before  # noqa: SLF001
        numba.config.SLP_VECTORIZE = vectorized
        del codegen.set_env


def _set_env_of_loaded(codegen: Any) -> Any:  # noqa: ANN401
    """Return a function that sets a function's environment, except for parts, which have none."""
    set_env, engine = codegen.set_env, codegen._engine  # noqa: SLF001

    def set_env_of_loaded(name: str, env: object) -> None:
        if engine.get_global_value_address(name):
            set_env(name, env)

    return set_env_of_loaded


@cache
def _part_library() -> Any:  # noqa: ANN401
    """Return the class of a code library that is optimized and loaded if it is run, and otherwise only linked.

    Raises AttributeError if numba lacks the methods that this needs.
    """
    from numba.core.codegen import JITCodeLibrary  # noqa: PLC0415

    for needed in ("_ensure_finalized", "_get_module_for_linking", "get_pointer_to_function", "finalize"):
        getattr(JITCodeLibrary, needed)

    class PartLibrary(JITCodeLibrary):  # type: ignore[misc]
        runs = False

        def get_pointer_to_function(self, name: str) -> int:
            if not self._finalized:
                functions = self._final_module.functions
                self.runs = any(f.name == name and not f.is_declaration for f in functions)
            return int(super().get_pointer_to_function(name)) if self.runs else 0

        def finalize(self) -> None:
            if self.runs:
                super().finalize()
                return
            for library in dict.fromkeys(self._linking_libraries):
                if hasattr(library, "_reload_init"):  # from numba 0.63 on
                    self._reload_init.update(library._reload_init)  # noqa: SLF001
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)  # noqa: SLF001
            self._finalized = True

    return PartLibrary
