"""How well and at what cost do sessions join? Simulated floors with known poses, and real logs that are cut.

    python benchmarks/sessions.py floor [--seeds N]        five overlapping sessions of a floor, ATE against the truth
    python benchmarks/sessions.py buildings [--seeds N]    two sessions each of different buildings: none may join
    python benchmarks/sessions.py many [--sessions N]      cost of many short sessions in two rooms
    python benchmarks/sessions.py cut LOG [--parts N] [--gap SECONDS]    a log in parts, merged and continued

Every command runs in a process of its own: processor time and peak memory are those that the system reports.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from mavnav import Log, open_log
from mavnav.ground_truth.tables import read_tum
from mavnav.outputs.files.gridmap import read_npz
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec
from support.log_files import LASER, Message, write_mcap
from support.sessions import TOURS as ROOM_TOURS
from support.sessions import tour as rooms_tour
from support.sessions import written
from support.synthetic import Recording, along, box, polyline, record

SPEC = LaserSpec(-np.pi * 3 / 4, np.pi / 240, 361, 0.1, 12.0, 0.0, 0.1)
"""270 degrees in 361 beams, 12 m, 10 Hz."""

LONG_M, DEEP_M, ROOM_M, WIDE_M, SPEED_M_S = 24.0, 12.5, 6.0, 2.0, 0.6
LOW_M, HIGH_M = 0.5 * (DEEP_M - WIDE_M), 0.5 * (DEEP_M + WIDE_M)
WALL_M, LEAST_HITS, SAME_WALL_M = 0.07, 3, 0.2
TOURS = ((0, 1, 4), (1, 2, 5), (2, 6, 3), (4, 5, 6), (3, 7, 6))
"""Rooms that the sessions visit, the first is where each begins: 0 to 3 below the corridor, 4 to 7 above it."""


class Used(NamedTuple):
    """What a command took: exit code, processor time in s, peak memory in MB, and what it printed."""

    code: int
    cpu_s: float
    peak_mb: float
    text: str


def door_m(room: int, seed: int) -> float:
    """Return the middle of the door of a room along the corridor, m."""
    return ROOM_M * (room % 4) + float(np.random.default_rng([seed, room]).uniform(1.0, 5.0))


def floor(seed: int) -> np.ndarray:
    """Return the walls of eight furnished rooms on both sides of a corridor, (n, 4), m."""
    rng = np.random.default_rng(seed)
    walls = [polyline((0, 0), (LONG_M, 0), (LONG_M, DEEP_M), (0, DEEP_M), closed=True)]
    for room in range(8):
        x_m, side_m, wall_m = ROOM_M * (room % 4), (0.0, DEEP_M)[room // 4], (LOW_M, HIGH_M)[room // 4]
        door, inward = door_m(room, seed), (1, -1)[room // 4]
        walls += [polyline((x_m, wall_m), (door - 0.5, wall_m)), polyline((door + 0.5, wall_m), (x_m + ROOM_M, wall_m))]
        walls += [polyline((x_m, side_m), (x_m, wall_m))] if x_m else []
        for at in rng.uniform(0.6, ROOM_M - 0.6, rng.integers(2, 5)):
            size, turn = rng.uniform(0.3, 1.2, 2), rng.uniform(-0.6, 0.6)
            walls.append(box(x_m + at, side_m + inward * rng.uniform(0.4, 1.1), *size, turn))
    sides_m = rng.choice((LOW_M + 0.2, HIGH_M - 0.2), 4)
    walls += [box(x, y, 0.4, 0.3) for x, y in zip(rng.uniform(1, 23, 4), sides_m, strict=True)]
    return np.vstack(walls)


def tour(rooms: tuple[int, ...], seed: int) -> Trajectory:
    """Return the true poses of a visit to some rooms, out of each to the corridor and into the next."""
    way: list[tuple[float, float]] = []
    for room in rooms:
        inward, wall_m = (-1, 1)[room // 4], (LOW_M, HIGH_M)[room // 4]
        x_m, middle = door_m(room, seed), ROOM_M * (room % 4) + 3.0
        inside = [(x_m, wall_m - inward * 0.7), (x_m, wall_m + inward * 0.6)]
        far = [(middle - 1.2, wall_m + inward * 2.2), (middle + 1.2, wall_m + inward * 2.6)]
        way += [*inside, *far, *reversed(inside)] if way else [*far, *reversed(inside)]
    return along(way, 0.1, SPEED_M_S, 1.5)


def recorded(walls: np.ndarray, rooms: tuple[int, ...], seed: int, noise_seed: int, path: Path) -> Recording:
    """Record a session and write it as a log."""
    found = record(walls, tour(rooms, seed), SPEC, noise=0.01, seed=noise_seed)
    about = {"angle_min": SPEC.angle_min_rad, "angle_increment": SPEC.angle_step_rad, "range_max": SPEC.range_max_m}
    write_mcap(path, [Message("/scan", LASER, s.stamp_ns, about | {"ranges": s.ranges_m}) for s in found.scans])
    return found


def mavnav(*args: object) -> Used:
    """Run a command in a process of its own."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        with out.open("w") as sink:
            child = subprocess.Popen([sys.executable, "-m", "mavnav", *map(str, args), "-q"], stdout=sink, stderr=sink)
            _, status, usage = os.wait4(child.pid, 0)
        code = os.waitstatus_to_exitcode(status)
        return Used(code, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, out.read_text())


