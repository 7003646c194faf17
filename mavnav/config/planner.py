"""The planner's configuration: strict, in the paper's units, without any heavy import."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from mavnav.config.models import Strict

TechniqueName = Literal["wavefront", "field", "wall_following", "virtual_obstacles"]


class PlannerConfig(Strict):
    """What decides the commands besides map, pose and goal (paper, "Path Planning"); see docs/planner.md.

    Forces have no unit: 1 is the force that carries the vehicle at ``max_step_mm`` in the open.
    """

    technique: TechniqueName = Field("wavefront", description="what is done against local minima")
    attraction_gain: float = Field(1.0, gt=0, description="force of the goal")
    repulsion_gain: float = Field(0.5, ge=0, description="force of the occupied cells, see docs/planner.md")
    repulsion_range_mm: float = Field(600.0, gt=0, le=5000, description="cells farther away do not repel")
    mass_kg: float = Field(1.0, gt=0, description="virtual mass; a higher one gives a path of less curvature")
    max_step_mm: float = Field(100.0, gt=0, le=1000, description="longest command in the plane")
    max_turn_deg: float = Field(15.0, gt=0, le=180, description="largest command in azimuth")
    view_deg: float = Field(
        110.0, gt=30, le=180, description="the vehicle turns before it moves farther than this from where it looks"
    )
    safety_mm: float = Field(250.0, ge=0, le=5000, description="clearance that commands keep where they can")
    least_safety_mm: float = Field(150.0, ge=0, le=5000, description="clearance given up only where no other way is")
    min_hits: int = Field(2, ge=1, description="a cell with fewer hits in and around it is a stray, not a wall")
    min_share: float = Field(
        0.1, ge=0, le=1, description="a cell is a wall if this share of the beams that came to it ended in it"
    )
    plan_cell_mm: float = Field(50.0, ge=10, le=1000, description="cell edge of the wavefront's own grid")
    stall_steps: int = Field(25, ge=2, description="steps within stall_mm that count as a stall")
    stall_mm: float = Field(200.0, gt=0, description="a vehicle that stays within this distance has stalled")

    @model_validator(mode="after")
    def _safeties_in_order(self) -> Self:
        if self.least_safety_mm > self.safety_mm:
            msg = f"least_safety_mm {self.least_safety_mm:g} exceeds safety_mm {self.safety_mm:g}; lower it"
            raise ValueError(msg)
        return self
