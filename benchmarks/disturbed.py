"""Compare versions of mavnav on recorded logs that are disturbed: cut, thinned, noisy, masked, short of range.

    python benchmarks/disturbed.py make FOLDER [--logs FOLDER]
    python benchmarks/disturbed.py run FOLDER RUNS.jsonl --mavnav COMMAND [--jobs N] [--only TEXT]
    python benchmarks/disturbed.py table BEFORE.jsonl AFTER.jsonl

``make`` writes every disturbed log once, and the tracks of the undisturbed ones. ``run`` replays the logs that RUNS
does not have yet with any installed version. ``table`` counts the runs by kind and by log, and names those that
changed. The name of a run is ``LOG.KIND.LEVEL.SEED``; even seeds are without odometry, odd ones with that of the log,
if it has any. A run is wrong as in ``doubt.py``; marked if its doubt is high.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from doubt import is_wrong
from doubt_corpus import LOGS, Case, disturbed, largest_errors

from mavnav.logs import open_log
from mavnav.logs.log import Log
from mavnav.logs.messages import cdr, definitions
from mavnav.logs.writing.mcap_writer import OutputChannel, write_serialized
from mavnav.outputs.files.trajectory import write_poses
from mavnav.pose import Pose, Trajectory
from mavnav.scan import Scan
from mavnav.slam.findings import HIGH

Run = dict[str, Any]

PARTS = {
    "ccny_demo": (0.0, 25.0),
    "lego_robot4": (0.0, 40.0),
    "urg_exp1": (0.0, 25.0),
    "turtlebot4_mac2": (0.0, 25.0),
    "slambot_rplidar": (0.0, 35.0),
    "fr079": (0.0, 45.0),
    "fr079b": (300.0, 340.0),
    "kidnap_expt09": (0.0, 25.0),
    "wean_1": (0.0, 40.0),
    "wean_1b": (80.0, 120.0),
    "wean_4": (0.0, 40.0),
    "rss26_t1r": (None, None),
    "rss26_loopfast": (None, None),
}
"""Name of a log in ``doubt_corpus.LOGS`` -> start and end of the part that is used here, s."""

KINDS: dict[str, tuple[float, ...]] = {
    "cut": (1.0, 2.0, 3.0),
    "drop": (0.2, 0.35, 0.5),
    "every": (2, 4, 8),
    "noise": (0.02,),
    "mask": (0, 1, 2),
    "far": (0.5, 0.75),
    "short": (0.1,),
}
"""Kinds of disturbance, as ``doubt_corpus`` makes them, with their levels."""

SEEDS = 2
OUTCOMES = ("right", "right, marked", "wrong, marked", "exit 5", "silently wrong")
LOST = 5
"""The exit code of a log that is lost for good."""


def names() -> list[str]:
    """Return the names of all runs."""
    return [
        f"{log}.{kind}.{level:g}.{seed}"
        for seed in range(SEEDS)
        for kind, levels in KINDS.items()
        for level in levels
        for log in PARTS
    ]


def make(folder: Path, logs: Path) -> None:
    """Write the disturbed logs, and the tracks of the undisturbed ones."""
    for log, (start_s, end_s) in PARTS.items():
        opened = open_log(logs / LOGS[log][0], start_s=start_s, end_s=end_s)
        scans = list(opened.scans())
        undisturbed = Case(scans, opened.period_s, opened.odom_T_laser, Trajectory.of([], []), opened.base_T_laser)
        write_poses(undisturbed.track().trajectory, folder / f"{log}.tum")
        for name in (name for name in names() if name.startswith(f"{log}.")):
            kind, level, seed = parts_of(name)
            some, _ = disturbed(scans, opened.period_s, kind, level, seed)
            write_log(folder / f"{name}.mcap", opened, some, with_odometry=seed % 2 == 1)


def parts_of(name: str) -> tuple[str, float, int]:
    """Return kind, level and seed of a run."""
    _, kind, rest = name.split(".", 2)
    level, _, seed = rest.rpartition(".")
    return kind, float(level), int(seed)


def write_log(path: Path, log: Log, scans: list[Scan], *, with_odometry: bool) -> None:
    """Write scans as a log, with mounting and odometry of another one."""
    stamped = [(scan.stamp_ns, "/scan", cdr.scans("laser")(scan)) for scan in scans]
    mounting, to_base = cdr.transforms("base_link", "laser"), cdr.transforms("odom", "base_link")
    stamped.append((scans[0].stamp_ns, "/tf_static", mounting(scans[0].stamp_ns, log.base_T_laser or Pose())))
    if with_odometry and log.odometry:
        poses = log.odometry.odom_T_base
        stamped += [(ns, "/tf", to_base(ns, poses[k])) for k, ns in enumerate(poses.stamps_ns.tolist())]
    tf = OutputChannel(definitions.TF)
    channels = {"/tf_static": OutputChannel(definitions.TF, latched=True), "/tf": tf}
    with write_serialized(path, {**channels, "/scan": OutputChannel(definitions.SCAN)}) as put:
        for stamp_ns, topic, message in sorted(stamped, key=lambda item: item[0]):
            put(topic, stamp_ns, message)


def replay(folder: Path, out: Path, command: list[str], name: str) -> Run:
    """Replay a log; return the exit code, errors, doubt and CPU time of the run."""
    directory = out / name
    options = ["-q", "--force", "--outputs", "trajectory", "-o", str(directory)]
    with subprocess.Popen(
        [*command, "replay", str(folder / f"{name}.mcap"), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    run: Run = {"name": name, "exit": process.returncode, "cpu_s": round(usage.ru_utime + usage.ru_stime, 2)}
    if process.returncode not in (0, LOST):
        return run
    record = json.loads((directory / "run.json").read_text(encoding="utf-8"))
    reference = read_poses(folder / f"{name.partition('.')[0]}.tum")
    off_m, off_deg = largest_errors(read_poses(directory / "trajectory.tum"), reference)
    tracked, doubt = record["tracking"]["tracked_share"], record["tracking"]["doubt"]
    return {**run, "off_m": off_m, "off_deg": off_deg, "tracked": tracked, "doubt": doubt and doubt["probability"]}


def read_poses(path: Path) -> Trajectory:
    """Read a TUM file with the nanoseconds of its stamps."""
    rows = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
    stamps = [int(row[0].replace(".", "")) for row in rows]
    values = np.array([row[1:] for row in rows], dtype=np.float64).reshape(-1, 7)
    yaws = 2.0 * np.arctan2(values[:, 5], values[:, 6])
    return Trajectory(np.array(stamps, dtype=np.int64), np.column_stack((values[:, :2], yaws)))


def read(file: Path) -> dict[str, Run]:
    """Read the runs of a file by name."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return {run["name"]: run for run in map(json.loads, lines)}


