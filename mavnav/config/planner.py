"""The planner's configuration: strict, in the paper's units, without slow imports."""

from __future__ import annotations

from typing import Annotated, Literal

from mavnav.config.strict import Strict, in_si, setting
from mavnav.units import DEG, MM

TechniqueName = Literal["wavefront", "field", "wall_following", "virtual_obstacles"]


class PlannerConfig(Strict, frozen=True):
    """Parameters of the planner (paper, "Path Planning"); see docs/planner.md.

    Forces have no unit: at force 1 the vehicle moves by ``max_step_mm`` in free space.
    """

    technique: Annotated[TechniqueName, setting("method against local minima")] = "wavefront"
    attraction_gain: Annotated[float, setting("force of the goal", gt=0, le=1_000_000)] = 1.0
    repulsion_gain: Annotated[
        float, setting("force of the occupied cells, see docs/planner.md", ge=0, le=1_000_000)
    ] = 0.5
    repulsion_range_mm: Annotated[float, setting("cells farther away do not repel", gt=0, le=5000)] = 600.0
    mass_kg: Annotated[
        float, setting("virtual mass; a larger one gives a path of less curvature", gt=0, le=1_000_000)
    ] = 1.0
    max_step_mm: Annotated[float, setting("longest command in the plane", gt=0, le=1000)] = 100.0
    max_turn_deg: Annotated[float, setting("largest turn of a command", gt=0, le=180)] = 15.0
    view_deg: Annotated[
        float, setting("the vehicle turns first if it is to move at a larger angle to its heading", gt=30, le=180)
    ] = 110.0
    safety_mm: Annotated[float, setting("clearance that commands keep where possible", ge=0, le=5000)] = 250.0
    least_safety_mm: Annotated[float, setting("clearance kept in narrow passages", ge=0, le=5000)] = 150.0
    min_hits: Annotated[
        int, setting("hits in and around a cell (5x5) that make it an obstacle; the paper has 1", ge=1, le=1_000_000)
    ] = 2
    min_share: Annotated[
        float,
        setting(
            "share of the beams reaching a cell that must end in it to make it an obstacle; the paper has 0", ge=0, le=1
        ),
    ] = 0.1
    plan_cell_mm: Annotated[float, setting("cell edge of the wavefront grid", ge=10, le=1000)] = 50.0
    stall_steps: Annotated[int, setting("steps within stall_mm that count as a stall", ge=2)] = 25
    stall_mm: Annotated[float, setting("a vehicle that stays within this distance has stalled", gt=0, le=1_000_000)] = (
        200.0
    )

    repulsion_range_m, max_step_m, stall_m = in_si(MM, "repulsion_range_mm", "max_step_mm", "stall_mm")
    safety_m, least_safety_m, plan_cell_m = in_si(MM, "safety_mm", "least_safety_mm", "plan_cell_mm")
    max_turn_rad, view_rad = in_si(DEG, "max_turn_deg", "view_deg")

    def __post_init__(self) -> None:
        """Raise ValueError if the clearances are not in order."""
        if self.least_safety_mm > self.safety_mm:
            raise ValueError(
                f"has least_safety_mm {self.least_safety_mm:g} above safety_mm {self.safety_mm:g}; lower it"
            )
