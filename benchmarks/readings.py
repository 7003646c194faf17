"""Evaluate readings (interpretations of the paper's text as parameter values) of the paper's method.

    python benchmarks/readings.py [missions] [future] [lasers] [gate] [grids] [fine] [ablation] [search]
        [--logs FOLDER] [--designs N] [--best NUMBER ...] [--seeds N] [--jobs N]

``search``: a random design over the parameters of ``PaperConfig`` and of the recovery, flown at the paper's full noise
in three rounds: all readings on few training seeds, the better ones on more, and the best and the named ones on the
test seeds, which decide. Readings are ranked by goals reached, then by accepted scans, then by trajectory error.
``gate``: wrong matches that are accepted, of 240 scans taken at least 1 m from where a map was made, against the goals.
``ablation``: each value of `paper` is reset once. ``missions``: both methods; ``future``: in the scenarios of the
paper's future work; ``lasers``: with faster ones. ``grids``: the search grids of the paper's figures 7 and 8, in
flight; ``fine``: those of figure 7 on the same recordings. With ``--logs``, recordings are replayed too
(FOLDER/NAME/NAME.mcap).
The tables are written to docs/paper/, and docs/paper.md refers to them.
"""

from __future__ import annotations

import argparse
import subprocess
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from mavnav.config.layers import by_dotted_key
from mavnav.config.loading import load_config
from mavnav.config.models import Config
from mavnav.ground_truth.references import of_scenario
from mavnav.logs import open_log
from mavnav.mapping.occupancy_grid import occupied_xy_m
from mavnav.metrics.map_quality import measure_map
from mavnav.metrics.reference import map_distance, position_errors
from mavnav.metrics.walls import summary, wall_sections
from mavnav.pipelines.maps import measured_map
from mavnav.pipelines.simulate import truth_errors
from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.simulation.mission import End, fly
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.laser import take_scan
from mavnav.simulation.world.scenario import laser_model
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import MatchVerdict
from mavnav.slam.matching.steps import Step, Steps, refused_by
from mavnav.slam.methods.paper import Paper
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult

DOCS = Path(__file__).parent.parent / "docs" / "paper"
TRAINING_SEEDS, TEST_SEEDS = range(1000, 1008), range(20)
TRAINING = ("corner", "complex", "corridor")
SCENARIOS = ("corner-paper", "corner", "complex-paper", "complex", "corridor", "curved", "u_trap", "loop", "hover")
FUTURE = ("hallway", "hall", "dead_end", "doorway", "ring")
PLACES = SCENARIOS[:6]
"""The worlds of the wrong pairs."""
ABLATED = ("corner-paper", "complex", "corridor", "u_trap")
LOGS = ("ccny_demo", "lego_robot4", "urg_exp1")
KEPT = (20, 5)
"""Number of readings kept from the first round for the second, and from the second for the test."""

LEVELS: dict[str, tuple[object, ...]] = {
    "slam.paper.gate_mm2": (400, 500, 800),
    "slam.paper.gate_range_mm": ("null", 1000),
    "slam.paper.expert.occlusion_mm": (150, 300, 500),
    "slam.paper.expert.occlusion_shrink": (1, 0.7),
    "slam.paper.expert.occlusion_least_mm": (60, 100, 200),
    "slam.paper.expert.occluded": ("left_out", "counted"),
    "slam.paper.expert.cluster_gap_cells": (0, 4, 11, 20),
    "slam.paper.expert.equal_cells": ("nearest", "middle"),
    "slam.paper.cell_mm": (14, 20, 30),
    "slam.paper.expert.min_beams_share": (0.1, 0.4, 0.5),
    "slam.paper.expert.min_beams_of": ("scan", "valid"),
    "slam.paper.expert.mixed_pixel_mm": (50, 100, 300),
    "slam.paper.far_mm": (2500, 5000),
    "slam.paper.window_mm": (100, 200),
    "slam.paper.window_deg": (15, 20, 25),
    "slam.paper.expert.shrink": (0.3, 0.5, 0.6),
    "slam.paper.expert.pivot": ("centroid", "laser"),
    "slam.paper.expert.converged": ("both", "either"),
    "slam.paper.expert.refine_above_mm2": (300, 500),
    "slam.paper.expert.refine_factor": (1, 2),
    "recovery.fly_on_steps": (0, 3, 6),
    "recovery.hover_noise": ("false", "true"),
}

