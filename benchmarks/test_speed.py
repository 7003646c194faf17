"""Benchmarks of reading and mapping: ``make bench``; compare with ``--benchmark-compare``."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import pytest

from mavnav.config.loading import load_config
from mavnav.logs import open_log
from mavnav.slam.pipeline import run_slam

SAMPLE = Path(__file__).parent.parent / "sample_logs" / "corridor.mcap"


def test_read(benchmark: Any) -> None:
    log = open_log(SAMPLE)
    benchmark(lambda: deque(log.scans(), maxlen=0))
    benchmark.extra_info["scans"] = log.counts.usable


@pytest.mark.parametrize("grid", ["5x5", "10x10", "20x20"])
@pytest.mark.parametrize("method", ["robust", "paper"])
def test_map(benchmark: Any, method: str, grid: str) -> None:
    config = load_config(None, [], {"method": method, "grid": grid, "odom": "off"})
    scans = list(open_log(SAMPLE, end_s=3.0).scans())
    benchmark.pedantic(lambda: run_slam(lambda: scans, config, 0.1), rounds=3, warmup_rounds=1)
    benchmark.extra_info["scans"] = len(scans)
