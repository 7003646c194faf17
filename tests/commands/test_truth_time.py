"""A true pose holds at the time of its stamp, or at that of another beam where the user says so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mavnav.cli import run
from mavnav.outputs.files.trajectory import write_poses
from mavnav.pose import Trajectory
from support.field_logs import START_S, drive_log, poses_at
from support.log_files import write_mcap
from support.synthetic import along

PATH = along([(1.0, 0.8), (4.9, 0.8), (4.6, 2.9)], 0.02, 0.7, 1.5, START_S * 10**9)
SWEEP_S = 0.1


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mcap(tmp_path_factory.mktemp("log") / "log.mcap", drive_log(path=PATH, beams=180, noise_m=0.005))


def rmse_m(log: Path, folder: Path, late_s: float, *more: str) -> float:
    """Return the error of a replay against true poses that hold ``late_s`` after the stamps of the scans."""
    stamps_ns = PATH.stamps_ns[0] + np.arange(0, int(PATH.stamps_ns[-1] - PATH.stamps_ns[0]) - 10**8, 10**8)
    at_ns = stamps_ns + round(late_s * 1e9)
    write_poses(Trajectory(stamps_ns, poses_at(PATH, at_ns)), folder / "truth.tum")
    words = ["--truth", str(folder / "truth.tum"), "-o", str(folder / "run"), "-q", "--force", *more]
    assert run(["replay", str(log), "--outputs", "trajectory,metrics", *words]) == 0
    document = json.loads((folder / "run" / "run.json").read_text())
    assert document["tracking"]["holds_s"] == pytest.approx(0.5 * SWEEP_S)
    return float(document["reference"]["ate"]["rmse_m"])


@pytest.mark.slow
def test_the_truth_at_any_beam_fits_when_it_is_named(log: Path, tmp_path: Path) -> None:
    errors_m = {
        beam: rmse_m(log, tmp_path, share * SWEEP_S, "--set", f"truth_at={beam}")
        for beam, share in (("first", 0.0), ("middle", 0.5), ("last", 1.0))
    }
    assert max(errors_m.values()) < 0.01
    assert rmse_m(log, tmp_path, 0.0) == errors_m["first"]
    assert rmse_m(log, tmp_path, SWEEP_S) > 2 * errors_m["last"]