ACCEPTANCE = {"slam.paper.expert.gate_occlusion_mm": 80, "slam.paper.expert.gate_share": 0.55}
"""The acceptance of `paper`, which ``gate`` chose; the designs are searched with it."""

A = {
    "slam.paper.gate_mm2": 800, "slam.paper.gate_range_mm": 1000, "slam.paper.expert.occlusion_mm": 250,
    "slam.paper.expert.cluster_gap_cells": 8, "slam.paper.cell_mm": 30, "slam.paper.expert.shrink": 0.6,
    "slam.paper.window_mm": 80, "slam.paper.expert.min_beams_share": 0.5, "slam.paper.expert.refine_factor": 1,
    "slam.paper.expert.give_up": "false",    "recovery.fly_on_steps": 3, "recovery.hover_noise": "true",
}  # fmt: skip
E = A | {
    "slam.paper.expert.cluster_gap_cells": 12, "slam.paper.expert.occlusion_mm": 300, "slam.paper.window_mm": 200,
    "slam.paper.window_deg": 25, "slam.paper.expert.mixed_pixel_mm": 300,
}  # fmt: skip


class Reading(NamedTuple):
    """A named reading: a preset and the values that override it, ``key=value``."""

    name: str
    preset: str
    sets: tuple[str, ...] = ()

    @classmethod
    def of(cls, name: str, preset: str, values: dict[str, object]) -> Reading:
        """Return a reading from a preset and values by key."""
        return cls(name, preset, tuple(f"{key}={value}" for key, value in values.items()))


class Flown(NamedTuple):
    """Result of a mission: accepted share, errors in mm, wall distance error in percent, thickness in cells.

    ``ate_mm`` is aligned; ``unaligned_mm`` and ``final_mm``, of the last pose, are from the given start pose on.
    """

    goal: bool
    accepted: float
    ate_mm: float
    unaligned_mm: float
    final_mm: float
    wall_percent: float
    evaluations: float
    cells: tuple[float, ...]
    tracked_away: bool
    doubtful: bool


NAMED = (
    Reading("paper", "paper"),
    Reading("paper-literal", "paper-literal"),
    Reading.of("A", "paper-literal", A),
    Reading.of("E", "paper-literal", E),
)


def mission(reading: Reading, scenario: str, seed: int, *, thickness: bool = False) -> Flown:
    """Fly a mission with a reading."""
    flight = fly(load_scenario(scenario, reading.sets, {"seed": seed}, reading.preset))
    steps, truth = flight.slam.steps, truth_errors(flight)
    cells = walls(flight.slam) if thickness else ()
    return Flown(
        flight.mission.end is End.GOAL,
        steps.share("tracked"),
        *(1e3 * known(value) for value in (truth.ate_rmse_m, truth.unaligned_rmse_m, truth.final_error_m)),
        100.0 * known(truth.wall_distance_error_share),
        float(steps.column("evaluations").mean()),
        cells,
        flight.slam.lost_for_good,
        flight.slam.doubt is not None and flight.slam.doubt.high,
    )


def known(value: object) -> float:
    """Return a number of run.json; NaN where it has none."""
    return float(value) if isinstance(value, float) else np.nan


def walls(outcome: SlamResult) -> tuple[float, ...]:
    """Return maximum and p95 of the wall thickness in cells, at 2 and at 5 hits."""
    measured = [
        summary(wall_sections(outcome.grid.hits, outcome.grid.cell_m, hits), outcome.grid.cell_m) for hits in (2, 5)
    ]
    return tuple(cells for walls in measured for cells in (walls.max_cells, walls.p95_cells))


def fly_all(
    ex: Executor,
    readings: Sequence[Reading],
    scenarios: Sequence[str],
    seeds: Iterable[int],
    *,
    thickness: bool = False,
) -> dict[tuple[str, str], list[Flown]]:
    """Fly every reading in every scenario with every seed; results by reading and scenario."""
    tasks = list(product(readings, scenarios, seeds))
    results = list(ex.map(partial(_mission, thickness=thickness), tasks, chunksize=4))
    found: dict[tuple[str, str], list[Flown]] = {}
    for (reading, scenario, _), result in zip(tasks, results, strict=True):
        found.setdefault((reading.name, scenario), []).append(result)
    return found


