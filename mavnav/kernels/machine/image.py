"""Machine code that runs where it is copied to, without a library that loads it: LLVM takes 40 ms to load itself."""

from __future__ import annotations

import ctypes
import mmap
from struct import pack_into
from typing import TYPE_CHECKING, Any

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Callable

Address = tuple[int, int]
"""Where an address is stored, and what it points to: offsets in the image, or for another library's symbols a number
to add."""


class Image(Struct, frozen=True):
    """Machine code, whose variables begin at the offset ``writable``, at a page, with the offsets of wanted symbols.

    ``inner`` are addresses within the image, ``outer`` those of other libraries by symbol.
    """

    content: bytes
    writable: int
    offsets: dict[str, int]
    inner: tuple[Address, ...]
    outer: dict[str, tuple[Address, ...]]


def placed(image: Image, address_of: Callable[[str], int]) -> tuple[Any, int]:
    """Copy an image into memory, and make it executable; returns the memory, which must be kept, and its address.

    ``address_of`` returns the address of a symbol of another library. Raises OSError if the system does not allow it.
    """
    kind = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
    memory = mmap.mmap(-1, len(image.content), kind, mmap.PROT_READ | mmap.PROT_WRITE)
    memory[:] = image.content
    start = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    for at, offset in image.inner:
        pack_into("<Q", memory, at, start + offset)
    for symbol, places in image.outer.items():
        address = address_of(symbol)
        for at, addend in places:
            pack_into("<Q", memory, at, address + addend)
    protect = ctypes.pythonapi.mprotect
    protect.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    if protect(start, image.writable, mmap.PROT_READ | mmap.PROT_EXEC):
        raise OSError("memory cannot be made executable")
    return memory, start
