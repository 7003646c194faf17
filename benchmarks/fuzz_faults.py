"""Check the effects of a failing disk: every file operation of every command fails once.

    python benchmarks/fuzz_faults.py [--seconds S] [--count N] [--commands NAME ...]

Opening for writing, writing, fsync, rename, mkdir and writing to stdout fail at the n-th operation, for every n: with
ENOSPC from there on, or with EIO once. After each fault the exit code, the message and the files are checked, and the
command is run again. Without a fault, no file may be renamed before its content is synced. Problems are counted, and
must be 0: incomplete results, wrong exit codes or messages, and later runs that fail.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.faults import faults_of, spread, trials

COMMANDS = 9
SAMPLE = Path(__file__).parent.parent / "sample_logs" / "corridor.mcap"


def main() -> int:
    """Print a line per command, and every problem; return 1 if there are problems."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after this time")
    parser.add_argument("--count", type=int, default=10**6, help="faults per command")
    parser.add_argument("--commands", nargs="*", default=[])
    options = parser.parse_args()
    began_s, total, problems = time.monotonic(), 0, 0
    with tempfile.TemporaryDirectory() as name:
        count = len(options.commands) or COMMANDS
        for number, trial in enumerate(trials(Path(name), SAMPLE, options.commands), 1):
            done, found = 0, 0
            for fail_at in spread(trial.steps, options.count):
                if time.monotonic() - began_s > options.seconds * number / count:
                    break
                done += 1
                for problem in faults_of(trial, fail_at):
                    found += 1
                    print(f"  {problem}")
            print(f"{trial.name:16s} {trial.steps:4d} operations, {done:4d} faults, {found} problems", flush=True)
            total, problems = total + done, problems + found
    print(f"{total} faults, {problems} problems, {time.monotonic() - began_s:.0f} s")
    return int(problems > 0)


if __name__ == "__main__":
    sys.exit(main())
