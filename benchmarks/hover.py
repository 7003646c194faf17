"""What is the attitude of a tilting laser worth to a mission, and what does it cost?

    python benchmarks/hover.py [--seeds N] [--scenario NAME]

Missions with no tilt, and with roll and pitch of 5 and 10 degrees of standard deviation, with the attitude used and
ignored: goals reached, ATE, wall thickness. Then the slices of the missions with 10 degrees against the true scene, and
processor time and memory of a whole command with and without attitude.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from subprocess import DEVNULL, Popen
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from msgspec import Struct
from scipy.spatial import cKDTree

from mavnav.ground_truth.references import points_on
from mavnav.mapping.occupancy_grid import OCCUPIED, occupancy
from mavnav.mapping.slices import Slice
from mavnav.outputs.run import RunResult
from mavnav.pipelines.simulate import SimulationRequest, simulate_mission
from mavnav.pose import transform_points
from mavnav.simulation.mission import Flight, fly
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.laser import tilted_directions
from mavnav.simulation.world.scenario_file import load_scenario, scenario_path

LEVEL: Final = ("flight.tilt_noise_deg=0", "flight.max_tilt_deg=0", "flight.height_noise_mm=0")
REPEATS: Final = 5
NEAR_M, EDGE_M = 0.1, 0.05
"""A true cell is found, an occupied one right, within the first; heights are compared with the second as margin."""


class Case(Struct, frozen=True):
    """A row of the table: its name, and the settings of its missions."""

    name: str
    settings: tuple[str, ...]


def cases() -> list[Case]:
    """Return the planar mission, and the tilted ones with and without attitude."""
    found = [Case("level, 0 deg", (*LEVEL, "slam.attitude=off"))]
    for deg in (5, 10):
        for name, value in (("used", "auto"), ("ignored", "off")):
            found.append(Case(f"{deg} deg, {name}", (f"flight.tilt_noise_deg={deg}", f"slam.attitude={value}")))
    return found


def flown(scenario: str, settings: tuple[str, ...], seed: int, folder: Path) -> tuple[RunResult, dict[str, Any]]:
    """Fly a mission, write its numbers, and return the run with run.json."""
    chosen = load_scenario(scenario, settings, {"seed": seed})
    request = SimulationRequest(chosen, scenario_path(scenario), folder, force=True, outputs=("metrics",))
    return simulate_mission(request, lambda *_: None, 0.0)


def row(documents: list[dict[str, Any]]) -> str:
    """Return the cells of a row: goals, ATE (median, worst), wall thickness (median, p95), tilt, clearance, time."""
    missions = [d["mission"] for d in documents]
    ate = np.array([d["truth"].get("ate_rmse_m") or np.nan for d in documents]) * 1e3
    walls = np.array(
        [[d["wall_thickness"]["spread"][key] or np.nan for key in ("median_mm", "p95_mm")] for d in documents]
    )
    goals = sum(m["reached"] for m in missions)
    return (
        f"{goals}/{len(documents)} | {np.nanmedian(ate):.0f}, {np.nanmax(ate):.0f} | "
        f"{np.nanmedian(walls[:, 0]):.0f}, {np.nanmedian(walls[:, 1]):.0f} | "
        f"{np.median([m['tilt_p95_deg'] for m in missions]):.1f} | {min(m['min_clearance_m'] for m in missions):.2f} | "
        f"{np.median([d['timing']['cpu_s'] for d in documents]):.2f}"
    )


def table(scenario: str, seeds: int, folder: Path) -> None:
    """Print the table of all missions."""
    names = ("roll and pitch", "goals", "ATE, mm (median, worst)", "wall, mm (median, p95)", "tilt p95, deg")
    print(f"| {' | '.join(names)} | clearance, m | CPU, s |")
    print("|---|---|---|---|---|---|---|")
    for case in cases():
        documents = [flown(scenario, case.settings, seed, folder / "run")[1] for seed in range(seeds)]
        print(f"| {case.name} | {row(documents)} |", flush=True)
        for seed, document in enumerate(documents):
            if not document["mission"]["reached"]:
                print(f"    seed {seed}: {document['mission']['reason']}", flush=True)


def beam_ends(flight: Flight) -> np.ndarray:
    """Return where the beams of a mission truly ended, (n, 3): x, y in the map frame and the height, m."""
    spec, world, found = flight.scenario.laser.spec, flight.scenario.world, []
    poses = flight.map_T_laser.seen_from(flight.world_T_map).xyyaw
    for (x, y, yaw), (roll, pitch, height), scan in zip(poses, flight.tilts, flight.scans, strict=True):
        directions = tilted_directions(spec.angles_rad, roll, pitch, yaw)
        ranges, _ = world.cast_tilted((x, y), height, directions)
        ends = np.array((x, y, height)) + ranges[:, None] * directions
        found.append(ends[np.isfinite(scan.ranges_m) & (ranges < spec.range_max_m)])
    ends = np.concatenate(found)
    return np.column_stack((transform_points(flight.world_T_map.inverse(), ends[:, :2]), ends[:, 2]))


def surfaces(world: World, low_m: float, high_m: float) -> World:
    """Return what of a world lies between two heights, level surfaces as well."""
    walls, z = world.slice(low_m, high_m), world.plates[:, 6]
    return World(walls.segments, walls.arcs, plates=world.plates[(z > low_m) & (z < high_m)])


def compared(layer: Slice, world: World, ends: np.ndarray) -> tuple[int, ...]:
    """Count true wall cells and how many are found, those that beams met and how many are found, occupied and false."""
    grid = layer.grid
    occupied = (np.argwhere(occupancy(grid) == OCCUPIED)[:, ::-1] + 0.5) * grid.cell_m + grid.origin_xy_m
    true = cells_of(points_on(world.slice(layer.from_m, layer.to_m)), grid.cell_m)
    near = cKDTree(occupied)
    met = ends[(ends[:, 2] > layer.from_m) & (ends[:, 2] < layer.to_m), :2]
    seen = cKDTree(met).query(true)[0] < grid.cell_m
    found = near.query(true)[0] < NEAR_M
    off_m = surfaces(world, layer.from_m - EDGE_M, layer.to_m + EDGE_M).distance_m(occupied)
    return len(true), found.sum(), seen.sum(), (seen & found).sum(), len(occupied), (off_m > NEAR_M).sum()


def cells_of(xy_m: np.ndarray, cell_m: float) -> np.ndarray:
    """Return the middles of the cells that points lie in, each once."""
    return (np.unique(np.floor(xy_m / cell_m), axis=0) + 0.5) * cell_m


def slices(scenario: str, seeds: int, folder: Path) -> None:
    """Print how much of the true walls is in each slice, and how much is false; means of the missions that have it."""
    print("\n| slice, m (missions) | true wall cells | found | seen | found of these | occupied cells | false |")
    print("|---|---|---|---|---|---|---|")
    counts: dict[tuple[float, float], np.ndarray] = {}
    for seed in range(seeds):
        settings = cases()[3].settings
        flight = fly(load_scenario(scenario, settings, {"seed": seed}))
        run, _ = flown(scenario, settings, seed, folder / "run")
        ends, world = beam_ends(flight), flight.scenario.world.seen_from(flight.world_T_map)
        for layer in run.slices.layers if run.slices else ():
            key = (layer.from_m, layer.to_m)
            counts[key] = counts.get(key, np.zeros(7)) + np.array([*compared(layer, world, ends), 1])
    for (low_m, high_m), (true, found, seen, seen_found, occupied, false, n) in sorted(counts.items()):
        shares = f"{100 * found / true:.0f} % | {seen / n:.0f} | {100 * seen_found / seen:.1f} % | {occupied / n:.0f}"
        print(f"| {low_m:.2f} to {high_m:.2f} ({n:.0f}) | {true / n:.0f} | {shares} | {100 * false / occupied:.1f} % |")


def costs(scenario: str, folder: Path) -> Iterator[str]:
    """Yield processor time and peak memory of the command, the median of some runs in processes of their own."""
    for case in cases():
        words = [word for setting in case.settings for word in ("--set", setting)]
        command = [
            sys.executable,
            "-m",
            "mavnav",
            "simulate",
            scenario,
            "-o",
            str(folder / "cost"),
            "--force",
            "-q",
            *words,
        ]
        usages = [os.wait4(Popen(command, stdout=DEVNULL).pid, 0)[2] for _ in range(REPEATS)]
        cpu_s = np.median([u.ru_utime + u.ru_stime for u in usages])
        yield f"| {case.name} | {cpu_s:.2f} | {np.median([u.ru_maxrss for u in usages]) / 1024:.0f} |"


def main() -> None:
    """Fly all missions and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scenario", default="hover")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        table(arguments.scenario, arguments.seeds, Path(folder))
        slices(arguments.scenario, arguments.seeds, Path(folder))
        print("\n| roll and pitch | CPU of the command, s | memory, MB |\n|---|---|---|")
        for line in costs(arguments.scenario, Path(folder)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
