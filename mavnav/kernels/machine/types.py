"""The types of the arguments and results of kernels, by their numba names; numba is not imported.

Read-only arrays are C-ordered unless the name ends in STRIDED. Inside a kernel a scalar type converts a number, as
numba's types do.
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct
from msgspec.structs import replace


class Type(Struct, frozen=True):
    """A scalar type, or with ``ndim`` an array of it; ``layout`` is C (C-ordered) or A (any)."""

    name: str
    ndim: int = 0
    layout: str = "C"
    readonly: bool = False

    def __getitem__(self, axes: slice | tuple[slice, ...]) -> Type:
        """Return the type of a writable C-ordered array: ``float64[:, ::1]``."""
        return replace(self, ndim=len(axes) if isinstance(axes, tuple) else 1)

    def __call__(self, *types: Any) -> Any:  # noqa: ANN401
        """Return the signature of a kernel with this result and these argument types; or convert a number."""
        if all(isinstance(each, Type) for each in types):
            return Signature(self, types)
        import numpy as np  # noqa: PLC0415

        return np.dtype(self.name).type(*types)

    @property
    def numba(self) -> Any:  # noqa: ANN401
        """The type itself; imports numba."""
        from numba import types  # noqa: PLC0415

        scalar = getattr(types, self.name)
        return types.Array(scalar, self.ndim, self.layout, readonly=self.readonly) if self.ndim else scalar

    @property
    def _numba_type_(self) -> Any:  # noqa: ANN401
        """Numba's type of a number conversion in the code of a kernel."""
        from numba import types  # noqa: PLC0415

        return types.NumberClass(getattr(types, self.name))


class Several(Struct, frozen=True):
    """The type of a tuple of results."""

    items: tuple[Type, ...]

    def __call__(self, *types: Type) -> Signature:
        """Return the signature of a kernel with this result and these argument types."""
        return Signature(self, types)

    @property
    def numba(self) -> Any:  # noqa: ANN401
        """The type itself; imports numba."""
        from numba import types  # noqa: PLC0415

        return types.Tuple([item.numba for item in self.items])


class Signature(Struct, frozen=True):
    """The types of the result and of the arguments of a kernel."""

    result: Type | Several
    arguments: tuple[Type, ...]

    @property
    def numba(self) -> Any:  # noqa: ANN401
        """The signature itself; imports numba."""
        return self.result.numba(*(argument.numba for argument in self.arguments))


boolean, void = Type("bool_"), Type("void")
int8, int16, int32, int64 = Type("int8"), Type("int16"), Type("int32"), Type("int64")
uint8, uint16, uint32, uint64 = Type("uint8"), Type("uint16"), Type("uint32"), Type("uint64")
float32, float64 = Type("float32"), Type("float64")

BOOL_2D = Type("bool_", 2, readonly=True)

F32_2D = Type("float32", 2, readonly=True)

F64_1D = Type("float64", 1, readonly=True)
F64_2D = Type("float64", 2, readonly=True)
F64_3D = Type("float64", 3, readonly=True)

I8_2D = Type("int8", 2, readonly=True)
I16_3D = Type("int16", 3, readonly=True)
I32_2D = Type("int32", 2, readonly=True)
I64_1D = Type("int64", 1, readonly=True)
I64_2D = Type("int64", 2, readonly=True)
I64_3D = Type("int64", 3, readonly=True)

U8_3D = Type("uint8", 3, readonly=True)

U16_2D = Type("uint16", 2, readonly=True)
U16_3D = Type("uint16", 3, readonly=True)
U16_2D_STRIDED = Type("uint16", 2, "A", readonly=True)
U32_2D = Type("uint32", 2, readonly=True)
