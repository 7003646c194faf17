"""The planner's configuration: strict, in the paper's units, without slow imports."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from mavnav.config.strict import Strict

TechniqueName = Literal["wavefront", "field", "wall_following", "virtual_obstacles"]


class PlannerConfig(Strict):
    """Parameters of the planner (paper, "Path Planning"); see docs/planner.md.

    Forces have no unit: at force 1 the vehicle moves by ``max_step_mm`` in free space.
    """

    technique: TechniqueName = Field("wavefront", description="method against local minima")
    attraction_gain: float = Field(1.0, gt=0, description="force of the goal")
    repulsion_gain: float = Field(0.5, ge=0, description="force of the occupied cells, see docs/planner.md")
    repulsion_range_mm: float = Field(600.0, gt=0, le=5000, description="cells farther away do not repel")
    mass_kg: float = Field(1.0, gt=0, description="virtual mass; a larger one gives a path of less curvature")
    max_step_mm: float = Field(100.0, gt=0, le=1000, description="longest command in the plane")
    max_turn_deg: float = Field(15.0, gt=0, le=180, description="largest turn of a command")
    view_deg: float = Field(
        110.0, gt=30, le=180, description="the vehicle turns first if it is to move at a larger angle to its heading"
    )
    safety_mm: float = Field(250.0, ge=0, le=5000, description="clearance that commands keep where possible")
    least_safety_mm: float = Field(150.0, ge=0, le=5000, description="clearance kept in narrow passages")
    min_hits: int = Field(
        2, ge=1, le=1_000_000, description="hits in and around a cell (5x5) that make it an obstacle; the paper has 1"
    )
    min_share: float = Field(
        0.1,
        ge=0,
        le=1,
        description="share of the beams reaching a cell that must end in it to make it an obstacle; the paper has 0",
    )
    plan_cell_mm: float = Field(50.0, ge=10, le=1000, description="cell edge of the wavefront grid")
    stall_steps: int = Field(25, ge=2, description="steps within stall_mm that count as a stall")
    stall_mm: float = Field(200.0, gt=0, description="a vehicle that stays within this distance has stalled")

    @model_validator(mode="after")
    def _safeties_in_order(self) -> Self:
        if self.least_safety_mm > self.safety_mm:
            msg = f"least_safety_mm {self.least_safety_mm:g} exceeds safety_mm {self.safety_mm:g}; lower it"
            raise ValueError(msg)
        return self
