"""Measure the relative cost of logs in which tracking is lost, and how many scans are tracked again.

    python benchmarks/lost.py LOG ... [--kinds half,blocks,middle,carried] [--rounds N]

Scans of each log are removed, or replaced by those of another place. Every run follows a run of the original log,
without loop closure; the ratio of their CPU times per scan is printed, as the median of the rounds. Poses are compared
with those of the original log.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
from msgspec.structs import replace
from office import ELSEWHERE

from mavnav.config.loading import load_config
from mavnav.logs import open_log
from mavnav.pose import Pose, Trajectory
from mavnav.scan import Scan
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.synthetic import scan_at

BLOCK_SCANS, OTHER_SCANS, AGAIN_SCANS = 20, 100, 20
WRONG_M = 0.5


def half(scans: list[Scan]) -> list[Scan]:
    """Drop half of the scans at random."""
    kept = np.random.default_rng(7).random(len(scans)) >= 0.5
    return [scan for scan, keep in zip(scans, kept, strict=True) if keep]


def blocks(scans: list[Scan]) -> list[Scan]:
    """Drop every other block of scans."""
    return [scan for k, scan in enumerate(scans) if k // BLOCK_SCANS % 2 == 0]


def middle(scans: list[Scan]) -> list[Scan]:
    """Drop the second and third quarter."""
    return [*scans[: len(scans) // 4], *scans[3 * len(scans) // 4 :]]


def carried(scans: list[Scan]) -> list[Scan]:
    """Insert scans of a room that is not on the map, and continue with scans from shortly before."""
    at, step_ns = len(scans) // 2, int(np.median(np.diff([scan.stamp_ns for scan in scans])))
    spec, rng = scans[at].spec, np.random.default_rng(0)
    other = [scan_at(ELSEWHERE, Pose(0.8, 0.8, 0.01 * k), spec, noise=0.003, rng=rng) for k in range(OTHER_SCANS)]
    later = [*other, *scans[at - AGAIN_SCANS :]]
    return [*scans[:at], *(replace(s, stamp_ns=scans[at].stamp_ns + k * step_ns) for k, s in enumerate(later))]


KINDS: dict[str, Callable[[list[Scan]], list[Scan]]] = {
    "half": half,
    "blocks": blocks,
    "middle": middle,
    "carried": carried,
}


def run(scans: list[Scan], period_s: float) -> tuple[SlamResult, float]:
    """Return the result, and the CPU time per scan in ms."""
    began_s = process_time()
    found = run_slam(lambda: scans, load_config(overrides={"loop_closure": "off"}), period_s)
    return found, (process_time() - began_s) / len(scans) * 1e3


def wrong(found: Trajectory, whole: Trajectory) -> int:
    """Return the number of wrong poses in the frame of the first pose, among the scans that both tracks contain."""
    _, a, b = np.intersect1d(found.stamps_ns, whole.stamps_ns, return_indices=True)
    there = Trajectory(whole.stamps_ns[b], whole.xyyaw[b])
    off_m = found.xyyaw[a] - there.seen_from(there[0].inverse() if len(b) else Pose()).xyyaw
    return int((np.hypot(*off_m[:, :2].T) > WRONG_M).sum())


def main() -> None:
    """Disturb the logs, track them, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    for path in args.logs:
        log = open_log(path, odom="off")
        scans = list(log.scans())
        run(carried(scans)[: len(scans) // 2 + 80], log.period_s)  # loads the kernels
        for kind in args.kinds.split(","):
            some, ratios = KINDS[kind](scans), []
            for _ in range(args.rounds):
                whole, whole_ms = run(scans, log.period_s)
                found, found_ms = run(some, log.period_s)
                ratios.append(found_ms / whole_ms)
            off = "" if kind == "carried" else f", {wrong(found.trajectory, whole.trajectory)} wrong"
            tracked = f"{len(found.trajectory)} of {len(some)} scans{off}"
            print(
                f"{path.stem:18} {kind:8} {np.median(ratios):5.2f} of {whole_ms:.2f} ms a scan  {tracked}", flush=True
            )


if __name__ == "__main__":
    main()
