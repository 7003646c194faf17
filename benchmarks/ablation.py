"""What each pass, attempt, rule and threshold buys: it is undone alone, and logs and missions are run again.

    python benchmarks/ablation.py FOLDER [passes] [rules] [thresholds] [--every N] [--missions N] [--only TEXT] ...

FOLDER has the disturbed logs that ``disturbed.py make`` wrote; every N-th of them is run, besides some logs as they
were recorded, and missions. A rule is undone by the value that stands beside it in `RULES`; a threshold (any number of
a module of mavnav/slam) is doubled, and halved. Runs that never reach a line with its name are not run again. The table
has for each thing undone the runs by outcome, how many have another outcome or another path, and the CPU time of those
that were run again. What makes nothing worse when it is undone is a candidate for deletion. Constants of kernels are
compiled and not tried.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import pkgutil
import re
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from math import inf
from pathlib import Path
from time import process_time
from types import FrameType
from typing import Any

from disturbed import LOST, OUTCOMES, PARTS, names, outcome, read_poses
from doubt_corpus import LOGS, at_scans, flown, largest_errors, mission_names

import mavnav.slam
from mavnav.config.loading import load_config
from mavnav.logs import open_log
from mavnav.pose import Trajectory
from mavnav.slam import pipeline
from mavnav.slam.result import SlamResult

PASSES = ("ATTEMPTS", "RECOVERING", "CHECKING", "FINISHING")
"""The tuples of the pipeline of which each entry is undone."""

NEEDED = ("refine_poses", "judge_track")
"""Passes without which there is nothing to compare: the evidence, and the doubt."""

OPEN = ("ccny_demo", "lego_robot4", "slambot_rplidar", "turtlebot4_mac2", "urg_exp1")
"""Logs that are run as they were recorded, in the parts of `PARTS`."""

REPORTS = ("sparse_90_beams", "hall_360_beams_slow_odom", "odometry_reset_near_start")
"""Logs with true poses that are run as they were recorded."""

NEVER = 10**9

RULES: dict[str, dict[str, Any]] = {
    "methods.robust": {"NEAR_MINIMA": 6, "FOUND_PERIODS": 0.0, "FOUND_ANYWHERE_COST": 0.4, "FOUND_COST": inf},
    "recovery.across_gap": {"LONGEST_GAP_S": 0.0, "CONFLICT_WEIGHT": 0.0, "LEAST_AGREEMENT": 0.0, "MINIMA": 6},
    "recovery.parts": {"MOST_TRACKED": 0, "SEARCHED_SCANS": 0},
    "recovery.part_by_odometry": {"MOST_CONFLICTS": -1.0},
    "retries.beginning": {"EARLY_SCANS": 0, "MOST_TRIES": 1},
    "methods.acceptance": {"EXPECTED": inf, "INNER_SHARE": 1.0, "REACHABLE": inf, "FOUND_CONFLICTS": 1.0},
    "methods.pauses": {"FASTER": inf, "PAUSE_PERIODS": 0.0},
    "retries.beam_order": {"LISTED_RATIO": inf},
    "matching.budget": {"RARELY_SCANS": NEVER, "LONG_LOST_SCANS": NEVER, "WIDE_FIRST": NEVER, "WHOLE_FIRST": NEVER},
    "matching.relocalization": {
        "AGREEING_SCANS": 1,
        "PRIOR": 0.0,
        "MOST_MOTION_COST": inf,
        "AMBIGUITY_MARGIN": 0.0,
        "CONFLICT_POINTS": NEVER,
    },
    "robust.expert": {
        "regain_above": 0.6,
        "retry_below": 0.6,
        "conflicts_below": 1,
        "near_window_mm": 0,
        "overlap_mm": 0,
        "sparse_points": 0,
        "waiting_share": 0,
        "max_extensions": 0,
        "prior": 0,
    },
    "retries.odometry": {"IMPROVED": 1.0, "LEAST_CHANGE": (0.0, 0.0, 0.0)},
    "matching.odometry_fit": {"NEIGHBOURS": 0, "DISTINCT": 0.0, "KEPT": 1.0, "SURE": 0.0, "LEAST_ERROR": 0.0},
    "matching.motion_model": {"MOST_ERROR": inf, "NEW_SHARE": 1.0},
    "matching.scan_matching": {"ALTERNATIONS": 1, "FINAL_ALTERNATIONS": 2, "FINAL_STOP": 1.0},
}
"""Section of the configuration, or module of mavnav/slam -> name -> value with which the rule decides nothing."""

Undo = tuple[str, str, Any]
"""A tuple of the pipeline, a section of the configuration or a module; a name in it; and its new value."""

Run = dict[str, Any]


def passes() -> Iterator[Undo]:
    """Yield the passes and attempts, each to be taken out."""
    for group in PASSES:
        for name in dict.fromkeys(map(name_of, getattr(pipeline, group))):
            if name not in NEEDED:
                yield group, name, None


def name_of(each: Any) -> str:
    """Return the name of a pass or an attempt."""
    return str(getattr(each, "name", None) or each.__name__)


def rules() -> Iterator[Undo]:
    """Yield the rules, each with the value that undoes it."""
    for where, values in RULES.items():
        yield from ((where, name, value) for name, value in values.items())


def thresholds() -> Iterator[Undo]:
    """Yield the numbers of the modules of mavnav/slam, each to be doubled and halved."""
    for each in pkgutil.walk_packages(mavnav.slam.__path__, "mavnav.slam."):
        module = importlib.import_module(each.name)
        for name in assigned_names(Path(str(module.__file__))):
            value = getattr(module, name)
            if isinstance(value, int | float) and value and not isinstance(value, bool):
                where = each.name.removeprefix("mavnav.slam.")
                yield from ((where, name, type(value)(value * factor)) for factor in (2.0, 0.5))


def assigned_names(path: Path) -> list[str]:
    """Return the constants that a module defines, one by one or several in a line."""
    tops = [
        node
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign | ast.AnnAssign)
    ]
    targets = [target for top in tops for target in (top.targets if isinstance(top, ast.Assign) else [top.target])]
    names = [node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)]
    return [name for name in names if name.isupper()]


def is_module(where: str) -> bool:
    """Return whether something to be undone is a constant of a module."""
    return where not in PASSES and where != "robust.expert"


def undo(what: Undo | None) -> list[str]:
    """Undo one thing in this process, in all modules that import the name; return settings of the configuration."""
    if what is None:
        return []
    where, name, value = what
    if where in PASSES:
        setattr(pipeline, where, tuple(each for each in getattr(pipeline, where) if name_of(each) != name))
    elif not is_module(where):
        return [f"{where}.{name}={value}"]
    else:
        old = getattr(importlib.import_module(f"mavnav.slam.{where}"), name)
        for module in users_of(where, name):
            assert getattr(module, name) is old
            setattr(module, name, value)
    return []


def users_of(where: str, name: str) -> list[Any]:
    """Return the module that defines a constant, and those that import it."""
    home = importlib.import_module(f"mavnav.slam.{where}")
    imported = re.compile(rf"from mavnav\.slam\.{re.escape(where)} import (\([^)]*|.*)\b{name}\b")
    loaded = [module for key, module in list(sys.modules.items()) if key.startswith("mavnav.") and module.__file__]
    return [home, *(m for m in loaded if imported.search(Path(str(m.__file__)).read_text("utf-8")))]


@cache
def lines_of(where: str, name: str) -> frozenset[tuple[str, int]]:
    """Return the lines, by file, that read a constant, besides defaults of parameters."""
    paths = [str(module.__file__) for module in users_of(where, name)]
    nodes = ((path, node) for path in paths for node in ast.walk(ast.parse(Path(path).read_text("utf-8"))))
    return frozenset(
        (path, line)
        for path, node in nodes
        if isinstance(node, ast.stmt) and not isinstance(node, ast.FunctionDef | ast.ClassDef)
        if any(isinstance(part, ast.Name) and part.id == name for part in ast.walk(node))
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    )


def runs_without(folder: Path, logs: Path, wanted: dict[str, Any], what: Undo | None) -> dict[str, Run]:
    """Return the outcomes of some runs with one thing undone, by name; to be called in a process of its own."""
    sets = undo(what)
    return {name: run_once(folder, logs, name, sets, trace=what is None) for name in wanted}


def run_once(folder: Path, logs: Path, name: str, sets: list[str], *, trace: bool) -> Run:
    """Run a log or a mission; return errors, doubt, CPU time and, if they are traced, the lines that ran."""
    lines: set[tuple[str, int]] = set()
    start_s = process_time()
    sys.settrace(partial(note_lines, lines) if trace else None)
    slam, truth = flown(name) if name.startswith("mission-") else track_log(folder, logs, name, sets)
    sys.settrace(None)
    off_m, off_deg = largest_errors(slam.trajectory, truth)
    doubt = slam.doubt.probability if slam.doubt else None
    run: Run = {"name": name, "exit": LOST * slam.lost_for_good, "off_m": off_m, "off_deg": off_deg, "doubt": doubt}
    return {**run, "cpu_s": process_time() - start_s, "path": slam.trajectory.xyyaw.tobytes(), "lines": lines}


def note_lines(lines: set[tuple[str, int]], frame: FrameType, _event: str, _arg: Any) -> Any:
    """Take note of the lines of mavnav/slam that run."""
    path = frame.f_code.co_filename
    if "/mavnav/" not in path or "/kernels/" in path:
        return None

    def note(frame: FrameType, _event: str, _arg: Any) -> Any:
        lines.add((path, frame.f_lineno))
        return note

    return note


def track_log(folder: Path, logs: Path, name: str, sets: list[str]) -> tuple[SlamResult, Trajectory]:
    """Track a log; return the result of SLAM, and the poses to compare it with."""
    log_name = name.partition(".")[0]
    if "." in name:
        log = open_log(folder / f"{name}.mcap")
    else:
        start_s, end_s = PARTS.get(name, (None, None))
        log = open_log(logs / LOGS[name][0], start_s=start_s, end_s=end_s)
    slam = pipeline.run_slam(
        log.scans,
        load_config(sets=sets),
        log.period_s,
        log.odom_T_laser,
        base_T_laser=log.base_T_laser,
        scans_ns=log.stamps_ns,
    )
    if log_name in PARTS:
        return slam, read_poses(folder / f"{log_name}.tum")
    return slam, at_scans(list(log.scans()), (logs / LOGS[name][0]).with_name("truth.tum"))


def affected(what: Undo, before: dict[str, Run]) -> dict[str, Run]:
    """Return the runs that can change: those that reach a line with the name, if it is one of a module."""
    if not is_module(what[0]):
        return before
    return {name: run for name, run in before.items() if not run["lines"].isdisjoint(lines_of(*what[:2]))}


def row(what: Undo | None, again: dict[str, Run], before: dict[str, Run]) -> str:
    """Return a row of the table; runs that were not run again are as before."""
    counts = Counter(outcome(run) for run in (before | again).values())
    changed = sum(outcome(run) != outcome(before[name]) for name, run in again.items())
    others = sum(run["path"] != before[name]["path"] for name, run in again.items())
    times = [sum(runs[name]["cpu_s"] for name in again) for runs in (again, before)]
    cpu = f"{times[0] / times[1]:.2f}" if times[1] else ""
    told = "nothing" if what is None else what[1] if what[0] in PASSES else f"{what[0]}.{what[1]} = {what[2]}"
    cells = [told, *(str(counts[each]) for each in OUTCOMES), str(changed), str(others), cpu]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("what", nargs="*", default=["passes", "rules"], help="passes, rules, thresholds")
    parser.add_argument("--logs", type=Path, default=Path("../shared/logs"))
    parser.add_argument("--every", type=int, default=29, help="every N-th disturbed log")
    parser.add_argument("--missions", type=int, default=2, help="number of missions")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="a text in the name of what is undone")
    args = parser.parse_args()
    runs = [*names()[:: args.every], *OPEN, *REPORTS, *mission_names(1)[: args.missions]]
    kinds = {"passes": passes, "rules": rules, "thresholds": thresholds}
    wanted = [each for kind in args.what for each in kinds[kind]() if args.only in ".".join(map(str, each))]
    header = ["undone", *OUTCOMES, "other outcome", "other path", "CPU"]
    print(f"{len(runs)} runs", "", "| " + " | ".join(header) + " |", "|" + "---|" * len(header), sep="\n")
    without = partial(runs_without, args.folder, args.logs)
    with ProcessPoolExecutor(args.jobs, max_tasks_per_child=1) as pool:
        before = pool.submit(without, dict.fromkeys(runs), None).result()
        print(row(None, before, before), flush=True)
        done = pool.map(without, ([*affected(what, before)] for what in wanted), wanted)
        for what, again in zip(wanted, done, strict=True):
            print(row(what, again, before), flush=True)


if __name__ == "__main__":
    main()
