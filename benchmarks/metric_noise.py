"""How far the measures of ``mavnav compare`` differ between equally good recordings: the shares in ``QUANTITIES``.

    python benchmarks/metric_noise.py make FOLDER [--logs FOLDER]
    python benchmarks/metric_noise.py table FOLDER

``make`` leaves a random tenth of the readings out of every log, several times, and compares the three grids of the
paper on each of these samples. ``table`` prints, for every measure, by how much the difference between two grids
differs from one sample to another: the median and the 95 % quantile over logs, samples and pairs of grids, as shares
of the measure. A difference of no more than the quantile says nothing about the grids.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from disturbed import write_log
from doubt_corpus import LOGS
from msgspec.structs import replace

from mavnav.logs import open_log
from mavnav.outputs.documents.quantities import QUANTITIES

PARTS = {
    "ccny_demo": (0.0, 20.0),
    "lego_robot4": (0.0, 25.0),
    "urg_exp1": (0.0, 25.0),
    "turtlebot4_mac2": (0.0, 20.0),
    "fr079": (0.0, 40.0),
    "wean_1": (0.0, 40.0),
    "wean_4": (0.0, 40.0),
    "rss26_t1r": (None, None),
}
"""Name of a log in ``doubt_corpus.LOGS`` -> start and end of the part that is used here, s."""

SAMPLES = 5
LEFT_OUT = 0.1
GRIDS = ("5x5", "10x10", "20x20")


def make(folder: Path, logs: Path) -> None:
    """Write the samples of every log, and compare the grids on each."""
    for log, (start_s, end_s) in PARTS.items():
        opened = open_log(logs / LOGS[log][0], start_s=start_s, end_s=end_s)
        scans = list(opened.scans())
        for seed in range(SAMPLES):
            rng = np.random.default_rng(seed)
            kept = [rng.random(scan.ranges_m.size) >= LEFT_OUT for scan in scans]
            some = [replace(s, ranges_m=np.where(k, s.ranges_m, np.nan)) for s, k in zip(scans, kept, strict=True)]
            path = folder / f"{log}.{seed}.mcap"
            write_log(path, opened, some, with_odometry=False)
            grids = [word for grid in GRIDS for word in ("--grid", grid)]
            command = [sys.executable, "-m", "mavnav", "compare", path, *grids, "-q", "-o", folder / path.stem]
            subprocess.run(command, check=False)
            path.unlink()


def read(folder: Path) -> dict[str, list[list[dict[str, Any]]]]:
    """Return run.json of every grid, of every sample, of every log; samples without one of the maps are left out."""
    samples = defaultdict(list)
    for path in sorted(folder.glob("*/comparison.json")):
        runs = [cell["run"] for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]]
        if all(run and run.get("map_quality", {}).get("meaningful") for run in runs):
            samples[path.parent.name.partition(".")[0]].append(runs)
    return samples


def deviations(values: list[list[float | None]]) -> Iterator[float]:
    """Yield, for two grids each, how far their relative difference in a sample is from its mean over the samples."""
    for a, b in combinations(range(len(GRIDS)), 2):
        pairs = [(row[a], row[b]) for row in values]
        shares = np.array([2.0 * (x - y) / (x + y) for x, y in pairs if x is not None and y is not None and x + y])
        if len(shares) > 1:
            yield from np.abs(shares - shares.mean()) * (len(shares) / (len(shares) - 1)) ** 0.5


def table(folder: Path) -> None:
    """Print the noise of every measure."""
    samples = read(folder)
    print(f"{sum(map(len, samples.values()))} samples of {len(samples)} logs")
    print("| measure | median | 95 % | the same without one log |\n|---|---|---|---|")
    for quantity in QUANTITIES:
        by_log = {
            log: list(deviations([[quantity.of(run) for run in runs] for runs in of_log]))
            for log, of_log in samples.items()
        }
        every = [x for some in by_log.values() for x in some]
        if len(by_log) < 2 or not every or quantity.cost:
            continue
        without = [
            np.quantile([x for log, some in by_log.items() if log != out for x in some], 0.95)
            for out in by_log
            if len(every) > len(by_log[out])
        ]
        print(
            f"| {quantity.name} | {100 * np.median(every):.1f} % | {100 * np.quantile(every, 0.95):.1f} % "
            f"| {100 * min(without):.1f} to {100 * max(without):.1f} % |"
        )


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("make", "table"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--logs", type=Path, default=Path(__file__).parents[2] / "shared" / "logs")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.what == "make":
        make(options.folder, options.logs)
    else:
        table(options.folder)


if __name__ == "__main__":
    main()
