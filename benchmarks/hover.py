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
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL, Popen
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from mavnav.pipelines.simulate import SimulationRequest, simulate_mission
from mavnav.simulation.world import load_scenario
from mavnav.simulation.world.scenario_file import scenario_path

LEVEL: Final = ("flight.tilt_noise_deg=0", "flight.max_tilt_deg=0", "flight.height_noise_mm=0")
REPEATS: Final = 5


@dataclass(frozen=True)
class Case:
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


def flown(scenario: str, settings: tuple[str, ...], seed: int, folder: Path) -> dict[str, Any]:
    """Fly a mission, write its numbers and slices, and return run.json."""
    chosen = load_scenario(scenario, settings, {"seed": seed})
    request = SimulationRequest(chosen, scenario_path(scenario), folder, force=True, outputs=("metrics", "map"))
    return simulate_mission(request, lambda *_: None, 0.0)[1]


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
        documents = [flown(scenario, case.settings, seed, folder / "run") for seed in range(seeds)]
        print(f"| {case.name} | {row(documents)} |", flush=True)
        for seed, document in enumerate(documents):
            if not document["mission"]["reached"]:
                print(f"    seed {seed}: {document['mission']['reason']}", flush=True)


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
        print("\n| roll and pitch | CPU of the command, s | memory, MB |\n|---|---|---|")
        for line in costs(arguments.scenario, Path(folder)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
