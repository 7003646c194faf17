"""Run directories as strangers may leave them: their files and documents altered."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np


def change_document(run: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change run.json in place."""
    document = json.loads((run / "run.json").read_text())
    change(document)
    (run / "run.json").write_text(json.dumps(document))


def on_purpose(run: Path, *names: str) -> None:
    """Delete the digests of files that are altered, as SECURITY.md says."""
    change_document(run, lambda document: [document["outputs"].pop(name) for name in names])


def with_new_digests(run: Path) -> None:
    """Give all files of a run the digests that they have now, as an attacker would."""
    digests = {path.name: sha256(path.read_bytes()).hexdigest() for path in run.iterdir() if path.name != "run.json"}
    change_document(run, lambda document: document["outputs"].update(digests))


def write_counts(run: Path, counts: np.ndarray, passes: np.ndarray, packing: int = zipfile.ZIP_DEFLATED) -> None:
    """Replace the counts of the map of a run by others, of cells of 20 mm, with its digest."""
    arrays = {"counts": counts, "passes": passes, "cell_m": np.array(0.02), "origin_xy_m": np.zeros(2)}
    with zipfile.ZipFile(run / "hits.npz", "w", packing) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array)
    with_new_digests(run)
