"""The world of a simulation: a scenario's walls, a laser that sees them, and nobody who may tell the planner."""

from mavnav.world.geometry import World
from mavnav.world.laser import LASERS, LaserModel, take_scan
from mavnav.world.scenario import Scenario, laser_model
from mavnav.world.scenario_file import load_scenario, scenario_schema

__all__ = [
    "LASERS",
    "LaserModel",
    "Scenario",
    "World",
    "laser_model",
    "load_scenario",
    "scenario_schema",
    "take_scan",
]
