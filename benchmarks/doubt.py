"""Evaluate how well `tracking.doubt` separates wrong tracks from correct ones: make runs, fit coefficients, report.

    python benchmarks/doubt.py collect RUNS.jsonl [--logs FOLDER] [--jobs N] [--only TEXT]
    python benchmarks/doubt.py fit RUNS.jsonl [--only TEXT]
    python benchmarks/doubt.py report RUNS.jsonl [--plot FILE.png]
    python benchmarks/doubt.py held-out RUNS.jsonl

``collect`` makes the runs missing in the file: disturbed recorded logs, compared with the undisturbed track, and scenes
and missions, compared with ground truth. Each line contains the features of a run, always with a second track, and its
errors. A run is wrong if the motion over any window of 2 or 10 s has an error over 0.2 m or 5 deg. ``fit`` fits the
coefficients to the even seeds and prints them for mavnav/slam/doubt/features.py; with ``--only`` those of the
features with a text in the name, and the others stay. ``report`` evaluates all runs with the coefficients in that file,
with the second track only if the doubt of the first one requires it. ``held-out`` fits them to all logs, scenes and
missions but one, judges that one, and reports all of these together, beside the coefficients in the file.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from doubt_corpus import WINDOWS_S, case_of, every_name, flown, largest_errors, largest_offset_m
from matplotlib.figure import Figure
from msgspec.structs import replace
from scipy.optimize import minimize

from mavnav.pose import motions
from mavnav.slam import pipeline
from mavnav.slam.doubt.features import (
    DISAGREEMENT,
    FEATURES,
    ONE_TRACK,
    TWO_TRACKS,
    WRONG_M,
    WRONG_RAD,
    TrackEvidence,
    Weights,
    evidence_of,
    resampled_poses,
)
from mavnav.slam.doubt.judge import FEWEST, WORTH_A_TRACK, contributions, doublings, judge_track, probability
from mavnav.slam.findings import HIGH
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.track import Track
from mavnav.units import DEG, NS

Run = dict[str, Any]

RIDGE, LEAST_WEIGHT = 0.3, 0.1
"""Penalty on squared weights, and minimum weight of a doubling of a feature, for features that are rare in the runs."""

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
    values = {name: feature.total(feature.of(evidence)) for name, feature in FEATURES.items()}
    return values | candidates(evidence)


def candidates(evidence: TrackEvidence) -> dict[str, float]:
    """Return features that might be better."""
    stamps_s, n = evidence.stamps_ns * NS, len(evidence.stamps_ns)
    ends = np.searchsorted(stamps_s, stamps_s + 2.0)
    weak = 0.01 / np.maximum(evidence.observed, 1e-5)
    weak_2s = np.array([np.median(weak[k:end]) for k, end in enumerate(ends.tolist())])
    with_odometry = evidence.odometry.mean() > 0.5
    back = np.maximum(np.searchsorted(stamps_s, stamps_s - 1.0), 0)
    moved = motions(evidence.xyyaw, back, np.arange(n))
    moving = (np.hypot(moved[:, 0], moved[:, 1]) > 0.1) | (np.abs(moved[:, 2]) > 10 * DEG)
    conflicts = np.where(moving, evidence.conflicts, 0.0) / 0.05
    conflicts_10s = [
        np.median(conflicts[k:end]) for k, end in enumerate(np.searchsorted(stamps_s, stamps_s + 10.0).tolist())
    ]
    values = {
        "weak_2s": weak_2s.max(),
        "conflicts_q90": np.quantile(conflicts, 0.9),
        "conflicts_q50": np.quantile(conflicts, 0.5),
        "conflicts_10s": np.max(conflicts_10s),
    }
    named = {
        f"{name}{'_wheels' if odo else ''}": v * (odo == with_odometry)
        for name, v in values.items()
        for odo in (False, True)
    }
    window = {"minute_disagrees": disagreement_over(evidence, 60.0)}
    return {name: float(value) for name, value in (named | window).items()}


def disagreement_over(evidence: TrackEvidence, window_s: float) -> float:
    """Return the largest difference of two tracks in the motion over a window, as a multiple of the bound for wrong."""
    common = np.flatnonzero(np.isfinite(evidence.resampled[:, 0]))
    if not len(common):
        return np.nan
    stamps_s, start = evidence.stamps_ns[common] * NS, np.arange(len(common))
    end = np.minimum(np.searchsorted(stamps_s, stamps_s + window_s), len(common) - 1)
    off = motions(evidence.xyyaw[common], start, end) - motions(evidence.resampled[common], start, end)
    off_rad = np.abs((off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    return float(np.maximum(np.hypot(off[:, 0], off[:, 1]) / WRONG_M, off_rad / WRONG_RAD).max())


def made(folder: Path, name: str) -> Run:
    """Make a run; return its features and errors."""
    features: list[dict[str, float]] = []

    def keep(track: Track, refiner: Refiner) -> Track:
        judged = judge_track(track, refiner)
        features.append(features_of(judged, refiner))
        return judged

    pipeline.CHECKING = PASSES
    case = None if name.startswith("mission-") else case_of(folder, name)
    pipeline.CHECKING = tuple(keep if some is judge_track else some for some in PASSES)
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


def half(runs: list[Run], odd: int) -> list[Run]:
    """Return the runs of even or of odd seeds."""
    return [run for run in runs if int(run["name"].rpartition("/")[2]) % 2 == odd]


def is_wrong(run: Run) -> bool:
    """Return whether the track of a run is wrong in any window."""
    return bool(run["off_m"] > WRONG_M or run["off_deg"] > WRONG_RAD / DEG)


def fitted(runs: list[Run], names: list[str], held: Weights) -> Weights:
    """Fit the weights of some features to runs by logistic regression with weights of at least ``LEAST_WEIGHT``.

    ``held`` has the weights of other features, which stay; the bias stays, too, if there are any.
    """
    x = np.array([[doublings(run["features"][name]) for name in names] for run in runs])
    base = [sum(w * doublings(run["features"][name]) for name, w in held.weights.items()) for run in runs]
    log_odds, wrong = held.bias + np.array(base), np.array([is_wrong(run) for run in runs], dtype=np.float64)

    def loss(p: np.ndarray) -> tuple[float, np.ndarray]:
        z, weights = log_odds + p[0] + x @ p[1:], p[1:]
        slope = 1.0 / (1.0 + np.exp(-z)) - wrong
        total = (np.logaddexp(0.0, z) - wrong * z).sum() + RIDGE * (weights**2).sum()
        return total, np.concatenate(([slope.sum()], x.T @ slope + 2.0 * RIDGE * weights))

    bias = (0.0, 0.0) if held.weights else (None, None)
    bounds = [bias, *[(LEAST_WEIGHT, None)] * len(names)]
    found = minimize(loss, np.array([0.0, *[0.5] * len(names)]), jac=True, bounds=bounds, method="L-BFGS-B").x
    weights = {n: round(w, 2) for n, w in zip(names, found[1:].tolist(), strict=True)}
    return Weights(round(held.bias + found[0], 2), {**held.weights, **weights})


def fit(runs: list[Run], only: str) -> None:
    """Fit the coefficients to the even seeds and print them; all, or those of the features with a text in the name."""
    some = [run for run in half(runs, 0) if run["features"] and not run["lost"]]
    print(f"{len(some)} runs, {sum(map(is_wrong, some))} of them wrong")
    for title, now in (("ONE_TRACK", ONE_TRACK), ("TWO_TRACKS", TWO_TRACKS)):
        names = [name for name in now.weights if only in name]
        others = {name: weight for name, weight in now.weights.items() if name not in names}
        weights = fitted(some, names, Weights(now.bias if others else -3.0, others))
        print(f"{title}: bias {weights.bias}")
        print("".join(f"    {name}: {weight}\n" for name, weight in weights.weights.items()))


Model = tuple[Weights, Weights]
"""The coefficients without and with a second track."""


def judged(run: Run, model: Model = (ONE_TRACK, TWO_TRACKS)) -> float:
    """Return the doubt of a run, with the second track if the doubt of the first one is high."""
    one = probability({**run["features"], DISAGREEMENT: np.nan}, *model)
    return one if one < WORTH_A_TRACK else probability(run["features"], *model)


def held_out(runs: list[Run]) -> None:
    """Print how well each log, scene and mission is judged by coefficients that are fitted to the others."""
    live = [run for run in runs if run["features"] and not run["lost"]]
    doubts: dict[str, float] = {}
    for _, some in grouped(live, source):
        named = {run["name"] for run in some}
        rest = [run for run in live if run["name"] not in named]
        one, two = (fitted(rest, list(now.weights), Weights(-3.0, {})) for now in (ONE_TRACK, TWO_TRACKS))
        doubts |= {run["name"]: judged(run, (one, two)) for run in some}
    for title, doubt_of in (("as released", judged), ("held out", lambda run: doubts[run["name"]])):
        print(f"\n| {title} | runs | right | right, marked | wrong, marked | exit 5 | silently wrong |\n|" + "---|" * 7)
        print(f"| **all** {outcomes(runs, doubt_of)}")
        for what, some in grouped(runs, source):
            print(f"| {what} {outcomes(some, doubt_of)}")
        print("\n| doubt | runs | mean doubt | wrong |\n|---|---|---|---|")
        for low, high, count, mean, share in reliability(live, doubt_of):
            print(f"| {low:g} to {high:g} | {count} | {mean:.2f} | {share:.2f} |")


def source(name: str) -> str:
    """Return the log, scene or mission of a run."""
    return name.partition("/")[0]


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
    """Return the kind of data of a run: a log, a simulated scene or a mission."""
    return name.partition("/")[0].partition("-")[0]


def scene(name: str) -> str:
    """Return the scene or mission of a run, and its variant: subsampled scans, or odometry."""
    return "/".join(name.split("/")[:2])


def main_reason(runs: list[Run]) -> str:
    """Return the most frequent main reason of the marked runs."""
    marked = [run["features"] for run in runs if run["features"] and not run["lost"] and judged(run) > HIGH]
    found = [max(odds := contributions(features), key=odds.__getitem__) for features in marked]
    return FEATURES[max(found, key=found.count)].reason if found else ""


def report(runs: list[Run], plot: Path | None) -> None:
    """Print the results of both halves, the runs with a wrong verdict, and the reliability."""
    print("| runs | runs | right | right, marked | wrong, marked | exit 5 | silently wrong |\n|" + "---|" * 7)
    for odd, title in enumerate(("fitted", "reported")):
        print(f"| **{title} half** {outcomes(half(runs, odd))}")
    for what, some in grouped(half(runs, 1), family):
        print(f"| {what} {outcomes(some)}")
    live = [run for run in half(runs, 1) if not run["lost"] and run["features"]]
    tried = np.mean([probability({**r["features"], DISAGREEMENT: np.nan}) >= WORTH_A_TRACK for r in live])
    print(f"\nsecond track: {tried:.0%} of the reported half\n")
    for run in live:
        doubt = judged(run)
        if (doubt > HIGH) != is_wrong(run):
            print(f"{run['name']:32} {run['off_m']:.2f} m {run['off_deg']:.1f} deg, doubt {doubt:.2f}")
    rows = reliability(live)
    print("\n| doubt | runs | mean doubt | wrong |\n|---|---|---|---|")
    for low, high, count, mean, share in rows:
        print(f"| {low:g} to {high:g} | {count} | {mean:.2f} | {share:.2f} |")
    if plot:
        draw(rows, plot)
    print(
        "\n| simulated | runs | right | right, marked | wrong, marked | exit 5 | silently wrong | main reason |\n|"
        + "---|" * 8
    )
    for what, some in grouped([run for run in runs if run["name"].startswith(("sim-", "mission-"))], scene):
        print(f"| {what} {outcomes(some)} {main_reason(some)} |")


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
    parser.add_argument("action", choices=("collect", "fit", "report", "held-out"))
    parser.add_argument("runs", type=Path)
    parser.add_argument("--logs", type=Path, default=Path("../shared/logs"))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    if args.action == "collect":
        collect(args.runs, args.logs, args.jobs, args.only)
    elif args.action == "fit":
        fit(read(args.runs), args.only)
    elif args.action == "held-out":
        held_out(read(args.runs))
    else:
        report(read(args.runs), args.plot)


if __name__ == "__main__":
    main()
