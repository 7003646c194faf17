"""The decorators of all kernels: machine code is loaded from the disk, or compiled, at the first call."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cached_property, partial
from threading import RLock
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

import numpy as np

from mavnav.kernels.machine.cache import read_code, source_stamp, write_code
from mavnav.kernels.machine.loader import MachineCode, check_executable, link
from mavnav.kernels.machine.types import Signature, Type

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")

DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "") not in {"", "0"}
"""Whether kernels stay Python functions, by numba's own environment variable."""

_ALIGNED, _C_ORDERED, _WRITABLE = 0x100, 0x1, 0x400
"""Bits of ``ndarray.flags.num``."""


_ONE_AT_A_TIME = RLock()
"""Threads load and compile one after the other: the engine that takes machine code is not made for more."""


class Helper:
    """A function that only kernels call; its code is part of theirs."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Wrap a function; numba is imported when a kernel that calls it is compiled."""
        self.function = function

    @cached_property
    def _numba(self) -> Any:  # noqa: ANN401
        """Numba's form of the function."""
        from mavnav.kernels.machine.compiler import as_helper  # noqa: PLC0415

        return as_helper(self.function)

    @property
    def _numba_type_(self) -> Any:  # noqa: ANN401
        """Numba's type of the function in the code of a kernel."""
        return self._numba._numba_type_


class Kernel:
    """A function compiled to machine code for one signature, its annotations, with its cache entry."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Wrap a function; its code is loaded by the first call."""
        self.function = function
        self.module, self.name = function.__module__, function.__qualname__
        self.loaded = self.compiled = False
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def __call__(self, *args: Any) -> Any:  # noqa: ANN401
        """Call the machine code; raises TypeError for arguments of other types."""
        arrays = self._arrays
        try:
            for k, ndim, dtype, mask in arrays:
                array = args[k]
                if array.ndim != ndim or array.flags.num & mask != mask:
                    raise TypeError(self._mismatch(args))
                if array.dtype is not dtype and array.dtype != dtype:  # almost always the same object
                    raise TypeError(self._mismatch(args))
        except (AttributeError, IndexError):
            raise TypeError(self._mismatch(args)) from None
        return self.run(*args)

    @cached_property
    def _arrays(self) -> list[tuple[int, int, Any, int]]:
        """Position, number of dimensions, dtype and necessary flags of the arguments that are arrays."""
        arguments = enumerate(Signature.of(self.function).arguments)
        return [(k, each.ndim, *_demands(each)) for k, each in arguments if each.ndim]

    def run(self, *args: Any) -> Any:  # noqa: ANN401
        """Load the machine code, which replaces this method, and call it."""
        self.load()
        return self.run(*args)

    def _run_first(self, code: Callable[..., Any], *args: Any) -> Any:  # noqa: ANN401
        """Call the machine code for the first time, beside the main thread.

        The first call looks up by Python code what its arrays are (`loader`). In the main thread a signal handler may
        run there, and raise: the array would have no type, and the process would crash.
        """
        self.run = code  # type: ignore[method-assign]
        with ThreadPoolExecutor(1) as beside:
            return beside.submit(code, *args).result()

    def _mismatch(self, args: tuple[Any, ...]) -> str:
        given = ", ".join(f"{getattr(each, 'dtype', type(each).__name__)}{getattr(each, 'shape', '')}" for each in args)
        return f"{self.name} takes other arguments than ({given})"

    @cached_property
    def _entry(self) -> str:
        """Name of the cache entry."""
        return f"{self.module}.{self.name}-{source_stamp(self.module).hex()[:24]}"

    @cached_property
    def code(self) -> memoryview | None:
        """Content of the cache entry; None if there is no valid one."""
        return read_code(self._entry)

    def recheck_disk(self) -> None:
        """Read the disk again at the next use if it had no entry: another process may have compiled it since."""
        if self.code is None:
            del self.code

    def load(self) -> None:
        """Load the machine code from the disk, or compile it and write it to the disk."""
        with _ONE_AT_A_TIME:
            if not self.loaded:
                self._load()

    def _load(self) -> None:
        check_executable()
        run = None if self.code is None else self._from_disk(self.code)
        if run is None:
            from mavnav.kernels.machine.compiler import compile_kernel  # noqa: PLC0415

            run, made = compile_kernel(self.function)
            self.compiled = True
            if made is not None:
                write_code(self._entry, made.pack())
        self.run, self.loaded, self.code = partial(self._run_first, run), True, None  # type: ignore[method-assign]

    def _from_disk(self, content: memoryview) -> Callable[..., Any] | None:
        """Load an entry; None if it is not valid, or if numba has other internals than when it was written."""
        with suppress(Exception):
            entry = MachineCode.parse(content)
            if entry.wrapper:
                return link(entry, self.module, self.name)
            from mavnav.kernels.machine.compiler import load_by_numba  # noqa: PLC0415

            return load_by_numba(entry.code, self.function)
        return None


KERNELS: list[Kernel] = []
"""All kernels of the loaded modules."""


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function called from Python for one signature, its annotations (``types``), once per machine.

    Its machine code is loaded by the first call. Division is C-like, and the GIL is released.
    """
    if DISABLED:
        return function
    KERNELS.append(Kernel(function))
    return cast("Callable[P, R]", KERNELS[-1])


def helper(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function that only kernels call, together with the first of them.

    Its machine code is part of theirs. Alone it is neither stored on disk nor callable from Python.
    """
    return function if DISABLED else cast("Callable[P, R]", Helper(function))


def _demands(array: Type) -> tuple[Any, int]:
    """Return the dtype of an array type, and the flags that an array must have."""
    ordered = _C_ORDERED if array.layout == "C" else 0
    return np.dtype(array.name), _ALIGNED | ordered | (0 if array.readonly else _WRITABLE)
