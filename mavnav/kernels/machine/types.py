"""The types of the arguments and results of kernels, by their numba names; numba is not imported.

The annotations of a kernel are its signature: int, float and bool stand for int64, float64 and bool. Its arrays are
C-ordered unless the name ends in STRIDED, and only read unless they are ``Out[...]`` or results. Helpers have the same
annotations, but numba infers their types. Inside a kernel a scalar type of numpy converts a number.
"""

from __future__ import annotations

from inspect import get_annotations
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


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
