"""The record of a run: everything that the writers need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, TypeVar

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.config.models import Config, MethodName
from mavnav.errors import ExitCode
from mavnav.logs import Log
from mavnav.mapping.occupancy_grid import Grid, known_area, occupancy
from mavnav.mapping.slices import Slices
from mavnav.metrics.floor_plan import turn_to_cuts
from mavnav.metrics.map_quality import MeasuredMap
from mavnav.metrics.reference import Reference, TrueMap
from mavnav.metrics.wall_spread import WallCuts, WallThicknessReport, wall_report
from mavnav.outputs.documents.run_json import External, Localisation, MissionResult, Provenance, TruthErrors
from mavnav.outputs.documents.sections import Continued
from mavnav.outputs.documents.verdict import EXTERNAL
from mavnav.pose import Trajectory
from mavnav.slam.result import SlamResult

if TYPE_CHECKING:
    from mavnav.sessions.group import Session

Walls: TypeAlias = "Truth | TrueMap | WallShapes"
Value = TypeVar("Value")

KEPT_CELLS: Final = 1 << 24
"""What is known of so many cells is kept from one writer to the next."""


class Timing(Struct, frozen=True):
    """What the run took, in seconds: by the clock, of the processor, and of it to load or compile the kernels.

    ``stages`` are the clock's seconds by stage, an account that goes on while the outputs are written; ``scans_s``
    those of every scan in the tracker.
    """

    wall_s: float
    cpu_s: float
    compile_s: float
    stages: Mapping[str, float] = field(default_factory=dict)
    scans_s: Sequence[float] = ()


class WallShapes(Struct, frozen=True):
    """Walls in the map frame: ``segments_map`` (n, 4) and ``arcs_map`` (m, 5), as `Truth` has them."""

    segments_map: NDArray[np.float64]
    arcs_map: NDArray[np.float64]


class Truth(WallShapes, frozen=True, kw_only=True):
    """What only a simulation knows, in the map frame: the true first pose of the laser.

    ``map_T_laser`` are the true poses; ``segments_map`` (n, 4) the straight walls, x1, y1, x2, y2 in m;
    ``arcs_map`` (m, 5) the curved ones: centre x, y and radius in m, start and sweep in rad, counter-clockwise.
    ``measured_by_hand`` are the walls as people measured them, where the scenario has them. ``slice_m`` are the heights
    between which the walls lie, at which an aerial vehicle flies; None where walls have no heights.
    """

    map_T_laser: Trajectory
    goal_xy_map_m: tuple[float, float]
    measured_by_hand: WallShapes | None = None
    slice_m: tuple[float, float] | None = None


class MissionRecord(Struct, frozen=True):
    """What a simulated run knows besides: the scenario's file, the effective scenario, and how the mission ended.

    ``sha256`` and ``size_bytes`` are those of the file, which need not exist any more.
    """

    path: Path
    sha256: str
    size_bytes: int
    scenario: dict[str, Any]
    result: MissionResult
    errors: TruthErrors


def picture_turn_rad(cuts: WallCuts | None, options: object) -> float:
    """Return how far the pictures of a run are turned to its walls; 0 where its ``options`` name a frame."""
    framing = [getattr(options, name, None) for name in ("align", "map", "continue_from")]
    return 0.0 if any(isinstance(value, str) for value in framing) else turn_to_cuts(cuts)


def require(value: Value | None, name: str) -> Value:
    """Return what a writer needs of a run; raises ValueError where the run does not have it."""
    if value is None:
        raise ValueError(f"{name} is not known")
    return value


def half_sweep_s(log: Log, outcome: SlamResult) -> float:
    """Return the time after its stamp at which the pose of a scan holds, s."""
    return log.mid_sweep_s if outcome.sweep_s is None else 0.5 * outcome.sweep_s


class RunResult(Struct, frozen=True, dict=True):
    """A log, how it was run, what came out, and what was measured on its map.

    ``metrics`` are None where no map was asked for. A mission of the simulator knows the truth besides. ``reference``
    is the comparison with references, and ``true_map`` the one among them. ``stopped`` is the code of the signal that
    stopped the run before the log ended. ``localisation`` says where the laser was found in a given map, ``external``
    at whose poses the scans were drawn instead of being tracked. ``slices`` is the map by height, None if heights are
    unknown or hardly vary. ``continued`` says which run was continued, and ``earlier`` are its sessions, in the map
    frame.
    ``address`` is where the log was fetched from, if it was; ``provenance`` says when and how the run was made.
    ``position_errors_m`` (n,) are those of the poses of the trajectory, NaN without a truth at that time; None without.
    """

    log: Log
    config: Config
    slam: SlamResult
    metrics: MeasuredMap | None
    timing: Timing
    provenance: Provenance
    truth: Truth | None = None
    mission: MissionRecord | None = None
    reference: Reference | None = None
    true_map: TrueMap | None = None
    stopped: ExitCode | None = None
    localisation: Localisation | None = None
    external: External | None = None
    address: str | None = None
    position_errors_m: NDArray[np.float64] | None = None
    slices: Slices | None = None
    continued: Continued | None = None
    earlier: tuple[Session, ...] = ()

    @property
    def name(self) -> str:
        """What the pictures call the run: its log, or its scenario."""
        return self.mission.path.stem if self.mission else self.log.path.name or str(self.log.path)

    @property
    def method(self) -> MethodName | Literal["external"]:
        """The method that made the poses."""
        return EXTERNAL if self.external else self.config.method

    @property
    def measures(self) -> MeasuredMap:
        """What was measured on its map; raises ValueError where no map was asked for."""
        if self.metrics is None:
            raise ValueError("the map is not measured")
        return self.metrics

    @cached_property
    def walls(self) -> WallThicknessReport:
        """How thick the walls are."""
        measures = self.measures
        return wall_report(measures.sections, measures.published, measures.cuts, self.slam.grid.cell_m)

    @cached_property
    def known(self) -> Grid:
        """The known part of the map."""
        return known_area(self.slam.grid)

    @property
    def cells(self) -> NDArray[np.int8]:
        """What is free, occupied and unknown in it; of a large map computed each time, to save memory."""
        return occupancy(self.known) if self.known.hits.size > KEPT_CELLS else self._cells

    @cached_property
    def _cells(self) -> NDArray[np.int8]:
        return occupancy(self.known)

    @cached_property
    def turn_rad(self) -> float:
        """How far pictures are turned to the walls; 0 where the frame of the map was asked for or given."""
        return picture_turn_rad(self.measures.cuts, self.provenance.options)

    @property
    def true_walls(self) -> Walls | None:
        """The true walls to draw on top of the map, None where they are not known."""
        given = self.true_map
        return self.truth or (given if given and len(given.segments_map) + len(given.arcs_map) else None)

    @property
    def exit_code(self) -> ExitCode:
        """How the run ended: a stop outweighs lost for good, that a failed mission or a damaged input."""
        if self.stopped is not None:
            return self.stopped
        if self.slam.lost_for_good or (self.continued and not self.continued.joined):
            return ExitCode.TRACKING_LOST
        if self.mission and not self.mission.result.reached:
            return ExitCode.GATE_FAILED
        return ExitCode.DAMAGED_INPUT if self.log.damage else ExitCode.DONE


def base_frame(log: Log) -> str:
    """Name the base's frame; an ``--extrinsic`` alone does not name it."""
    return (log.base_frame or "base_link").lstrip("/")
