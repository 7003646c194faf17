"""Measure scans per second of CPU time, and memory, of the whole program.

    python benchmarks/replays.py [LOG ...] [--rounds N] [--row TEXT] [--output FILE.json]
    python benchmarks/replays.py [LOG] --start [ARGUMENT ...]

Each row is the command ``mavnav replay LOG`` with all its outputs, in a process of its own on one core. Start-up
(imports, kernels from the disk, pictures) is the same command on a log of the first second only; its time and its scans
are subtracted. The rate uses the minimum of the rounds. Two other rates are printed: the median of the rounds, each run
less the start-up right before it, and the rate less only the imports of an empty process. The rows of a round
alternate. Because machines differ, times are also given as multiples of a fixed workload timed in the same run, and
these are compared with the results in replays.json.

The second form prints where the time of a start goes, that of a replay of the first second or of another command line:
the time of importing each package without what it imports, those of mavnav by their second name, then the stages of the
replay. Each is the minimum of the rounds, by the clock, which on an idle machine is that of the processor.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from itertools import chain
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from mavnav.logs import open_log
from mavnav.logs.messages import cdr, definitions
from mavnav.logs.writing.mcap_writer import OutputChannel, write_serialized

HERE = Path(__file__).parent
SAMPLE = HERE.parent / "sample_logs" / "corridor.mcap"
KEPT = HERE / "replays.json"
ROWS = {
    "robust 20 / 10x10": [],
    "robust 40 / 40x40": ["--grid", "40x40", "--azimuth", "40"],
    "robust 20 / 10x10, exhaustive": ["--search", "exhaustive"],
    "paper 20 / 10x10": ["--method", "paper"],
}

LONGEST = 24
"""Number of packages and of stages that are printed of a start."""


def run(log: Path, options: list[str], directory: str) -> tuple[float, float, dict[str, Any]]:
    """Replay a log; return CPU time in s, peak memory in MB and the document of the run."""
    command = [sys.executable, "-m", "mavnav", "replay", str(log), "--odom", "off", "-q", "--force", "-o", directory]
    process = os.posix_spawn(
        sys.executable,
        [*command, *options],
        environment(),
        file_actions=[(os.POSIX_SPAWN_OPEN, fd, os.devnull, os.O_WRONLY, 0) for fd in (1, 2)],
    )
    _, status, usage = os.wait4(process, 0)
    document = json.loads(Path(directory, "run.json").read_text())
    if os.waitstatus_to_exitcode(status) not in (0, 3, 5):
        sys.exit(f"{' '.join(command + options)} failed")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, document


def environment() -> dict[str, str]:
    """Return the environment of a process on one core that caches compiled modules, as an installed program does."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def cut(log: Path, path: Path) -> None:
    """Write a log with the scans of the first second."""
    found, write = open_log(log, odom="off", end_s=1.0), cdr.scans("laser")
    with write_serialized(path, {"/scan": OutputChannel(definitions.SCAN)}) as put:
        for scan in found.scans():
            put("/scan", scan.stamp_ns, write(scan))


def imports_s() -> float:
    """Return the CPU time of a process that only imports the program, in s."""
    command = [sys.executable, "-c", "import mavnav.cli, mavnav.pipelines.replay, mavnav.outputs.pictures.map_picture"]
    _, _, usage = os.wait4(os.posix_spawn(sys.executable, command, environment()), 0)
    return usage.ru_utime + usage.ru_stime


def reference_s() -> float:
    """Return the CPU time of the fixed workload, sorting, rounding and counting numbers, in s."""
    values = np.random.default_rng(0).random(1_000_000)
    began_s = process_time()
    for _ in range(5):
        np.bincount((np.sort(values) * 1000).astype(np.int64))
    return process_time() - began_s


