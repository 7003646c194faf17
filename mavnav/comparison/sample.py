"""The default log of a comparison: the sample corridor.

Imported only when needed, because a mission needs kernels that a comparison does not need.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from mavnav.atomic_files import beside, writing
from mavnav.errors import OutputError
from mavnav.logs.writing.recorder import record
from mavnav.pipelines.simulate import recording_of
from mavnav.profiling import Progress
from mavnav.simulation.mission import fly
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.version import __version__

SCENARIO: Final = "corridor"
SETS: Final = ("seed=1", "vehicle.laser_x_mm=60")
"""Overrides of the scenario with which the sample log of a checkout was simulated."""

SHIPPED: Final = Path(__file__).parents[2] / "sample_logs" / f"{SCENARIO}.mcap"
"""Path of the sample log in a checkout; an installed package does not contain it."""


def sample_truth(directory: Path) -> Path:
    """Write the scenario of the sample log, whose walls are the true map, to ``directory``; return its path."""
    path = directory / "logs" / f"{SCENARIO}.yaml"
    with writing(path, "choose another directory with -o"), beside(path) as partial:
        partial.write_text(json.dumps(load_scenario(SCENARIO, SETS).document(), indent=1) + "\n", encoding="utf-8")
    return path


def sample_log(directory: Path, progress: Progress) -> Path:
    """Return the sample log of a checkout; else simulate the same mission once and store it in ``directory``."""
    if SHIPPED.is_file():
        return SHIPPED
    path = directory / "logs" / f"{SCENARIO}-{__version__}.mcap"
    if not path.is_file():
        progress(f"recording {path.name}", 0, None)
        flight = fly(load_scenario(SCENARIO, SETS), lambda phase, done: progress(phase, done, None))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{path.parent} cannot be made: {error.strerror}; choose another with -o") from error
        record(recording_of(flight), path)
    return path
