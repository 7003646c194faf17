"""The world of a simulation: a scenario's walls and a laser that sees them; the planner does not know it."""

from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.laser import LaserModel, take_scan
from mavnav.simulation.world.scenario import Scenario, laser_model
from mavnav.simulation.world.scenario_file import load_scenario, scenario_schema

__all__ = ["LaserModel", "Scenario", "World", "laser_model", "load_scenario", "scenario_schema", "take_scan"]