def ate_m(estimated: list[Trajectory], true: list[Trajectory]) -> float:
    """Return the RMS distance of poses from the truth after the best motion of all of them together."""
    rows = [np.searchsorted(t.stamps_ns, e.stamps_ns) for e, t in zip(estimated, true, strict=True)]
    p = np.concatenate([e.xyyaw[:, :2] for e in estimated])
    q = np.concatenate([t.xyyaw[row, :2] for t, row in zip(true, rows, strict=True)])
    p, q = p - p.mean(axis=0), q - q.mean(axis=0)
    turn = np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum())
    turned = p @ np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
    return float(np.sqrt(((turned - q) ** 2).sum(axis=1).mean()))


def merged(logs: list[Path], folder: Path) -> tuple[dict[str, Any], Used, list[Used]]:
    """Replay logs one by one and merge the runs; return merge.json, and what the merge and the replays took."""
    replays = [mavnav("replay", log, "-o", folder / f"run{k}", "--force") for k, log in enumerate(logs)]
    used = mavnav("merge", *(folder / f"run{k}" for k in range(len(logs))), "-o", folder / "merged", "--force")
    if not (folder / "merged" / "merge.json").is_file():
        sys.exit(used.text)
    return json.loads((folder / "merged" / "merge.json").read_text()), used, replays


def floors(seeds: range) -> None:
    """Merge five sessions of a floor each."""
    for seed in seeds:
        with TemporaryDirectory() as name:
            folder, walls = Path(name), floor(seed)
            logs = [folder / f"s{k}.mcap" for k in range(len(TOURS))]
            truth = [
                recorded(walls, rooms, seed, 10 * seed + k, log).world_T_laser
                for k, (rooms, log) in enumerate(zip(TOURS, logs, strict=True))
            ]
            document, used, replays = merged(logs, folder)
            alone = [ate_m([read_tum(folder / f"run{k}" / "trajectory.tum")], [truth[k]]) for k in range(len(logs))]
            inside = [k for k, row in enumerate(document["sessions"]) if row["joined"]]
            union = [read_tum(folder / "merged" / document["sessions"][k]["trajectory"]) for k in inside]
            each = [ate_m([path], [truth[k]]) for k, path in zip(inside, union, strict=True)]
            whole = ate_m(union, [truth[k] for k in inside])
            against = sum(row["contradicting"] for row in document["sessions"])
            print(
                f"seed {seed}: {len(inside)} of {len(logs)} joined, ATE alone {mm(alone)}, in the union {mm(each)}, "
                f"as a whole {1e3 * whole:.0f} mm, {against} key frames contradict; {cost(used, replays)}",
                flush=True,
            )


