"""Golden runs: counts and verdicts exact, poses to 1e-6. ``make golden`` rewrites them after a wanted change."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavnav.config.loading import load_config
from mavnav.logs import open_log
from mavnav.slam.pipeline import run_slam

GOLDEN = Path(__file__).parent / "golden"
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "corridor-robust": ("corridor.mcap", {}),
    "complex-robust-odom-off-online": ("complex.bag", {"odom": "off", "final_pass": False}),
    "corner-paper": ("corner", {"method": "paper"}),
}
"""Name of a run -> sample log and settings."""

SECONDS = 3.0


def figures(log_path: Path, overrides: dict[str, Any]) -> dict[str, Any]:
    """Run a log and return what must not change unnoticed."""
    config = load_config(None, [], overrides)
    log = open_log(log_path, odom=config.odom, end_s=SECONDS)
    slam = run_slam(log.scans, config, log.period_s, log.odometry.odom_T_laser if log.odometry else None)
    return {
        "scans": len(slam.steps),
        "tracked": sum(step.tracked for step in slam.steps),
        "evaluations": sum(step.match.evaluations for step in slam.steps),
        "lost": [[lost.scans, lost.recovered] for lost in slam.lost],
        "occupied_cells": int(np.count_nonzero(slam.grid.hits)),
        "hits": int(slam.grid.hits.sum()),
        "every_fifth_pose": slam.trajectory.xyyaw[::5].tolist(),
    }


@pytest.mark.parametrize("name", RUNS)
def test_golden(name: str, repo_root: Path) -> None:
    log, overrides = RUNS[name]
    found = figures(repo_root / "sample_logs" / log, overrides)
    file = GOLDEN / f"{name}.json"
    if os.environ.get("MAVNAV_UPDATE_GOLDEN") == "1":
        GOLDEN.mkdir(exist_ok=True)
        file.write_text(json.dumps(found, indent=1) + "\n")
        pytest.skip("golden run rewritten")
    kept = json.loads(file.read_text())
    np.testing.assert_allclose(found.pop("every_fifth_pose"), kept.pop("every_fifth_pose"), rtol=0, atol=1e-6)
    assert found == kept
