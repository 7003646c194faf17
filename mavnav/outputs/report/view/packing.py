"""Arrays and pictures as text: typed arrays compressed as one, pictures of a palette as data URIs."""

from __future__ import annotations

import io
import zlib
from base64 import b64encode
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from PIL import Image

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

ALIGNED_BYTES: Final = 8
"""A typed array of a script begins at a multiple of its item's size."""

_LEVEL: Final = 1
"""Of zlib's levels: a fifth of the time of 6, a tenth larger."""


def pack(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return arrays as ``bytes`` (zlib, base64), and in ``arrays`` the type, offset and length of each by name.

    Types are those of numpy in little-endian order without its mark, such as ``u2``.
    """
    table, parts, offset = {}, [], 0
    for name, array in arrays.items():
        content = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
        table[name] = [array.dtype.str[1:], offset, array.size]
        content += bytes(-len(content) % ALIGNED_BYTES)
        parts.append(content)
        offset += len(content)
    return {"arrays": table, "bytes": b64encode(zlib.compress(b"".join(parts), _LEVEL)).decode("ascii")}


def palette_png(pixels: NDArray[np.uint8], colours: NDArray[np.uint8]) -> str:
    """Return a PNG file as a data URI; a pixel (rows, cols) is the number of one of ``colours`` (n, 3), 0 is clear."""
    buffer = io.BytesIO()
    image = Image.fromarray(pixels)
    image.putpalette(colours.tobytes())
    image.save(buffer, format="PNG", transparency=0, compress_level=6)
    return "data:image/png;base64," + b64encode(buffer.getvalue()).decode("ascii")