def mm(values_m: list[float]) -> str:
    """Write the least and the largest of some lengths."""
    return f"{1e3 * min(values_m):.0f} to {1e3 * max(values_m):.0f}"


def cost(used: Used, replays: list[Used]) -> str:
    """Compare what a merge of runs took with the replays before it."""
    cpu_s, peak_mb = sum(r.cpu_s for r in replays), max(r.peak_mb for r in replays)
    return (
        f"merge {used.cpu_s:.1f} CPU-s, {used.cpu_s / cpu_s:.2f} times the replays ({cpu_s:.1f}); "
        f"{used.peak_mb:.0f} MB, {used.peak_mb / peak_mb:.2f} times the largest replay"
    )


def buildings(seeds: range) -> None:
    """Merge two sessions of a floor with two of another one: two must be left out, and it must be said why."""
    for seed in seeds:
        with TemporaryDirectory() as name:
            folder, logs = Path(name), []
            for k, (building, rooms) in enumerate([(seed, 0), (seed, 1), (seed + 100, 0), (seed + 100, 2)]):
                logs.append(folder / f"s{k}.mcap")
                recorded(floor(building), TOURS[rooms], building, 10 * seed + k, logs[-1])
            document, _, _ = merged(logs, folder)
            joined = "".join("j" if row["joined"] else "-" for row in document["sessions"])
            why = {row["why"] for row in document["sessions"] if row["why"]}
            print(f"seed {seed}: {joined}, exit code {document['exit_code']}, {'; '.join(sorted(why))}", flush=True)


