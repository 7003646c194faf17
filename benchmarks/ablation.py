"""What each pass, attempt and threshold buys: it is undone alone, and disturbed logs and missions are run again.

    python benchmarks/ablation.py FOLDER [passes] [thresholds] [--logs N] [--missions N] [--jobs N] [--only TEXT]

FOLDER has the disturbed logs that ``disturbed.py make`` wrote; every N-th of them is run. A threshold (a number of a
module of mavnav/slam) is doubled, and halved. The table has for each thing undone the runs by outcome, the change of
their mean error, and the CPU time; what changes no run is a candidate for deletion. Constants of kernels are compiled
and not tried.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import pkgutil
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

from disturbed import LOST, OUTCOMES, names, outcome, read_poses
from doubt_corpus import flown, largest_errors, mission_names

import mavnav.slam
from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Trajectory, correct_path
from mavnav.slam import pipeline
from mavnav.slam.result import SlamResult
from mavnav.units import NS

PASSES = ("ATTEMPTS", "RECOVERING", "CHECKING", "DRAWING")
"""The tuples of the pipeline of which each entry is undone."""

NEEDED = ("refine_against_final_map", "judge_track")
"""Passes without which there is nothing to compare: the evidence, and the doubt."""

Undo = tuple[str, str, float]
"""A module or tuple of the pipeline, a name in it, and the factor on its value; 0 takes it out."""


def passes() -> Iterator[Undo]:
    """Yield the passes and attempts, each to be taken out."""
    for group in PASSES:
        for name in dict.fromkeys(map(name_of, getattr(pipeline, group))):
            if name not in NEEDED:
                yield group, name, 0.0


def name_of(each: Any) -> str:
    """Return the name of a pass or an attempt."""
    return str(getattr(each, "name", None) or each.__name__)


def thresholds() -> Iterator[Undo]:
    """Yield the numbers of the modules of mavnav/slam, each to be doubled and halved."""
    for each in pkgutil.walk_packages(mavnav.slam.__path__, "mavnav.slam."):
        module = importlib.import_module(each.name)
        for name in assigned_names(Path(str(module.__file__))):
            value = getattr(module, name)
            if isinstance(value, int | float) and value and not isinstance(value, bool):
                yield from ((each.name, name, factor) for factor in (2.0, 0.5))


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


def undo(what: Undo | None) -> None:
    """Undo one thing in this process, in all modules that have the name."""
    if what is None:
        return
    where, name, factor = what
    if where in PASSES:
        setattr(pipeline, where, tuple(each for each in getattr(pipeline, where) if name_of(each) != name))
        return
    value = getattr(sys.modules[where], name)
    changed = type(value)(value * factor)
    for module in list(sys.modules.values()):
        if getattr(module, "__name__", "").startswith("mavnav.") and vars(module).get(name) is value:
            setattr(module, name, changed)


def describe(what: Undo | None) -> str:
    """Return what is undone in words."""
    if what is None:
        return "nothing"
    where, name, factor = what
    return name if where in PASSES else f"{where.removeprefix('mavnav.slam.')}.{name} x {factor:g}"


def runs_without(folder: Path, runs: list[str], what: Undo | None) -> dict[str, dict[str, Any]]:
    """Return the outcomes of the runs with one thing undone, by name; to be called in a process of its own."""
    undo(what)
    return {name: fly_mission(name) if name.startswith("mission-") else track_log(folder, name) for name in runs}


def track_log(folder: Path, name: str) -> dict[str, Any]:
    """Track a disturbed log; return errors, doubt and CPU time."""
    log, start_s = open_log(folder / f"{name}.mcap"), process_time()
    odometry = correct_path(log.odometry.odom_T_laser, -round(log.mid_sweep_s / NS)) if log.odometry else None
    slam = pipeline.run_slam(
        log.scans, Config(), log.period_s, odometry, base_T_laser=log.base_T_laser, scans_ns=log.stamps_ns
    )
    return evaluated(slam, read_poses(folder / f"{name.partition('.')[0]}.tum"), process_time() - start_s)


def fly_mission(name: str) -> dict[str, Any]:
    """Fly a mission; return errors, doubt and CPU time."""
    start_s = process_time()
    return evaluated(*flown(name), process_time() - start_s)


def evaluated(slam: SlamResult, truth: Trajectory, cpu_s: float) -> dict[str, Any]:
    """Return a run as ``disturbed.outcome`` takes it."""
    off_m, off_deg = largest_errors(slam.trajectory, truth)
    doubt = slam.doubt.probability if slam.doubt else None
    return {"exit": LOST * slam.lost_for_good, "off_m": off_m, "off_deg": off_deg, "doubt": doubt, "cpu_s": cpu_s}


def row(what: Undo | None, runs: dict[str, dict[str, Any]], before: dict[str, dict[str, Any]]) -> str:
    """Return a row of the table."""
    counts = Counter(map(outcome, runs.values()))
    changed = sum(outcome(runs[name]) != outcome(before[name]) for name in runs)
    same = sum(runs[name]["off_m"] == before[name]["off_m"] for name in runs)
    cpu = sum(run["cpu_s"] for run in runs.values()) / sum(run["cpu_s"] for run in before.values())
    cells = [describe(what), *(str(counts[each]) for each in OUTCOMES), str(changed), str(same), f"{cpu:.2f}"]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("what", nargs="*", choices=("passes", "thresholds"), default=["passes"])
    parser.add_argument("--logs", type=int, default=8, help="every N-th disturbed log")
    parser.add_argument("--missions", type=int, default=1, help="seeds of each mission")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="a text in the name of what is undone")
    args = parser.parse_args()
    runs = [*names()[:: args.logs], *(mission_names(args.missions) if args.missions else ())]
    kinds = {"passes": passes, "thresholds": thresholds}
    wanted: list[Undo | None] = [None]
    wanted += [each for kind in args.what for each in kinds[kind]() if args.only in describe(each)]
    header = ["undone", *OUTCOMES, "outcome changes", "same path", "CPU"]
    print(f"{len(runs)} runs", "| " + " | ".join(header) + " |", "|" + "---|" * len(header), sep="\n")
    with ProcessPoolExecutor(args.jobs, max_tasks_per_child=1) as pool:
        before: dict[str, dict[str, Any]] = {}
        for what, done in zip(wanted, pool.map(partial(runs_without, args.folder, runs), wanted), strict=True):
            before = before or done
            print(row(what, done, before), flush=True)


if __name__ == "__main__":
    main()
