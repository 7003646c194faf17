"""The decorators of all kernels, and the types of their arguments and results by their numba names.

numba is not imported. Machine code is loaded from the disk, or compiled, at the first call. The annotations of a kernel
are its signature: int, float and bool stand for int64, float64 and bool. Its arrays are C-ordered unless the name ends
in STRIDED, and only read unless they are ``Out[...]`` or results. Helpers have the same annotations, but numba infers
their types. Inside a kernel a scalar type of numpy converts a number.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cached_property, partial
from inspect import get_annotations
from threading import RLock, current_thread, main_thread
from typing import Annotated, Any, ParamSpec, TypeVar, cast

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.kernels.machine.cache import read_code, source_stamp, write_code
from mavnav.kernels.machine.loader import MachineCode, check_executable, link


class Type(Struct, frozen=True):
    """A scalar type, or with ``ndim`` an array of it; ``layout`` is C (C-ordered) or A (any)."""

    name: str
    ndim: int = 0
    layout: str = "C"
    readonly: bool = True

    @property
    def numba(self) -> Any:  # noqa: ANN401
        """The type itself; imports numba."""
        from numba import types  # noqa: PLC0415

        scalar = getattr(types, self.name)
        return types.Array(scalar, self.ndim, self.layout, readonly=self.readonly) if self.ndim else scalar


class Signature(Struct, frozen=True):
    """The types of the arguments and of the results of a kernel."""

    arguments: tuple[Type, ...]
    results: tuple[Type, ...]

    @classmethod
    def of(cls, function: Callable[..., Any]) -> Signature:
        """Read the annotations of a function."""
        *arguments, result = get_annotations(function, eval_str=True).values()
        results = result.__args__ if getattr(result, "__origin__", None) is tuple else (result,)
        return cls(tuple(map(_type_of, arguments)), tuple(replace(_type_of(each), readonly=False) for each in results))

    @property
    def numba(self) -> Any:  # noqa: ANN401
        """The signature itself; imports numba."""
        from numba import types  # noqa: PLC0415

        results = [each.numba for each in self.results]
        result = types.Tuple(results) if len(results) > 1 else results[0]
        return result(*(each.numba for each in self.arguments))


def _type_of(annotation: Any) -> Type:  # noqa: ANN401
    """Return the type that an annotation states, of an array read-only unless it is ``Out[...]``."""
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    array: Type
    array, *out = annotation.__metadata__
    return replace(array, readonly=not out)


_numpy: Any = np  # to the type checker a number stays what it is
int32, int64, float64 = _numpy.int32, _numpy.int64, _numpy.float64
uint8, uint16, uint64 = _numpy.uint8, _numpy.uint16, _numpy.uint64

_SCALARS = {bool: Type("bool_"), int: Type("int64"), float: Type("float64"), None: Type("void")}

Array = TypeVar("Array")
Out = Annotated[Array, "out"]
"""An array that the kernel writes to."""

BOOL_1D = Annotated["NDArray[np.bool_]", Type("bool_", 1)]
BOOL_2D = Annotated["NDArray[np.bool_]", Type("bool_", 2)]
F32_1D = Annotated["NDArray[np.float32]", Type("float32", 1)]
F32_2D = Annotated["NDArray[np.float32]", Type("float32", 2)]
F64_1D = Annotated["NDArray[np.float64]", Type("float64", 1)]
F64_2D = Annotated["NDArray[np.float64]", Type("float64", 2)]
F64_3D = Annotated["NDArray[np.float64]", Type("float64", 3)]
I16_3D = Annotated["NDArray[np.int16]", Type("int16", 3)]
I32_1D = Annotated["NDArray[np.int32]", Type("int32", 1)]
I32_2D = Annotated["NDArray[np.int32]", Type("int32", 2)]
I32_3D = Annotated["NDArray[np.int32]", Type("int32", 3)]
I64_1D = Annotated["NDArray[np.int64]", Type("int64", 1)]
I64_2D = Annotated["NDArray[np.int64]", Type("int64", 2)]
I64_3D = Annotated["NDArray[np.int64]", Type("int64", 3)]
I8_2D = Annotated["NDArray[np.int8]", Type("int8", 2)]
U16_1D = Annotated["NDArray[np.uint16]", Type("uint16", 1)]
U16_2D = Annotated["NDArray[np.uint16]", Type("uint16", 2)]
U16_2D_STRIDED = Annotated["NDArray[np.uint16]", Type("uint16", 2, "A")]
U16_3D = Annotated["NDArray[np.uint16]", Type("uint16", 3)]
U32_2D = Annotated["NDArray[np.uint32]", Type("uint32", 2)]
U8_1D = Annotated["NDArray[np.uint8]", Type("uint8", 1)]
U8_2D = Annotated["NDArray[np.uint8]", Type("uint8", 2)]
U8_3D = Annotated["NDArray[np.uint8]", Type("uint8", 3)]


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
        if current_thread() is main_thread():
            with ThreadPoolExecutor(1) as beside:
                result = beside.submit(code, *args).result()
        else:
            result = code(*args)
        self.run = code  # type: ignore[method-assign]
        return result

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

            run, made = compile_kernel(self.function, Signature.of(self.function).numba)
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
    """Compile a function called from Python for one signature, its annotations, once per machine.

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