def many(count: int) -> None:
    """Merge many short sessions in two rooms."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        logs = [folder / f"s{k}.mcap" for k in range(count)]
        for k, log in enumerate(logs):
            written(rooms_tour(list(ROOM_TOURS)[k % len(ROOM_TOURS)], k), log)
        for some in (logs[: count // 2], logs):
            used = mavnav("merge", *some, "-o", folder / "merged", "--force", "--json")
            document = json.loads((folder / "merged" / "merge.json").read_text())
            sizes = f"{document['joined']} of {len(some)} joined, {document['scans']} scans"
            print(f"{sizes}: {used.cpu_s:.1f} CPU-s, {used.peak_mb:.0f} MB", flush=True)


class Walls(NamedTuple):
    """Pieces of the walls of a map: the middle of the hits near each occupied cell (n, 2), m, and its direction."""

    xy_m: np.ndarray
    normals: np.ndarray


def walls_of(run: Path) -> Walls:
    """Return the walls of a run to a fraction of a cell: lines through the hits within ``WALL_M`` of occupied cells."""
    grid = read_npz(run / "hits.npz")
    row, col = np.nonzero(grid.hits)
    xy_m = (np.column_stack((col, row)) + 0.5) * grid.cell_m + np.array(grid.origin_xy_m)
    hits, tree = grid.hits[row, col].astype(float), cKDTree(xy_m)
    middles, normals = [], []
    for near in tree.query_ball_point(xy_m[hits >= LEAST_HITS], WALL_M):
        w, p = hits[near], xy_m[near]
        middle = (w[:, None] * p).sum(axis=0) / w.sum()
        across, along_m2 = np.linalg.eigh(((p - middle).T * w) @ (p - middle) / w.sum())
        if across[0] < 0.2 * across[1]:
            middles.append(middle)
            normals.append(along_m2[:, 0])
    return Walls(np.array(middles), np.array(normals))


def wall_distances_mm(walls: Walls, whole: Walls) -> np.ndarray:
    """Return the distance of each piece of wall from that of the whole next to it, across the wall."""
    off_m, at = cKDTree(whole.xy_m).query(walls.xy_m)
    off = ((walls.xy_m - whole.xy_m[at]) * whole.normals[at]).sum(axis=1)
    return 1e3 * np.abs(off[off_m < SAME_WALL_M])


def compared(run: Path, paths: list[Path], whole: Path) -> str:
    """Compare trajectories and map with those of the whole log."""
    truth = read_tum(whole / "trajectory.tum")
    poses = [read_tum(path) for path in paths]
    stamps = np.concatenate([p.stamps_ns for p in poses])
    xy, known = np.concatenate([p.xyyaw[:, :2] for p in poses]), np.isin(stamps, truth.stamps_ns)
    at = np.searchsorted(truth.stamps_ns, stamps[known])
    off_mm = 1e3 * np.hypot(*(xy[known] - truth.xyyaw[at, :2]).T)
    walls_mm = wall_distances_mm(walls_of(run), walls_of(whole))
    return (
        f"poses {np.sqrt((off_mm**2).mean()):.1f} mm RMS, {off_mm.max():.1f} at most; "
        f"walls {walls_mm.mean():.1f} mm mean, {np.percentile(walls_mm, 95):.1f} p95"
    )


def cut(path: Path, parts: int, gap_s: float) -> None:
    """Replay a log as a whole, then in parts: merged with gaps, and continued one after another."""
    log: Log = open_log(path)
    edges = np.linspace(0.0, log.duration_s, parts + 1)
    with TemporaryDirectory() as name:
        folder = Path(name)
        whole = mavnav("replay", path, "-o", folder / "whole")
        used, runs = [], [folder / f"run{k}" for k in range(parts)]
        for k, run in enumerate(runs):
            window = ("--start", edges[k] + gap_s * (k > 0), *(("--end", edges[k + 1]) if k + 1 < parts else ()))
            used.append(mavnav("replay", path, *window, "-o", run))
        merge = mavnav("merge", *runs, "-o", folder / "merged")
        print(f"{path.name}: whole {whole.cpu_s:.1f} CPU-s; merged: exit {merge.code}, {cost(merge, used)}")
        if merge.code in {0, 3, 5}:
            document = json.loads((folder / "merged" / "merge.json").read_text())
            paths = [folder / "merged" / row["trajectory"] for row in document["sessions"] if row["joined"]]
            print(f"  merged: {compared(folder / 'merged', paths, folder / 'whole')}")
            print(f"  closures {[row['closures'] for row in document['sessions']]}")
        continued(path, [*pairwise(edges)], folder, runs[0], used)


def continued(path: Path, windows: list[tuple[float, float]], folder: Path, run: Path, replays: list[Used]) -> None:
    """Continue the run of the first part with one part after another, and compare the last run with the whole."""
    before = {file.name: file.read_bytes() for file in run.iterdir()}
    used, last = [], run
    for k, (start_s, end_s) in enumerate(windows[1:], start=1):
        following = folder / f"continued{k}"
        window = ("--start", start_s, *(("--end", end_s) if k + 1 < len(windows) else ()))
        used.append(mavnav("replay", path, *window, "--continue", last, "-o", following))
        last = following
    if any(each.code not in {0, 3} for each in used):
        print(f"  continued: exit codes {[each.code for each in used]}, {used[-1].text}")
        return
    paths = [*sorted(last.glob("session_*.tum")), last / "trajectory.tum"]
    same = before == {file.name: file.read_bytes() for file in run.iterdir()}
    print(f"  continued: {compared(last, paths, folder / 'whole')}; first run {'unchanged' if same else 'CHANGED'}")
    joins = [json.loads((folder / f"continued{k}" / "run.json").read_text()) for k in range(1, len(windows))]
    evidence = [(d["continued"]["evidence"]["after"], d["continued"]["evidence"]["closures"]) for d in joins]
    costs = [f"{each.cpu_s / alone.cpu_s:.2f}" for each, alone in zip(used, replays[1:], strict=True)]
    print(f"  placed after, closures: {evidence}; CPU-s as a multiple of a replay alone: {', '.join(costs)}")


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("floor", "buildings", "many", "cut"))
    parser.add_argument("log", nargs="?", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--sessions", type=int, default=30)
    parser.add_argument("--parts", type=int, default=2)
    parser.add_argument("--gap", type=float, default=0.0)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    if args.what == "cut":
        cut(args.log, args.parts, args.gap)
    elif args.what == "many":
        many(args.sessions)
    else:
        {"floor": floors, "buildings": buildings}[args.what](seeds)


if __name__ == "__main__":
    main()
