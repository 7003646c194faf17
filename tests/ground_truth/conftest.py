"""Map files written as other tools write them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def write_map(tmp_path: Path) -> Callable[..., Path]:
    """Write a map and return its YAML file; ``picture`` is bytes, or a function that saves to a path."""

    def write(picture, image: str = "map.pgm", **about: object) -> Path:
        if callable(picture):
            picture(tmp_path / image)
        else:
            (tmp_path / image).write_bytes(picture)
        lines = {"image": image, "resolution": 0.05, "origin": [-1.0, 2.0, 0.0], "negate": 0} | about
        path = tmp_path / "map.yaml"
        path.write_text("".join(f"{key}: {value}\n" for key, value in lines.items() if value is not None))
        return path

    return write
