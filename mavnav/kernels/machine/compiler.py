"""numba's compiler, without separate optimization and code generation of each helper of a kernel.

Only modules that compile kernels import this one, and numba with it.

numba makes machine code of each helper, and of each of its own functions that a kernel needs, although only the
kernel's is ever run; and at every depth of calls it optimizes all called code again. Here such parts are linked
unoptimized, and the kernel is optimized once with all code that it calls.
"""

from __future__ import annotations

import pickle
from contextlib import contextmanager, suppress
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numba
import numpy as np
from msgspec.structs import astuple

from mavnav.kernels.machine.loader import MachineCode, copied
from mavnav.kernels.machine.object_file import image_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mavnav.kernels.machine.types import Signature

_OPTIONS: Final = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}


def load_typing_tables() -> None:
    """Load numba's tables of Python and NumPy functions."""
    from numba.core.registry import cpu_target  # noqa: PLC0415

    cpu_target.target_context.refresh()
    cpu_target.typing_context.refresh()


def as_helper(function: Callable[..., Any]) -> Any:  # noqa: ANN401
    """Return numba's form of a function that only kernels call."""
    return numba.njit(no_cpython_wrapper=True, **_OPTIONS)(function)


def compiled(function: Callable[..., Any], signature: Signature) -> tuple[Callable[..., Any], MachineCode | None]:
    """Compile a kernel; return the callable, and its code, None if this numba does not provide it."""
    made = numba.njit(**_OPTIONS)(function)
    with whole_kernels(made.targetctx):
        made.compile(signature.numba)
    made.disable_compile()
    (result,) = made.overloads.values()
    try:
        return made, _packed(function, result)
    except (AttributeError, ImportError, TypeError, ValueError):
        return made, None  # a numba with other internals: kernels compile at every start


def loaded_by_numba(
    entry: MachineCode, function: Callable[..., Any], signature: Signature
) -> Callable[..., Any] | None:
    """Load the code of a kernel as numba's own cache does, but without the compiler; None if that is not possible.

    It is not with other internals of numba, or if the content is not valid: then the kernel is compiled.
    """
    made = numba.njit(**_OPTIONS)(function)
    context = made.targetctx
    try:
        _initialize(context)
        (name, kind, (_, bitcode)), *rest = pickle.loads(entry.rest)  # noqa: S301
        parts = ((name, kind, (entry.code, bitcode)), *rest)
        found = numba.core.compiler.CompileResult._rebuild(context, *parts)  # noqa: SLF001
        context.insert_user_function(found.entry_point, found.fndesc, [found.library])
        made.add_overload(found)
        made._cache_hits[signature.numba] += 1  # noqa: SLF001
    except Exception:  # whatever is wrong with the entry, it is compiled again
        return None
    made.disable_compile()
    return made  # type: ignore[no-any-return]


def _initialize(context: Any) -> None:  # noqa: ANN401
    """Load numba's runtime, but not its tables of Python and NumPy functions, which take 0.3 s."""
    try:
        from numba.core.runtime import rtsys  # noqa: PLC0415

        rtsys.initialize(context)
    except (AttributeError, ImportError):
        context.refresh()


def _packed(function: Callable[..., Any], result: Any) -> MachineCode:  # noqa: ANN401
    """Return the machine code of a compiled function: an image if it can be loaded, else all that numba needs."""
    (_, _, (code, _)), *_ = result._reduce()  # noqa: SLF001
    wrapper = result.fndesc.llvm_cpython_wrapper_name
    try:
        environment, dtypes, symbols = _needs(result)
    except (AttributeError, LookupError):
        return MachineCode(code=code, rest=_rest(result))
    with suppress(Exception):  # another system, other internals of numba
        image = astuple(image_of(code, (wrapper, environment)))
        entry = MachineCode(wrapper, environment, dtypes, image)
        copied(entry, function.__module__, function.__qualname__)
        return entry
    return MachineCode(wrapper, environment, dtypes, None, code, symbols, _rest(result))


def _rest(result: Any) -> bytes:  # noqa: ANN401
    """Return what numba needs to load the code, without the parts for calls by other compiled functions."""
    from llvmlite.binding import parse_assembly  # noqa: PLC0415
    from numba.core.serialize import dumps  # noqa: PLC0415

    (name, kind, _), *rest = result._reduce()  # noqa: SLF001
    names = f'define void @"{result.fndesc.llvm_cpython_wrapper_name}"() {{ ret void }}'
    packed: bytes = dumps(((name, kind, (b"", parse_assembly(names).as_bitcode())), *rest))
    return packed


def _needs(result: Any) -> tuple[str, tuple[str, ...], tuple[str, ...]]:  # noqa: ANN401
    """Return the variable of a function's environment, the types in it, and the unresolved symbols of its code.

    Raises LookupError if the environment holds anything else, which only numba can restore.
    """
    module, kept = result.library._final_module, result.environment.consts  # noqa: SLF001
    if not all(isinstance(one, np.dtype) and one.isbuiltin for one in kept):
        raise LookupError(kept)
    declared = (one.name for one in (*module.functions, *module.global_variables) if one.is_declaration)
    symbols = tuple(name for name in declared if not name.startswith("llvm."))
    return result.target_context.get_env_name(result.fndesc), tuple(one.str for one in kept), symbols


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
