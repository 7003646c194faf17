"""Advice is tried: each message that names a setting or a command is caused by a log, and what it names helps."""

from __future__ import annotations

import json
from pathlib import Path
from shlex import split
from typing import Any

import numpy as np

from mavnav.cli import run
from support.field_logs import START_S, drive_log, with_fields
from support.log_files import LASER, Message, write_mcap
from support.synthetic import along, box, polyline

TURNING = along([(1.0, 0.8), (4.9, 0.8), (4.6, 2.9), (2.2, 3.0)], 0.02, 0.7, 1.5, START_S * 10**9)


def replayed(log: Path, directory: Path, *more: str) -> tuple[int, dict[str, Any]]:
    """Return the exit code of a replay and its run.json."""
    code = run(["replay", str(log), "-o", str(directory), "-q", "--outputs", "trajectory,metrics", *more])
    return code, json.loads((directory / "run.json").read_text())


def advised(text: str) -> list[str]:
    """Return the words of the setting that a message names."""
    return split(text[text.index("--set") :])[:2]


def warning_with(document: dict[str, Any], part: str) -> str:
    (text,) = [text for text in document["warnings"] if part in text]
    return text


def test_mirrored_scans_are_named_where_odometry_turns_the_other_way(tmp_path: Path) -> None:
    messages = drive_log(path=TURNING, odometry=True, beams=120)
    mirrored = [m for m in messages if m.type != LASER] + with_fields(
        [m for m in messages if m.type == LASER], angle_min=np.pi, angle_increment=-2 * np.pi / 120
    )
    log = write_mcap(tmp_path / "log.mcap", sorted(mirrored, key=lambda m: m.time_ns))
    _, document = replayed(log, tmp_path / "a")
    words = advised(warning_with(document, "the laser turns the other way"))
    assert words == ["--set", "upside_down=true"]
    code, document = replayed(log, tmp_path / "b", *words)
    assert (code, document["tracking"]["odometry"]["used"]) == (0, True)
    assert not [text for text in document["warnings"] if "contradicts" in text]


def yard(reach_m: float = 80.0) -> list[Message]:
    """Return a drive through a yard whose walls are mostly beyond 30 m."""
    walls = np.vstack((polyline((0, 0), (110, 0), (110, 76), (0, 76), closed=True), box(62.0, 60.0, 9.0, 5.0, 0.4)))
    path = along([(40.0, 38.0), (45.0, 38.0)], 0.02, 1.5, 1.0, START_S * 10**9)
    return drive_log(path=path, walls=walls, beams=240, range_max_m=reach_m)


def test_returns_beyond_the_default_are_used_where_most_are(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", yard())
    code, document = replayed(log, tmp_path / "a", "--end", "2")
    assert (code, document["config"]["robust"]["far_mm"]) == (0, 80_000.0)
    assert "returns up to 80 m are used" in warning_with(document, "set robust.far_mm")
    code, document = replayed(log, tmp_path / "b", "--end", "0.5", "--set", "robust.far_mm=29000")
    assert (document["config"]["robust"]["far_mm"], document["warnings"]) == (29_000.0, document["warnings"])
    assert not [text for text in document["warnings"] if "are used" in text]
