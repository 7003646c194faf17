"""Maps and truths that cannot be ones: refused with one line, never read without end."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from mavnav.errors import ConfigError, UsageError
from mavnav.ground_truth.map_file import read_map
from mavnav.ground_truth.tables import read_relations, read_tum

if TYPE_CHECKING:
    from pathlib import Path


def described(folder: Path, **changed: str) -> Path:
    (folder / "m.pgm").write_bytes(b"P5\n4 4\n255\n" + bytes(16))
    about = {"image": "m.pgm", "resolution": "0.05", "origin": "[0, 0, 0]"} | changed
    path = folder / "m.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in about.items()))
    return path


@pytest.mark.parametrize("resolution", ["1e-300", "1e-6", "1e6", "-1", "9" * 400])
def test_absurd_resolutions_are_refused(resolution: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="resolution"):
        read_map(described(tmp_path, resolution=resolution))


@pytest.mark.parametrize("origin", ["[1e300, 0, 0]", "[0, -1e9, 0]", f"[0, 0, {'9' * 400}]", "[.inf, 0, 0]"])
def test_absurd_origins_are_refused(origin: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="origin"):
        read_map(described(tmp_path, origin=origin))


def test_a_number_of_thousands_of_digits_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a number of 5000 digits"):
        read_map(described(tmp_path, resolution="9" * 5000))


def test_a_picture_that_is_a_device_or_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for image in ("pipe", "/dev/zero"):
        with pytest.raises(UsageError, match="not a regular file"):
            read_map(described(tmp_path, image=image))


def test_a_truth_that_is_a_pipe_or_too_large_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    large = tmp_path / "large"
    with large.open("wb") as file:
        file.truncate(1 << 30)
    for read in (read_tum, read_relations):
        with pytest.raises(UsageError, match="not a regular file"):
            read(tmp_path / "pipe")
        with pytest.raises(UsageError, match="larger than"):
            read(large)
