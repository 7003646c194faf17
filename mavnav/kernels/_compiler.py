"""numba's compiler, but for its habit of optimizing and translating every helper before the kernel that it is part of.

numba makes machine code of each helper, and of each function of its own that a kernel needs, although only the kernel's
is ever run; and at every depth of calls all that is called is optimized again. Here such parts are linked as they are,
and the kernel is optimized once, with all that it calls.
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def whole_kernels(context: Any) -> Iterator[None]:  # noqa: ANN401
    """Compile within it with parts linked as they are; a numba that has moved these parts compiles as it always did.

    ``context`` is the target context of a numba function.
    """
    codegen = context.codegen()
    try:
        before, codegen._library_class = codegen._library_class, _part_library()  # noqa: SLF001
    except (AttributeError, ImportError):
        yield
        return
    codegen.set_env = _set_env_of_loaded(codegen)
    try:
        yield
    finally:
        codegen._library_class = before  # noqa: SLF001
        del codegen.set_env


def _set_env_of_loaded(codegen: Any) -> Any:  # noqa: ANN401
    """Return the function that sets a function's environment: parts, which are not run, have none."""
    set_env, engine = codegen.set_env, codegen._engine  # noqa: SLF001

    def set_env_of_loaded(name: str, env: object) -> None:
        if engine.get_global_value_address(name):
            set_env(name, env)

    return set_env_of_loaded


@cache
def _part_library() -> Any:  # noqa: ANN401
    """Return the class of code that is optimized and loaded if it is to be run, and else only linked.

    Raises AttributeError where numba lacks what this rests on.
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
                self._reload_init.update(library._reload_init)  # noqa: SLF001
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)  # noqa: SLF001
            self._finalized = True

    return PartLibrary
