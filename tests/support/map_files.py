"""Images of maps in the formats of other tools."""

from __future__ import annotations

import numpy as np

FREE, OCCUPIED, UNKNOWN = 1, 2, 0
KINDS = np.array([[UNKNOWN, FREE, OCCUPIED], [FREE, FREE, UNKNOWN]])
"""Kinds of cells; row 0 is at the minimum y."""


def pgm(shades: np.ndarray, kind: str = "P5", depth: int = 255) -> bytes:
    """Return the bytes of an image with its first row on top."""
    rows, cols = shades.shape
    head = f"{kind}\n# made by a test\n{cols} {rows}\n{depth}\n".encode()
    if kind == "P2":
        return head + "\n".join(" ".join(map(str, row)) for row in shades.tolist()).encode()
    return head + shades.astype(">u2" if depth > 255 else "u1").tobytes()
