"""Made gaps in recorded logs: how many parts are joined, and how many of them where they belong.

    python benchmarks/gaps.py LOGS [NAME ...]

A log is tracked as a whole. Its poses before a gap of 0.5 to 4 s and those after it, from all scans and from every
third, are two parts whose transform is known. "Elsewhere" are parts of the same log from 8 to 20 s later, as if the
laser had been carried: most show other walls. A join is right within 0.2 m and 5 deg of the track of the whole.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from disturbed import PARTS
from doubt_corpus import LOGS

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import Match, first_match
from mavnav.slam.matching.steps import Step
from mavnav.slam.methods.pauses import highest_speeds
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.recovery.across_gap import LOCAL_SCANS, pose_across_gap
from mavnav.slam.track import Track
from mavnav.units import DEG, NS

PERIOD_S, RIGHT_M, RIGHT_RAD = 0.1, 0.2, 5 * DEG
GAPS_S, EVERY, BESIDE_S, FEWEST = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0), (1, 3), 3.0, 6
"""Gaps; every how many scans; time on either side at least; and number of scans there."""

PARTED = Pose(3.0, -2.0, 1.0)
"""Frame of the map of a part in that of the log."""


def tracked(name: str, logs: Path) -> tuple[list[Scan], list[Step]]:
    """Return the scans of a part of a log and their steps, by the track without odometry."""
    start_s, end_s = PARTS[name]
    log = open_log(logs / LOGS[name][0], start_s=start_s, end_s=end_s)
    scans = list(log.scans())
    run = run_slam(partial(iter, scans), Config(), log.period_s)
    poses = dict(zip(run.trajectory.stamps_ns.tolist(), range(len(run.trajectory)), strict=True))
    steps = (
        Step(k, scan.stamp_ns, at(run.trajectory[poses[scan.stamp_ns]]), tracked=True)
        for k, scan in enumerate(scans)
        if scan.stamp_ns in poses
    )
    return scans, list(steps)


def pairs(steps: list[Step], rng: np.random.Generator, *, elsewhere: bool) -> Iterator[tuple[list[Step], list[Step]]]:
    """Yield the steps before a gap and those after it, the nearest first; those from elsewhere as if they came then."""
    for every in EVERY:
        some = steps[::every]
        t_s = np.array([step.stamp_ns for step in some]) * NS
        for gap_s in GAPS_S:
            last_s = t_s[-1] - gap_s - BESIDE_S
            for at_s in np.arange(t_s[0] + BESIDE_S, last_s, max(4.0, (last_s - t_s[0]) / 5)).tolist():
                from_s = at_s + gap_s + (rng.uniform(8.0, 20.0) if elsewhere else 0.0)
                before, after = np.searchsorted(t_s, at_s, "right"), np.searchsorted(t_s, from_s)
                here, beyond = some[:before][: -LOCAL_SCANS - 1 : -1], some[after:][:LOCAL_SCANS]
                early_ns = round((from_s - at_s - gap_s) / NS)
                beyond = [step._replace(stamp_ns=step.stamp_ns - early_ns) for step in beyond]
                if min(len(here), len(beyond)) >= FEWEST:
                    yield here, beyond


def outcomes(scans: list[Scan], steps: list[Step], *, elsewhere: bool) -> Counter[str]:
    """Count the joins of one log that are right, wrong, and not made."""
    by_number, joins, fastest = dict(enumerate(scans)), Counter[str](), highest_speeds(steps)
    track = Track(partial(iter, scans), Config(), Motion(PERIOD_S), make_method(Config()))
    for here, beyond in pairs(steps, np.random.default_rng(0), elsewhere=elsewhere):
        part = [step._replace(match=at(PARTED @ step.match.map_T_laser)) for step in beyond]
        map_T_part = pose_across_gap(here, part, by_number, track, fastest)
        if map_T_part is None:
            joins["none"] += 1
            continue
        off_m, off_rad = beyond[0].match.map_T_laser.gap(map_T_part @ part[0].match.map_T_laser)
        joins["right" if off_m < RIGHT_M and off_rad < RIGHT_RAD else "wrong"] += 1
    return joins


def at(pose: Pose) -> Match:
    """Return the match of a scan at a pose."""
    return first_match(0)._replace(map_T_laser=pose)


def main(logs: Path, *names: str) -> None:
    """Print the joins of every log, and of all."""
    print("| log | right | wrong | none | elsewhere: right | wrong | none |\n|---|---|---|---|---|---|---|")
    total: Counter[tuple[bool, str]] = Counter()
    for name in names or PARTS:
        scans, steps = tracked(name, logs)
        joins = {(e, what): n for e in (False, True) for what, n in outcomes(scans, steps, elsewhere=e).items()}
        total.update(joins)
        print(row(name, joins), flush=True)
    print(row("all", total))


def row(name: str, joins: Mapping[tuple[bool, str], int]) -> str:
    """Return a row of the table."""
    cells = (str(joins.get((e, what), 0)) for e in (False, True) for what in ("right", "wrong", "none"))
    return f"| {name} | " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