def collect(folder: Path, file: Path, command: list[str], jobs: int, only: str) -> None:
    """Replay the logs that are missing in a file, and append their runs."""
    there = read(file)
    wanted = [name for name in names() if only in name and name not in there]
    with ThreadPoolExecutor(jobs) as pool, file.open("a", encoding="utf-8") as out:
        for run in pool.map(partial(replay, folder, file.with_suffix(""), command), wanted):
            out.write(json.dumps(run) + "\n")
            out.flush()


def outcome(run: Run) -> str:
    """Return which of the outcomes a run has."""
    if run["exit"]:
        return "exit 5" if run["exit"] == LOST else f"exit {run['exit']}"
    marked = (run["doubt"] or 0.0) > HIGH
    if is_wrong(run):
        return "wrong, marked" if marked else "silently wrong"
    return "right, marked" if marked else "right"


def grouped(runs: list[Run]) -> Iterator[tuple[str, list[Run]]]:
    """Yield all runs, then those of every kind, of every log, without and with odometry."""
    yield "all", runs
    keys: tuple[Callable[[str], str], ...] = (
        lambda name: parts_of(name)[0],
        lambda name: name.partition(".")[0],
        lambda name: "with odometry" if name.endswith("1") else "without odometry",
    )
    for key in keys:
        for value in sorted({key(run["name"]) for run in runs}):
            yield value, [run for run in runs if key(run["name"]) == value]


def table(before: dict[str, Run], after: dict[str, Run]) -> None:
    """Print the outcomes by kind and log, before and after, and the runs that changed."""
    both = [name for name in before if name in after]
    print("| runs | number | " + " | ".join(OUTCOMES) + " | CPU, s |\n|" + "---|" * (len(OUTCOMES) + 3))
    for what, some in grouped([before[name] for name in both]):
        counts = [Counter(outcome(v[run["name"]]) for run in some) for v in (before, after)]
        cells = [f"{counts[0][o]} -> {counts[1][o]}" for o in OUTCOMES]
        cpu = [sum(v[run["name"]]["cpu_s"] for run in some) for v in (before, after)]
        print(f"| {what} | {len(some)} | " + " | ".join(cells) + f" | {cpu[0]:.0f} -> {cpu[1]:.0f} |")
    print()
    for name in both:
        was, now = outcome(before[name]), outcome(after[name])
        if was != now:
            print(f"{name:32} {was} -> {now}  {describe(before[name])} -> {describe(after[name])}")


def describe(run: Run) -> str:
    """Return the errors of a run, its doubt and the share of scans with a pose."""
    if "off_m" not in run:
        return f"exit {run['exit']}"
    return f"{run['off_m']:.2f} m {run['off_deg']:.1f} deg, doubt {run['doubt'] or 0.0:.2f}, {run['tracked']:.0%}"


def main() -> None:
    """Make the logs, replay them, or compare runs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("make", "run", "table"))
    parser.add_argument("paths", type=Path, nargs="+")
    parser.add_argument("--logs", type=Path, default=Path("../shared/logs"))
    parser.add_argument("--mavnav", default="mavnav")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    if args.action == "make":
        args.paths[0].mkdir(parents=True, exist_ok=True)
        make(args.paths[0], args.logs)
    elif args.action == "run":
        folder, file = args.paths
        collect(folder, file, shlex.split(args.mavnav), args.jobs, args.only)
    else:
        table(*map(read, args.paths))


if __name__ == "__main__":
    main()
