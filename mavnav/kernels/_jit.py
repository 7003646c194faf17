"""The decorators of all kernels, whose machine code is loaded from the disk, or compiled, at their first call."""

from __future__ import annotations

import os
from functools import cached_property
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

from mavnav.kernels._cache import read_code, source_stamp, write_code
from mavnav.kernels._loader import MachineCode, cache_key, loaded

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.kernels._types import Signature, Type

P = ParamSpec("P")
R = TypeVar("R")

DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "") not in {"", "0"}
"""Whether kernels stay functions of Python, as numba's own variable says."""

_ALIGNED, _C_ORDERED, _WRITABLE = 0x100, 0x1, 0x400
"""Of ``ndarray.flags.num``."""


class Helper:
    """A function that only kernels call; it is part of their machine code."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Wrap a function; numba is imported when a kernel that calls it is compiled."""
        self.function = function

    @cached_property
    def _numba(self) -> Any:  # noqa: ANN401
        """The function as numba knows it."""
        from mavnav.kernels._compiler import helping  # noqa: PLC0415

        return helping(self.function)

    @property
    def _numba_type_(self) -> Any:  # noqa: ANN401
        """What numba takes this for where a kernel calls it."""
        return self._numba._numba_type_


class Kernel:
    """A function of machine code for one signature, and where that code is kept."""

    def __init__(self, function: Callable[..., Any], signature: Signature) -> None:
        """Wrap a function; its code is loaded by the first call."""
        self.function, self.signature = function, signature
        self.module, self.name = function.__module__, function.__qualname__
        self.arrays = [(k, each.ndim, *_demands(each)) for k, each in enumerate(signature.arguments) if each.ndim]
        self.loaded = self.compiled = False
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def __call__(self, *args: Any) -> Any:  # noqa: ANN401
        """Call the machine code; raises TypeError for arguments of other types."""
        try:
            for k, ndim, dtype, mask in self.arrays:
                array = args[k]
                same = array.dtype is dtype or array.dtype == dtype  # almost always the same object
                if not same or array.ndim != ndim or array.flags.num & mask != mask:
                    raise TypeError(self._mismatch(args))
        except (AttributeError, IndexError):
            raise TypeError(self._mismatch(args)) from None
        return self.run(*args)

    def run(self, *args: Any) -> Any:  # noqa: ANN401
        """Load the machine code, which takes the place of this function, and call it."""
        self.load()
        return self.run(*args)

    def _mismatch(self, args: tuple[Any, ...]) -> str:
        given = ", ".join(f"{getattr(each, 'dtype', type(each).__name__)}{getattr(each, 'shape', '')}" for each in args)
        return f"{self.name} takes other arguments than ({given})"

    @cached_property
    def _entry(self) -> tuple[str, str]:
        """Key and name of its entry in the cache."""
        return cache_key(), f"{self.module}.{self.name}-{source_stamp(self.module).hex()[:24]}"

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
        if self.loaded:
            return
        run = None if self.code is None else self._from_disk(self.code)
        if run is None:
            from mavnav.kernels._compiler import compiled  # noqa: PLC0415

            run, made = compiled(self.function, self.signature)
            self.compiled = True
            if made is not None:
                write_code(*self._entry, made.packed())
        self.run, self.loaded, self.code = run, True, None  # type: ignore[method-assign]

    def _from_disk(self, content: bytes) -> Callable[..., Any] | None:
        """Load the code without numba, or with it where that fails; None where it is not what numba wrote."""
        try:
            entry = MachineCode.unpacked(content)
        except (ValueError, EOFError, TypeError):
            return None
        try:
            return loaded(entry, self.module, self.name)
        except Exception:  # numba has moved something: it knows where
            from mavnav.kernels._compiler import loaded_by_numba  # noqa: PLC0415

            return loaded_by_numba(entry, self.function, self.signature)


KERNELS: list[Kernel] = []
"""All kernels of the modules that are loaded."""


def kernel(signature: Signature) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make a kernel of a function that Python calls: compiled for one explicit signature, once a machine.

    Its machine code is loaded by the first call. Division is C-like, and the GIL is released.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        if DISABLED:
            return function
        made = Kernel(function, signature)
        KERNELS.append(made)
        return cast("Callable[P, R]", made)

    return decorate


def helper(function: Callable[P, R]) -> Callable[P, R]:
    """Compile what only kernels call, when the first of them is compiled.

    Its machine code is part of theirs; alone it is neither kept on disk nor callable from Python.
    """
    return function if DISABLED else cast("Callable[P, R]", Helper(function))


def _demands(array: Type) -> tuple[Any, int]:
    """Return the dtype of an array, and the flags that it must have."""
    import numpy as np  # noqa: PLC0415

    ordered = _C_ORDERED if array.layout == "C" else 0
    return np.dtype(array.name), _ALIGNED | ordered | (0 if array.readonly else _WRITABLE)
