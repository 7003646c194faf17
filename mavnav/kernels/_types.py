"""The types of the arrays that kernels read: read-only, C-ordered unless they are called strided."""

from __future__ import annotations

from numba import boolean, float64, int8, int16, int32, int64, types, uint8, uint16, uint32

BOOL_2D = types.Array(boolean, 2, "C", readonly=True)

F32_2D = types.Array(types.float32, 2, "C", readonly=True)

F64_1D = types.Array(float64, 1, "C", readonly=True)
F64_2D = types.Array(float64, 2, "C", readonly=True)

I8_2D = types.Array(int8, 2, "C", readonly=True)
I16_3D = types.Array(int16, 3, "C", readonly=True)
I32_2D = types.Array(int32, 2, "C", readonly=True)
I64_1D = types.Array(int64, 1, "C", readonly=True)
I64_2D = types.Array(int64, 2, "C", readonly=True)
I64_3D = types.Array(int64, 3, "C", readonly=True)

U8_3D = types.Array(uint8, 3, "C", readonly=True)

U16_2D = types.Array(uint16, 2, "C", readonly=True)
U16_3D = types.Array(uint16, 3, "C", readonly=True)
U16_2D_STRIDED = types.Array(uint16, 2, "A", readonly=True)
U32_2D = types.Array(uint32, 2, "C", readonly=True)