def _mission(task: tuple[Reading, str, int], *, thickness: bool) -> Flown:
    return mission(*task, thickness=thickness)


def ranked(
    readings: Sequence[Reading], found: dict[tuple[str, str], list[Flown]], scenarios: Sequence[str]
) -> list[Reading]:
    """Sort readings by goals, accepted share (to a percent) and the median ATE of the missions that reached a goal."""

    def rank(reading: Reading) -> tuple[float, float, float]:
        flown = [f for s in scenarios for f in found[reading.name, s]]
        return -sum(f.goal for f in flown), -round(float(np.mean([f.accepted for f in flown])), 2), ate_mm(flown)

    return sorted(readings, key=rank)


def ate_mm(flown: Iterable[Flown]) -> float:
    """Return the median ATE of the missions that reached their goal, NaN if none did."""
    errors = [f.ate_mm for f in flown if f.goal]
    return float(np.median(errors)) if errors else np.nan


def interval(hits: int, n: int) -> str:
    """Format a share in percent with its 95 % confidence interval (Wilson 1927)."""
    z, p = 1.96, hits / n
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = (100 * (middle + sign * half) / (1 + z * z / n) for sign in (-1, 1))
    return f"{100 * p:.0f} ({max(low, 0):.0f} to {min(high, 100):.0f})"


def table(
    readings: Sequence[Reading],
    found: dict[tuple[str, str], list[Flown]],
    scenarios: Sequence[str],
    recorded: dict[tuple[str, str], str],
) -> list[str]:
    """Return a row for each reading: goals in percent, then goals, accepted scans and ATE by scenario."""
    logs = [log for log in LOGS if any(log == key[1] for key in recorded)]
    head = ["reading", "goals %", *scenarios, *logs]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for reading in readings:
        flown = [f for s in scenarios for f in found[reading.name, s]]
        cells = [cell(found[reading.name, s]) for s in scenarios] + [recorded[reading.name, log] for log in logs]
        share = interval(sum(f.goal for f in flown), len(flown))
        lines.append("| " + " | ".join([reading.name, share, *cells]) + " |")
    return lines


def cell(flown: Sequence[Flown]) -> str:
    """Format goals, accepted scans and ATE."""
    accepted = 100 * np.mean([f.accepted for f in flown])
    return f"{sum(f.goal for f in flown)} of {len(flown)}, {accepted:.0f} %, {ate_mm(flown):.0f}"


def designed(count: int) -> list[Reading]:
    """Return random readings in which each level of a parameter is equally frequent."""
    rng = np.random.default_rng(0)
    columns = {key: rng.permutation(np.resize(np.arange(len(levels)), count)) for key, levels in LEVELS.items()}
    drawn = [{key: LEVELS[key][column[k]] for key, column in columns.items()} for k in range(count)]
    return [Reading.of(f"design {k}", "paper-literal", ACCEPTANCE | values) for k, values in enumerate(drawn)]


def replays(ex: Executor, readings: Sequence[Reading], folder: Path | None) -> dict[tuple[str, str], str]:
    """Replay the available recordings; return accepted scans and distance between revisits as text."""
    logs = [log for log in LOGS if folder and (folder / log / f"{log}.mcap").exists()]
    tasks = list(product(readings, logs))
    results = ex.map(_replay, [(reading, str(folder), log) for reading, log in tasks])
    return {(reading.name, log): result for (reading, log), result in zip(tasks, results, strict=True)}


def _replay(task: tuple[Reading, str, str]) -> str:
    reading, folder, name = task
    log = open_log(Path(folder) / name / f"{name}.mcap", odom="off")
    sets = [s.removeprefix("slam.") for s in reading.sets if s.startswith("slam.")]
    outcome = run_slam(log.scans, load_config(reading.preset, sets), log.period_s)
    quality = measured_map(outcome, log).quality
    apart_mm = quality.revisits.nn_l_mm if quality.revisits else np.nan
    ended = "" if not outcome.lost_for_good else ", lost"
    return f"{100 * outcome.steps.share('tracked'):.0f} %, {apart_mm:.1f}{ended}"


