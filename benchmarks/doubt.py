"""Evaluate how well `tracking.doubt` separates wrong tracks from correct ones: make runs, fit coefficients, report.

    python benchmarks/doubt.py collect RUNS.jsonl [--logs FOLDER] [--jobs N] [--only TEXT]
    python benchmarks/doubt.py fit RUNS.jsonl
    python benchmarks/doubt.py report RUNS.jsonl [--plot FILE.png]

``collect`` makes the runs missing in the file: disturbed recorded logs, compared with truth or the undisturbed track,
and scenes and missions, compared with ground truth. Each line contains the features of a run, always with a second
track, and its errors. A run is wrong if the motion over any window of 2 or 10 s has an error over 0.2 m or 5 deg.
``fit`` fits the coefficients and prints them for mavnav/slam/doubt/features.py. ``report`` fits them to all logs,
scenes and missions but one, judges that one, and reports all of these together, beside the coefficients in the file;
there is a second track only if the first one leaves the doubt undecided.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from doubt_corpus import MISSION, WINDOWS_S, WRONG_LOGS, case_of, every_name, flown, largest_errors, largest_offset_m
from matplotlib.figure import Figure
from msgspec.structs import replace
from scipy.optimize import minimize

from mavnav.slam import pipeline
from mavnav.slam.doubt.features import (
    DISAGREEMENT,
    FEATURES,
    ONE_TRACK,
    TWO_TRACKS,
    WRONG_M,
    WRONG_RAD,
    Weights,
    evidence_of,
    resampled_poses,
)
from mavnav.slam.doubt.judge import ALWAYS, FEWEST, UNDECIDED, doublings, judge_flown, judge_track, probability
from mavnav.slam.findings import HIGH
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.track import Track
from mavnav.units import DEG

Run = dict[str, Any]

RIDGE, LEAST_WEIGHT = 0.3, 0.1
"""Penalty on squared weights, and minimum weight of a doubling of a feature, for features that are rare in the runs."""

CAUTION = 1.5
"""Weight of a wrong run relative to a right one: an error that is not noticed costs more than a false alarm."""

PASSES = pipeline.CHECKING

BINS = (0.0, 0.02, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
"""Limits of the bins of the reliability diagram."""


def features_of(track: Track, refiner: Refiner) -> dict[str, float]:
    """Return the features of a judged track, including those that need a second track."""
    if track.steps.column("tracked").sum() < FEWEST:
        return {}
    resampled = resampled_poses(track)
    evidence = evidence_of(track, refiner)
    evidence = evidence if resampled is None else replace(evidence, resampled=resampled)
    return {name: feature.total(feature.of(evidence)) for name, feature in FEATURES.items()}


def made(folder: Path, name: str) -> Run:
    """Make a run; return its features and errors."""
    features: list[dict[str, float]] = []

    def keep(judge: Callable[[Track, Refiner], Track], track: Track, refiner: Refiner) -> Track:
        judged = judge(track, refiner)
        features.append(features_of(judged, refiner))
        return judged

    pipeline.CHECKING, pipeline.judge_flown = PASSES, judge_flown
    case = None if name.startswith(MISSION) else case_of(folder, name)
    pipeline.CHECKING = tuple(partial(keep, some) if some is judge_track else some for some in PASSES)
    pipeline.judge_flown = partial(keep, judge_flown)
    if case:
        slam, truth = case.track(), case.reference
    else:
        slam, truth = flown(name)
    errors = [largest_errors(slam.trajectory, truth, windows_s) for windows_s in (WINDOWS_S[:2], WINDOWS_S[2:])]
    return {
        "name": name,
        "lost": slam.lost_for_good,
        "off_m": errors[0][0],
        "off_deg": errors[0][1],
        "minute": errors[1],
        "whole_m": largest_offset_m(slam.trajectory, truth),
        "tracked": slam.tracked_share,
        "features": features[0] if features else {},
    }


def collect(file: Path, folder: Path, jobs: int, only: str) -> None:
    """Make the runs that are missing in a file, and append them."""
    there = {run["name"] for run in read(file)} if file.exists() else set()
    names = [name for name in every_name() if only in name and name not in there]
    np.random.default_rng(0).shuffle(names)
    with ProcessPoolExecutor(jobs, initializer=os.nice, initargs=(5,)) as pool, file.open("a", encoding="utf-8") as out:
        for run in pool.map(partial(made, folder), names):
            out.write(json.dumps(run) + "\n")
            out.flush()
            print(f"{run['name']:32} {run['off_m']:6.2f} m {run['off_deg']:6.1f} deg", flush=True)


def read(file: Path) -> list[Run]:
    """Read the runs of a file."""
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def is_wrong(run: Run) -> bool:
    """Return whether the track of a run is wrong in any window."""
    return source(run["name"]) in WRONG_LOGS or bool(run["off_m"] > WRONG_M or run["off_deg"] > WRONG_RAD / DEG)


def fitted(runs: list[Run], names: Iterable[str]) -> Weights:
    """Fit the weights of some features to runs by logistic regression with weights of at least ``LEAST_WEIGHT``."""
    x = np.array([[doublings(run["features"][name]) for name in names] for run in runs])
    wrong = np.array([is_wrong(run) for run in runs], dtype=np.float64)
    cost = np.where(wrong, CAUTION, 1.0)

    def loss(p: np.ndarray) -> tuple[float, np.ndarray]:
        z, weights = p[0] + x @ p[1:], p[1:]
        slope = cost * (1.0 / (1.0 + np.exp(-z)) - wrong)
        total = (cost * (np.logaddexp(0.0, z) - wrong * z)).sum() + RIDGE * (weights**2).sum()
        return total, np.concatenate(([slope.sum()], x.T @ slope + 2.0 * RIDGE * weights))

    bounds = [(None, None), *[(LEAST_WEIGHT, None)] * x.shape[1]]
    start = np.array([-3.0, *[0.5] * x.shape[1]])
    bias, *weights = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x.tolist()
    return Weights(round(bias, 2), {n: round(w, 2) for n, w in zip(names, weights, strict=True)})


def fit(runs: list[Run]) -> None:
    """Fit the coefficients and print them."""
    some = [run for run in runs if run["features"] and not run["lost"]]
    print(f"{len(some)} runs, {sum(map(is_wrong, some))} of them wrong")
    for title, now in (("ONE_TRACK", ONE_TRACK), ("TWO_TRACKS", TWO_TRACKS)):
        weights = fitted(some, now.weights)
        print(f"{title}: bias {weights.bias}")
        print("".join(f"    {name}: {weight}\n" for name, weight in weights.weights.items()))


Model = tuple[Weights, Weights]
"""The coefficients without and with a second track."""


def judged(run: Run, model: Model = (ONE_TRACK, TWO_TRACKS)) -> float:
    """Return the doubt of a run, with the second track if the first one leaves it undecided, and of every mission."""
    one, (low, high) = alone(run, model), ALWAYS if run["name"].startswith(MISSION) else UNDECIDED
    return probability(run["features"], *model) if low <= one <= high else one


def alone(run: Run, model: Model = (ONE_TRACK, TWO_TRACKS)) -> float:
    """Return the doubt of a run without the second track."""
    return probability({**run["features"], DISAGREEMENT: np.nan}, *model)


def report(runs: list[Run], plot: Path | None) -> None:
    """Print how well each source is judged by coefficients that are fitted to the others, and by those in the file."""
    live = [run for run in runs if run["features"] and not run["lost"]]
    doubts: dict[str, float] = {}
    for _, some in grouped(live, source):
        named = {run["name"] for run in some}
        rest = [run for run in live if run["name"] not in named]
        one, two = fitted(rest, ONE_TRACK.weights), fitted(rest, TWO_TRACKS.weights)
        doubts |= {run["name"]: judged(run, (one, two)) for run in some}
    for title, doubt_of in (("as released", judged), ("held out", lambda run: doubts[run["name"]])):
        print(f"\n| {title} | runs | right | right, marked | wrong, marked | exit 5 | silently wrong |\n|" + "---|" * 7)
        print(f"| **all** {outcomes(runs, doubt_of)}")
        for group in (family, source):
            for what, some in grouped(runs, group):
                print(f"| {what} {outcomes(some, doubt_of)}")
        rows = reliability(live, doubt_of)
        print("\n| doubt | runs | mean doubt | wrong |\n|---|---|---|---|")
        for low, high, count, mean, share in rows:
            print(f"| {low:g} to {high:g} | {count} | {mean:.2f} | {share:.2f} |")
    if plot:
        draw(rows, plot)
    tried = np.mean([UNDECIDED[0] <= alone(run) <= UNDECIDED[1] for run in live])
    print(f"\nsecond track: {tried:.0%}\n")
    for run in live:
        if (doubts[run["name"]] > HIGH) != is_wrong(run):
            print(f"{run['name']:36} {run['off_m']:.2f} m {run['off_deg']:.1f} deg, doubt {doubts[run['name']]:.2f}")


SOURCES = {
    "fr079": "fr079",
    "wean_1": "wean_1",
    "urg_exp1": "urg_exp1",
    "mounting": "corridor",
    "odometry_reset": "corridor",
}
"""Beginnings of the names of runs of one place -> its name."""


def source(name: str) -> str:
    """Return the log, scene or mission of a run; parts of one log are one."""
    return next((place for start, place in SOURCES.items() if name.startswith(start)), name.partition("/")[0])


def outcomes(runs: list[Run], doubt_of: Callable[[Run], float] = judged) -> str:
    """Return a table row with the numbers of correct, marked, lost and silently wrong runs."""
    live = [run for run in runs if not run["lost"] and run["features"]]
    right, wrong = ([doubt_of(r) > HIGH for r in live if is_wrong(r) == w] for w in (False, True))
    silent, false = len(wrong) - sum(wrong), sum(right)
    return (
        f"| {len(runs)} | {len(right) - false} | {false} ({100 * false / max(len(right), 1):.1f} %) | {sum(wrong)} "
        f"| {len(runs) - len(live)} | {silent} ({100 * silent / max(len(runs), 1):.1f} %) |"
    )


def grouped(runs: list[Run], group: Callable[[str], str]) -> Iterator[tuple[str, list[Run]]]:
    """Yield groups of runs, and the part of their names that they have in common."""
    for common in sorted({group(run["name"]) for run in runs}):
        yield common, [run for run in runs if group(run["name"]) == common]


def family(name: str) -> str:
    """Return the kind of data of a run: recorded, a simulated scene, or a mission."""
    kind = name.partition("-")[0]
    return kind if kind in ("sim", "mission") else "recorded"


def reliability(
    runs: list[Run], doubt_of: Callable[[Run], float] = judged
) -> list[tuple[float, float, int, float, float]]:
    """Return for each bin its limits, the number of runs, their mean doubt and the share of wrong ones."""
    doubts, wrong = np.array([doubt_of(r) for r in runs]), np.array([is_wrong(r) for r in runs])
    rows = []
    for low, high in pairwise(BINS):
        inside = (doubts >= low) & ((doubts < high) | (high == 1.0))
        if inside.any():
            rows.append((low, high, int(inside.sum()), float(doubts[inside].mean()), float(wrong[inside].mean())))
    return rows


def draw(rows: list[tuple[float, float, int, float, float]], path: Path) -> None:
    """Draw the reliability diagram."""
    figure = Figure(figsize=(4.0, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    axes.plot([row[3] for row in rows], [row[4] for row in rows], "o-", color="#0077bb")
    for _, _, count, mean, share in rows:
        axes.annotate(str(count), (mean, share), xytext=(6, -10), textcoords="offset points", fontsize=8)
    axes.set(xlabel="doubt", ylabel="share of wrong runs", xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    figure.savefig(path, dpi=110)


def main() -> None:
    """Collect, fit or report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("collect", "fit", "report"))
    parser.add_argument("runs", type=Path)
    parser.add_argument("--logs", type=Path, default=Path("../shared/logs"))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    if args.action == "collect":
        collect(args.runs, args.logs, args.jobs, args.only)
    elif args.action == "fit":
        fit(read(args.runs))
    else:
        report(read(args.runs), args.plot)


if __name__ == "__main__":
    main()
