"""Maps and truths that cannot be ones: refused with one line, never read without end."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mavnav.batch.baseline import read_baseline
from mavnav.config.named_files import read_json
from mavnav.errors import ConfigError, UsageError
from mavnav.ground_truth.map_file import read_map
from mavnav.ground_truth.tables import read_relations, read_tum
from mavnav.outputs.files.gridmap import read_npz
from support.fuzz import mutated

if TYPE_CHECKING:
    from pathlib import Path

DIGITS = f'{{"mavnav_version": "1", "cells": [{{"name": "a", "exit_code": 0, "figures": {{"a": {"9" * 400}}}}}]}}'


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


@pytest.mark.parametrize("image", ['"\\ud800"', '"a\\0b"', "[" + 5000 * "0," + "0]", "{a: 1}", "3"])
def test_a_picture_whose_name_no_file_can_have_is_refused(image: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="image") as caught:
        read_map(described(tmp_path, image=image))
    assert len(str(caught.value)) < 300


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


def test_a_map_of_nothing_but_walls_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavnav.ground_truth.map_file.MAX_OCCUPIED", 15)
    with pytest.raises(UsageError, match="16 cells are occupied, more than 15"):
        read_map(described(tmp_path))


def test_a_large_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    large = tmp_path / "large"
    with large.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(OSError, match="larger than"):
        read_json(large)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "9" * 5000, DIGITS, "\0", "{"])
def test_json_that_cannot_be_read_is_no_baseline(text: str, tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    path.write_text(text)
    if text != DIGITS:
        with pytest.raises(ValueError, match=r"."):
            read_json(path)
    with pytest.raises(UsageError, match="is no baseline"):
        read_baseline(path)


def test_damaged_counts_are_a_value_error(tmp_path: Path) -> None:
    path = tmp_path / "hits.npz"
    cells = np.zeros((40, 40), np.int32)
    np.savez_compressed(path, counts=cells, passes=cells, cell_m=0.05, origin_xy_m=np.zeros(2))
    whole = path.read_bytes()
    assert read_npz(path).hits.shape == (40, 40)
    for seed in range(60):
        path.write_bytes(mutated(whole, seed))
        with suppress(OSError, ValueError, MemoryError):
            read_npz(path)
    np.savez(path, counts=cells, passes=cells[1:], cell_m=0.05, origin_xy_m=np.zeros(2))
    with pytest.raises(ValueError, match="holds no counts of a map"):
        read_npz(path)


@pytest.mark.parametrize(
    "change",
    [
        {"cell_m": 0.05e12},
        {"cell_m": 10.1},
        {"cell_m": 9e-5},
        {"cell_m": np.nan},
        {"cell_m": -0.05},
        {"origin_xy_m": np.array([np.inf, 0.0])},
        {"origin_xy_m": np.array([0.0, -1e300])},
        {"counts": np.full((4, 4), -1, np.int32)},
        {"passes": np.full((4, 4), -1, np.int64)},
        {"counts": np.full((4, 4), 1 << 40, np.int64)},
        {"passes": np.zeros((4, 4), np.float32)},
        {"counts": np.zeros(16, np.int32), "passes": np.zeros(16, np.int32)},
    ],
    ids=lambda change: " ".join(f"{key} {np.ravel(value)[0]}" for key, value in change.items()),
)
def test_values_that_no_map_has_are_refused(change: dict[str, Any], tmp_path: Path) -> None:
    cells = np.ones((4, 4), np.int32)
    for cell_m in (1e-3, 10.0):
        np.savez(tmp_path / "hits.npz", counts=cells, passes=cells, cell_m=cell_m, origin_xy_m=np.array([1e8, -1e8]))
        assert read_npz(tmp_path / "hits.npz").cell_m == cell_m
    content = {"counts": cells, "passes": cells, "cell_m": 0.05, "origin_xy_m": np.zeros(2)}
    np.savez(tmp_path / "hits.npz", **(content | change))
    with pytest.raises(ValueError, match="no counts of a map"):
        read_npz(tmp_path / "hits.npz")