def search(
    ex: Executor, folder: Path | None, designs: int, best: Sequence[int] = (), seeds: Sequence[int] = TEST_SEEDS
) -> list[str]:
    """Run the three rounds of the search, or the last with the ``best`` designs; return the lines of the page."""
    readings = designed(designs)
    if best:
        readings = [readings[k] for k in best]
    else:
        for kept, trained in zip(KEPT, (TRAINING_SEEDS[:2], TRAINING_SEEDS), strict=True):
            readings = ranked(readings, fly_all(ex, readings, TRAINING, trained), TRAINING)[:kept]
    finalists = [*NAMED, *readings]
    found = fly_all(ex, finalists, ABLATED, seeds)
    finalists = ranked(finalists, found, ABLATED)
    values = [f"* {r.name}: " + ", ".join(s.removeprefix("slam.paper.") for s in r.sets) for r in finalists if r.sets]
    return [*table(finalists, found, ABLATED, replays(ex, finalists, folder)), "", *values]


def ablation(ex: Executor, folder: Path | None, seeds: Sequence[int] = TEST_SEEDS) -> list[str]:
    """Reset each value of `paper` to the literal reading once; return the lines of the page."""
    best, literal = (by_dotted_key(load_config(name).document()["paper"]) for name in ("paper", "paper-literal"))
    undone = [
        Reading.of(f"{key} {_yaml(was)}", "paper", {f"slam.paper.{key}": _yaml(was)})
        for key, was in literal.items()
        if was != best[key]
    ]
    others = [
        Reading.of("hovering at once", "paper", {"recovery.fly_on_steps": 0}),
        Reading.of("occluded counted", "paper", {"slam.paper.expert.occluded": "counted"}),
        Reading.of("no refinement", "paper", {"slam.paper.expert.refine_factor": 1}),
        Reading.of("every occupied cell an obstacle", "paper", {"planner.min_hits": 1, "planner.min_share": 0}),
        Reading.of("planner.technique field", "paper", {"planner.technique": "field"}),
    ]
    readings = [NAMED[0], *undone, *others]
    found = fly_all(ex, readings, ABLATED, seeds)
    return table(readings, found, ABLATED, replays(ex, readings, folder))


def _yaml(value: object) -> object:
    return "null" if value is None else value


class Case(Struct, frozen=True):
    """Settings of a row group in the table of missions."""

    name: str
    sets: tuple[str, ...] = ()
    scenarios: tuple[str, ...] = SCENARIOS
    seeds: range = TEST_SEEDS


CASES = {
    "missions": (Case("20 mm, 5 deg"),),
    "future": (Case("20 mm, 5 deg", (), FUTURE),),
    "lasers": tuple(
        Case(laser, (f"laser.preset={laser}",), ("corner", "corridor"), range(10)) for laser in ("ust-10lx", "utm-30lx")
    ),
}
"""Row groups of the pages of missions."""