def measured(logs: list[Path], rounds: int, wanted: str) -> dict[str, Any]:
    """Measure the rows whose names begin with ``wanted``, in alternation."""
    cases = [(log, name) for log in logs for name in ROWS if name.startswith(wanted)]
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    references, imports = [], []
    with tempfile.TemporaryDirectory() as directory:
        firsts = {log: Path(directory, f"first-{k}.mcap") for k, log in enumerate(logs)}
        for log, path in firsts.items():
            cut(log, path)
        for _ in range(rounds):
            references.append(reference_s())
            imports.append(imports_s())
            for log, name in cases:
                start_s, _, first = run(firsts[log], ROWS[name], f"{directory}/run")
                spent_s, memory_mb, document = run(log, ROWS[name], f"{directory}/run")
                row = rows.setdefault((log.name, name), {"cpu_s": [], "start_s": []})
                row["cpu_s"].append(spent_s)
                row["start_s"].append(start_s)
                row["memory_mb"], row["scans"] = round(memory_mb), document["scans"]["processed"]
                row["first_scans"] = first["scans"]["processed"]
                row["evaluations_per_scan"] = round(document["search"]["evaluations_per_scan"]["mean"])
    unit_s = min(references)
    for row in rows.values():
        spent_s, start_s, scans = row["cpu_s"], row["start_s"], row["scans"] - row["first_scans"]
        net_s = min(spent_s) - min(start_s)
        row["scans_per_cpu_s"] = round(scans / net_s)
        row["scans_per_cpu_s_median"] = round(scans / float(np.median(np.subtract(spent_s, start_s))))
        row["scans_per_cpu_s_less_imports"] = round(row["scans"] / (min(spent_s) - min(imports)))
        row["units_per_1000_scans"] = round(net_s / unit_s / scans * 1000, 2)
        row["cpu_s"], row["start_s"] = round(min(spent_s), 2), round(min(start_s), 2)
    machine = {"processor": processor(), "cores": os.cpu_count(), "python": platform.python_version()}
    return {
        "machine": machine,
        "unit_s": round(unit_s, 4),
        "rows": {f"{log}: {name}": r for (log, name), r in rows.items()},
    }


def import_ms(arguments: list[str]) -> dict[str, float]:
    """Return the time of importing packages in a run of the program, ms; raises CalledProcessError if that fails."""
    command = [sys.executable, "-X", "importtime", "-m", "mavnav", *arguments]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)
    spent: dict[str, float] = {}
    for line in done.stderr.splitlines():
        own, _, module = line.removeprefix("import time:").split("|") if line.count("|") == 2 else ("", "", "")
        if own.strip().isdecimal():
            package, *rest = module.strip().split(".")
            name = "Python" if package.lstrip("_") in sys.stdlib_module_names else package
            name = ".".join((name, *rest[:1])) if name == "mavnav" else name
            spent[name] = spent.get(name, 0.0) + 1e-3 * int(own)
    return spent


def print_start(log: Path, arguments: list[str], rounds: int) -> None:
    """Print the packages and the stages of a start that take longest."""
    imports, stages = [], []
    with tempfile.TemporaryDirectory() as directory:
        command = arguments or ["replay", str(log), "--end", "1", "-q", "--force", "-o", directory]
        for _ in range(rounds):
            imports.append(import_ms(command))
            if not arguments:
                timing = json.loads(Path(directory, "run.json").read_text())["timing"]
                stages.append({f"stage {name}": 1e3 * spent_s for name, spent_s in timing["stages"].items()})
    for times in (imports, stages):
        least = {name: min(each.get(name, 0.0) for each in times) for name in {*chain(*times)}}
        for name, spent_ms in sorted(least.items(), key=lambda item: -item[1])[:LONGEST]:
            print(f"{name:24}{spent_ms:8.1f} ms")
        print(f"{'sum':24}{sum(least.values()):8.1f} ms")


def processor() -> str:
    """Return the name of the processor."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def table(now: dict[str, Any], before: dict[str, Any]) -> str:
    """Return the table of the rows, with the work per scan relative to the kept results."""
    lines = [f"{'':45} scans/CPU-s  median  less imports  start-up s  MB  evaluations  against kept"]
    for name, row in now["rows"].items():
        kept = before.get("rows", {}).get(name)
        ratio = f"{row['units_per_1000_scans'] / kept['units_per_1000_scans']:.2f}" if kept else "-"
        lines.append(
            f"{name:45} {row['scans_per_cpu_s']:11} {row['scans_per_cpu_s_median']:7} "
            f"{row['scans_per_cpu_s_less_imports']:13} "
            f"{row['start_s']:11} {row['memory_mb']:4} "
            f"{row['evaluations_per_scan']:11}  {ratio}"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure what the arguments ask for, and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path, default=[SAMPLE])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--row", default="", help="measure only rows whose name begins so")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--start", nargs=argparse.REMAINDER, help="print where the time of a start goes")
    args = parser.parse_args()
    if args.start is not None:
        print_start(args.logs[0], args.start, args.rounds)
        return
    now = measured(args.logs, args.rounds, args.row)
    print(table(now, json.loads(KEPT.read_text()) if KEPT.exists() else {}))
    if args.output:
        args.output.write_text(json.dumps(now, indent=1) + "\n")


if __name__ == "__main__":
    main()