def missions(ex: Executor, cases: Sequence[Case]) -> list[str]:
    """Fly both methods in all cases; return the lines of the page."""
    head = ["case", "method", "scenario", "goals", "accepted %", "ATE mm (worst)", "unaligned mm", "final mm (worst)",
            "wall distance %", "max, p95 cells (>= 2 hits)", "max, p95 cells (>= 5)", "evaluations a match",
            "lost", "other failures, doubtful"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for case, method in product(cases, ("paper", "robust")):
        reading = Reading(method, method, case.sets)
        found = fly_all(ex, [reading], case.scenarios, case.seeds, thickness=True)
        lines += [_row(case.name, method, s, found[method, s]) for s in case.scenarios]
    return lines


FAR_M, CLEAR_M, ALIKE, ALIKE_M = 1.0, 0.35, 0.85, 0.06
"""Least distance of a wrong pair; least distance of a place from the walls; share of the beams, and distance, from
which on two places look alike."""


class Pair(NamedTuple):
    """Scans of one place, of which a map is made, and a scan of another place in the same world."""

    world: World
    world_T_map: Pose
    world_T_laser: Pose
    mapped: list[Scan]
    scan: Scan


def wrong_pairs(scenario: str, seed: int, count: int) -> list[Pair]:
    """Return pairs of places at least ``FAR_M`` apart, each at any heading, drawn from the free space of a scenario."""
    given, rng = load_scenario(scenario, (), {"seed": seed}), np.random.default_rng([seed, PLACES.index(scenario)])
    laser, pairs = laser_model(given), []
    while len(pairs) < count:
        here, there = _place(given.world, rng), _place(given.world, rng)
        if here.between(there).distance_m >= FAR_M:
            mapped = [take_scan(given.world, here, laser, rng, k * 10**8) for k in range(3)]
            scan = take_scan(given.world, there, laser, rng, 3 * 10**8)
            pairs.append(Pair(given.world, here, there, mapped, scan))
    return pairs


def _place(world: World, rng: np.random.Generator) -> Pose:
    """Draw a pose from which walls are seen all round, and none is near."""
    x0, y0, x1, y1 = world.bounds_m
    around = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    while True:
        x, y, yaw = float(rng.uniform(x0, x1)), float(rng.uniform(y0, y1)), float(rng.uniform(-np.pi, np.pi))
        inside = np.isfinite(world.cast((x, y), around)[0]).all()
        if inside and world.clearance_m(np.array([[x, y]]))[0] >= CLEAR_M:
            return Pose(x, y, yaw)


def judged(pair: Pair, config: Config) -> str:
    """Return what becomes of the scan in the map of another place: alike, accepted, or the rule that refuses it."""
    method, motion = Paper(config), Motion(pair.scan.spec.scan_time_s)
    for scan in pair.mapped:
        method.insert(scan, Pose(), motion)
    match = method.match(pair.scan, Pose(), motion)
    if method.gate(match, pair.scan, motion) is not MatchVerdict.SURE:
        return str(refused_by(Steps([Step(0, 0, match, tracked=False)]))[0])
    true_m, taken_m = (
        pair.world.cast((at.x_m, at.y_m), pair.scan.spec.angles_rad + at.yaw_rad)[0]
        for at in (pair.world_T_laser, pair.world_T_map @ match.map_T_laser)
    )
    seen = true_m < config.paper.far_m
    return "alike" if np.mean(np.abs(taken_m - true_m)[seen] < ALIKE_M) >= ALIKE else "accepted"


BEFORE = {"slam.paper.expert.gate_share": 0, "slam.paper.expert.gate_occlusion_mm": 60}
CURVE = (
    NAMED[0],
    Reading.of("gate_share 0.5", "paper", {"slam.paper.expert.gate_share": 0.5}),
    Reading.of("gate_share 0.575", "paper", {"slam.paper.expert.gate_share": 0.575}),
    Reading.of("gate_share 0.6", "paper", {"slam.paper.expert.gate_share": 0.6}),
    Reading.of("gate_share 0.65", "paper", {"slam.paper.expert.gate_share": 0.65}),
    Reading.of("gate_share 0 (the cost alone)", "paper", {"slam.paper.expert.gate_share": 0}),
    Reading.of("gate_mm2 1e9 (the share alone)", "paper", {"slam.paper.gate_mm2": 1e9}),
    Reading.of("gate_occlusion_mm 100", "paper", {"slam.paper.expert.gate_occlusion_mm": 100}),
    Reading.of("as the search ends (60 mm, any share)", "paper", BEFORE),
)
"""Readings from lenient to strict acceptance."""


def gate(
    ex: Executor, scenarios: Sequence[str] = PLACES[:5], seeds: Iterable[int] = TEST_SEEDS, pairs: int = 40
) -> list[str]:
    """Judge the wrong pairs by each reading of `CURVE` and fly it; return the lines of the page."""
    head = ["reading", "wrong accepted", "look-alikes", "refused by share", "by cost", *scenarios]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    apart = [pair for scenario in PLACES for pair in wrong_pairs(scenario, 2000, pairs)]
    flown = fly_all(ex, CURVE, scenarios, seeds)
    for reading in CURVE:
        config = load_config(reading.preset, [text.removeprefix("slam.") for text in reading.sets])
        became = Counter(judged(pair, config) for pair in apart)
        counts = [became[name] for name in ("accepted", "alike", "share", "cost")]
        goals = [cell(flown[reading.name, scenario]) for scenario in scenarios]
        lines.append("| " + " | ".join([reading.name, *map(str, counts), *goals]) + " |")
    return lines


GRIDS = ((10, 5), (20, 10), (40, 20), (40, 40))
"""Yaw samples, and points per side of the position grid, of the paper's figures 7 and 8."""

NARROW = tuple(f"slam.paper.expert.{each}" for each in ("shrink=0.1", "leave_no_gaps=false", "extend_border=false"))
"""Settings of a search whose window shrinks faster than its grid resolves, so that gaps remain between samples."""


FIGURE_8 = Reading.of(
    "literal, loose gate",
    "paper-literal",
    {
        "slam.paper.gate_mm2": 1500,
        "slam.paper.cell_mm": 20,
        "slam.paper.expert.cluster_gap_cells": 8,
        "slam.paper.expert.occlusion_mm": 200,
        "slam.paper.expert.gate_occlusion_mm": 200,
        "slam.paper.expert.refine_factor": 1,
        "slam.paper.expert.give_up": "false",
        "recovery.hover_noise": "true",
        "vehicle.noise_xy_mm": 10,
        "vehicle.noise_yaw_deg": 2.5,
    },
)
"""A reading near the letter in which the search grid decides over the flight, with half the noise of the commands."""

COMPARED = (NAMED[0], Reading("paper, leaving gaps", "paper", NARROW), FIGURE_8)


def grids(ex: Executor, readings: Sequence[Reading] = COMPARED, seeds: Sequence[int] = range(10)) -> list[str]:
    """Fly the corridor with each search grid (figures 7 and 8); return the lines of the page."""
    head = ["reading", "yaw samples / grid", "goals", "accepted %", "ATE mm (worst)", "ghost walls, maps", "m",
            "evaluations a match"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for given, (yaw, n) in product(readings, GRIDS):
        reading = given._replace(sets=(*given.sets, f"slam.grid={n}x{n}", f"slam.azimuth={yaw}"))
        flown = list(ex.map(_drawn, [(reading, "corridor", seed) for seed in seeds]))
        goals = sum(f["goal"] for f in flown)
        mean = {key: np.mean([f[key] for f in flown]) for key in flown[0]}
        worst = max(f["ate_mm"] for f in flown)
        numbers = [f"{goals} of {len(seeds)}", f"{100 * mean['accepted']:.0f}", f"{mean['ate_mm']:.0f} ({worst:.0f})",
                   f"{sum(f['ghosts_m'] > 0 for f in flown)} of {len(seeds)}", f"{mean['ghosts_m']:.1f}",
                   f"{mean['evaluations']:.0f}"]  # fmt: skip
        lines.append("| " + " | ".join([given.name, f"{yaw} / {n}x{n}", *numbers]) + " |")
    return lines


FIGURE_7 = ((20, 10), (40, 40))
"""Yaw samples, and points per side of the position grid, of the paper's figure 7."""


def fine(ex: Executor, seeds: Sequence[int] = TEST_SEEDS) -> list[str]:
    """Replay recordings of the corridor with both grids of figure 7, nothing aligned; return the lines of the page."""
    found = np.array(list(ex.map(_both_grids, seeds)))
    lines = ["| | 20 / 10x10 | 40 / 40x40 | finer is better in |", "|---|---|---|---|"]
    for name, of_measure in zip(("last pose, mm", "p95 of wall cells, mm"), found.transpose(2, 1, 0), strict=True):
        medians = [f"{np.median(some):.0f} ({some.max():.0f})" for some in of_measure]
        better = int((of_measure[1] < of_measure[0]).sum())
        share = f"{better} of {len(found)}: {interval(better, len(found))} %"
        lines.append("| " + " | ".join([f"{name} (worst)", *medians, share]) + " |")
    return lines


def _both_grids(seed: int) -> list[list[float]]:
    """Return, for both grids, the error of the last pose and p95 of the distance of wall cells to the walls, mm."""
    flight = fly(load_scenario("corridor", (), {"seed": seed}, "paper"))
    walls, errors = of_scenario(flight.scenario, flight.world_T_map), []
    for yaw, n in FIGURE_7:
        config = load_config("paper", [f"grid={n}x{n}", f"azimuth={yaw}"])
        outcome = run_slam(lambda: iter(flight.scans), config, 0.1, flight.odom_T_base)
        last = position_errors(outcome.trajectory, flight.map_T_laser, aligned=False)[-1]
        errors.append([1e3 * last, map_distance(occupied_xy_m(outcome.grid), walls).p95_mm])
    return errors


def _drawn(task: tuple[Reading, str, int]) -> dict[str, float]:
    reading, scenario, seed = task
    flight = fly(load_scenario(scenario, reading.sets, {"seed": seed}, reading.preset))
    steps = flight.slam.steps
    return {
        "goal": flight.mission.end is End.GOAL,
        "accepted": steps.share("tracked"),
        "ate_mm": 1e3 * known(truth_errors(flight).ate_rmse_m),
        "ghosts_m": measure_map(flight.slam.grid).quality.ghost_walls.length_m,
        "evaluations": float(steps.column("evaluations").mean()),
    }


def _row(case: str, method: str, scenario: str, flown: Sequence[Flown]) -> str:
    goals, failed = [f for f in flown if f.goal], [f for f in flown if not (f.goal or f.tracked_away)]
    none = [[np.nan] * 4]
    max2, p2, max5, p5 = np.median([f.cells for f in goals if len(f.cells) == 4] or none, axis=0)
    errors = np.array([(f.ate_mm, f.unaligned_mm, f.final_mm, f.wall_percent) for f in goals] or none)
    ate, unaligned, final, wall = np.median(errors, axis=0)
    numbers = [
        f"{len(goals)} of {len(flown)}",
        f"{100 * np.mean([f.accepted for f in flown]):.1f}",
        f"{ate:.1f} ({errors[:, 0].max():.1f})",
        f"{unaligned:.0f}",
        f"{final:.0f} ({errors[:, 2].max():.0f})",
        f"{wall:.2f}",
        f"{max2:.1f}, {p2:.1f}",
        f"{max5:.1f}, {p5:.1f}",
        f"{np.mean([f.evaluations for f in flown]):.0f}",
        f"{sum(f.tracked_away for f in flown)}",
        f"{len(failed)}, {sum(f.doubtful for f in failed)}",
    ]
    cells = [case, method, scenario, *numbers]
    return ("| " + " | ".join(cells) + " |").replace("nan (nan)", "-").replace("nan, nan", "-").replace("nan", "-")


def commit() -> str:
    """Return the commit that is checked out."""
    return subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=True
    ).stdout[:-1]


def main() -> None:
    """Write the requested pages, by default all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="*", default=[])
    parser.add_argument("--logs", type=Path)
    parser.add_argument("--designs", type=int, default=120)
    parser.add_argument("--best", type=int, nargs="*", default=[], help="designs, instead of the rounds that find them")
    parser.add_argument("--seeds", type=int, default=len(TEST_SEEDS), help="test seeds of ablation and search")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    with ProcessPoolExecutor(args.jobs) as ex:
        pages = {
            **{name: partial(missions, ex, cases) for name, cases in CASES.items()},
            "gate": partial(gate, ex),
            "grids": partial(grids, ex),
            "fine": partial(fine, ex),
            "ablation": partial(ablation, ex, args.logs, range(args.seeds)),
            "search": partial(search, ex, args.logs, args.designs, args.best, range(args.seeds)),
        }
        DOCS.mkdir(exist_ok=True)
        for name in args.pages or pages:
            lines = pages[name]()
            print("\n".join([f"## {name}", *lines]), flush=True)
            made = f"`python benchmarks/readings.py {name}`, commit {commit()}."
            (DOCS / f"{name}.md").write_text("\n".join([f"# {HEADS[name]}", "", made, "", *lines, ""]))


HEADS = {
    "gate": "Wrong matches against goals, pairs of seed 2000, missions of seeds 0 to 19",
    "missions": "Missions, seeds 0 to 19",
    "future": "Missions of the paper's future work, seeds 0 to 19",
    "lasers": "Missions with faster lasers, seeds 0 to 9",
    "grids": "Search grids in the corridor, seeds 0 to 9",
    "fine": "Recordings of the corridor replayed with the two grids of figure 7, seeds 0 to 19",
    "ablation": "Each value of the reading `paper` undone",
    "search": "The best of the readings, on test seeds",
}

if __name__ == "__main__":
    main()
