"""The configuration: strict models and their defaults; ``loading`` reads files and presets.

A configuration is the defaults below, overlaid by the method's preset in ``configs/``, a file (``--config``),
single values (``--set robust.cell_mm=25``) and the command line's own options, in this order.
Lengths and angles are in the paper's units and say so in their names. The bounds are checked where values are read
(`loading.read_model`); the defaults need no check.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args

from msgspec import Meta, Struct, field, to_builtins
from msgspec.structs import force_setattr, replace

from mavnav.units import DEG, MM, MM2


class Strict(Struct, frozen=True, forbid_unknown_fields=True):
    """A frozen record that is read with all its bounds; unknown keys are refused.

    A value that is wrong only beside others is refused in ``__post_init__``, by a ValueError that begins with the key
    and a colon.
    """


class InSI:
    """A value of a section in SI units: ``cell_m`` of ``cell_mm``."""

    def __init__(self, key: str, unit: float) -> None:
        """Take the key and its unit, a constant of `mavnav.units`."""
        self._key, self._unit = key, unit

    def __get__(self, section: Strict, owner: type[Strict]) -> float:
        """Return the value."""
        return float(getattr(section, self._key) * self._unit)


def in_si(unit: float, *keys: str) -> Iterator[InSI]:
    """Return attributes of a section for its keys of one unit."""
    return (InSI(key, unit) for key in keys)


def setting(description: str, **bounds: Any) -> Meta:  # noqa: ANN401  of msgspec.Meta
    """Return the annotation of a field: its description and its bounds; NaN and infinity lie outside of two bounds."""
    return Meta(description=description, **bounds)


MethodName = Literal["robust", "paper"]


class GridSize(Strict, frozen=True):
    """Points of the search grid in the plane, ``NxM``."""

    nx: Annotated[int, Meta(ge=2, le=200)] = 10
    ny: Annotated[int, Meta(ge=2, le=200)] = 10

    @classmethod
    def parse(cls, text: str) -> GridSize:
        """Read ``10x10``; raises ValueError, which begins with the key ``grid``."""
        if not re.fullmatch(_GRID, text):
            raise ValueError("grid: should be NxM with 2 to 200 points a side; write for example --grid 10x10")
        nx, ny = map(int, text.lower().split("x"))
        return cls(nx, ny)

    def __str__(self) -> str:
        """Write as ``NxM``."""
        return f"{self.nx}x{self.ny}"

    def refine(self, factor: int) -> GridSize:
        """Return the grid with ``factor`` times the points on each axis."""
        return GridSize(self.nx * factor, self.ny * factor)

    @property
    def points(self) -> int:
        """Number of points in the plane."""
        return self.nx * self.ny


_SIDE: Final = "0*([2-9]|[1-9][0-9]|1[0-9][0-9]|200)"
_GRID: Final = f"^{_SIDE}[xX]{_SIDE}$"
"""Pattern of a search grid as text."""

if TYPE_CHECKING:
    Grid = GridSize
else:
    Grid = GridSize | Annotated[str, Meta(extra_json_schema={"pattern": _GRID})]
"""A search grid that may be given as text."""

MOST_YAW_SAMPLES: Final = 40
"""Yaw samples that go with the finest grids: the paper's Fig. 7 pairs 40 with 40x40."""


def paired_yaw_samples(grid: GridSize) -> int:
    """Return the number of yaw samples that goes with a grid: twice its points along an axis, 40 at most.

    That holds both pairs that the paper names, 20 with 10x10 and 40 with 40x40 (its Fig. 7).
    """
    return min(2 * max(grid.nx, grid.ny), MOST_YAW_SAMPLES)


class PaperExpert(Strict, frozen=True):
    """Readings of the paper's text, one by one; docs/paper.md has the sentences."""

    mixed_pixel_mm: Annotated[float, setting("cost step vii: least jump to both neighbors", gt=0, le=100_000)] = 100.0
    occlusion_mm: Annotated[float, setting("cost step viii: larger jumps are occlusions", gt=0, le=100_000)] = 300.0
    occlusion_shrink: Annotated[float, setting("factor on occlusion_mm by iteration; 1: fixed", gt=0, le=1)] = 1.0
    occlusion_least_mm: Annotated[float, setting("occlusion_mm shrinks no further", gt=0, le=100_000)] = 100.0
    gate_occlusion_mm: Annotated[float, setting("occlusion threshold of the acceptance", gt=0, le=100_000)] = 300.0
    gate_share: Annotated[float, setting("fewer of the valid beams within it are refused", ge=0, le=1)] = 0.0
    occluded: Annotated[Literal["left_out", "counted"], setting("occluded points; counted: as threshold")] = "left_out"
    cluster_gap_cells: Annotated[int, setting("empty cells in a thick wall along a ray", ge=0, le=1000)] = 0
    equal_cells: Annotated[Literal["nearest", "middle"], setting("of equal cells, which is the wall")] = "nearest"
    min_beams_share: Annotated[float, setting("fewer contributing points make no match", gt=0, le=1)] = 0.1
    min_beams_of: Annotated[Literal["scan", "valid"], setting("that share is of all beams, or of the valid")] = "scan"
    predict: Annotated[Literal["rest", "velocity"], setting("expected motion without commands")] = "rest"
    pivot: Annotated[Literal["centroid", "laser"], setting("the search turns the scan about this point")] = "centroid"
    shrink: Annotated[float, setting("narrowing of the search from iteration to iteration", ge=0.01, le=0.99)] = 0.3
    leave_no_gaps: Annotated[bool, setting("narrow no further than to the grid's spacing")] = True
    stop_mm: Annotated[float, setting("convergence in the plane", ge=1e-4, le=1000)] = 0.01
    stop_deg: Annotated[float, setting("convergence in yaw", ge=1e-4, le=90)] = 0.01
    converged: Annotated[Literal["both", "either"], setting("of plane and yaw, which must have converged")] = "both"
    extend_border: Annotated[bool, setting("move the search when the minimum lies on its border")] = True
    max_extensions: Annotated[int, setting("border extensions an iteration at most", ge=0, le=1000)] = 5
    refine_above_mm2: Annotated[float, setting("refine the grid above this coarse cost", gt=0, le=1e9)] = 300.0
    refine_factor: Annotated[int, setting("factor on the points of an axis; 1: no refinement", ge=1, le=10)] = 2
    give_up: Annotated[bool, setting("end a search that can only end far above the acceptance threshold")] = True

    mixed_pixel_m, occlusion_m, occlusion_least_m = in_si(MM, "mixed_pixel_mm", "occlusion_mm", "occlusion_least_mm")
    gate_occlusion_m = InSI("gate_occlusion_mm", MM)
    stop_m, stop_rad, refine_above_m2 = InSI("stop_mm", MM), InSI("stop_deg", DEG), InSI("refine_above_mm2", MM2)


class PaperConfig(Strict, frozen=True):
    """The paper's method. Every value is a reading of the paper's text; docs/paper.md has the sentences.

    The defaults are the reading nearest to the letter (``paper-literal``); ``paper`` is the one that works best.
    ``gate_range_mm`` is the range for which gate_mm2 and refine_above_mm2 hold: both grow with the scan's mean squared
    range; null: they are absolute.
    """

    cell_mm: Annotated[float, setting("cell edge of the map", ge=1, le=250)] = 14.0
    near_mm: Annotated[float, setting("cost step vi: nearer points are left out", ge=0, le=100_000)] = 100.0
    far_mm: Annotated[float, setting("cost step vi: farther points are left out", gt=0, le=300_000)] = 5000.0
    window_mm: Annotated[float, setting("half-width of the first search in the plane", gt=0, le=10_000)] = 200.0
    window_deg: Annotated[float, setting("half-width of the first yaw search", gt=0, le=180)] = 15.0
    gate_mm2: Annotated[float, setting("acceptance threshold: cost up to which scans are inserted", gt=0, le=1e9)] = (
        400.0
    )
    gate_range_mm: Annotated[float, setting("range of gate_mm2; null: any", gt=0, le=300_000)] | None = None
    expert: Annotated[PaperExpert, setting("for experts")] = PaperExpert()

    cell_m, near_m, far_m, window_m = in_si(MM, "cell_mm", "near_mm", "far_mm", "window_mm")
    window_rad, gate_m2, gate_range_m = InSI("window_deg", DEG), InSI("gate_mm2", MM2), InSI("gate_range_mm", MM)


class RobustExpert(Strict, frozen=True):
    """What only experts change: the numbers of the search, of the lines and of the acceptance; see docs/method.md.

    Levels of half-width ``hold_below_mm`` or less keep correspondences fixed and search yaw and plane jointly, but not
    for scans of fewer than ``sparse_points`` points. A match of few inliers (``retry_below``) is refused where the
    share of its points that contradict free space or occlusion exceeds ``conflicts_below``.
    """

    line_sigma_mm: Annotated[float, setting("Gaussian window of the local line fit", gt=0, le=1000)] = 60.0
    line_noise_mm: Annotated[float, setting("noise floor of the local line fit", gt=0, le=1000)] = 10.0
    waiting_share: Annotated[float, setting("refit lines at this share of new points to old ones", ge=0, le=1000)] = 0.2
    truncate_mm: Annotated[float, setting("distances are capped here", gt=0, le=10_000)] = 150.0
    near_window_mm: Annotated[float, setting("half-width of the first search; 0 skips it", ge=0, le=10_000)] = 50.0
    near_window_deg: Annotated[float, setting("half-width of that search in yaw", gt=0, le=180)] = 5.0
    window_mm: Annotated[float, setting("half-width of the search after a refused first one", gt=0, le=10_000)] = 350.0
    window_deg: Annotated[float, setting("half-width of that search in yaw", gt=0, le=180)] = 20.0
    final_window_mm: Annotated[float, setting("half-width of the final pass in the plane", gt=0, le=10_000)] = 50.0
    final_window_deg: Annotated[float, setting("half-width of the final pass in yaw", gt=0, le=180)] = 3.0
    final_truncate_mm: Annotated[float, setting("cap of distances in the final pass", gt=0, le=10_000)] = 50.0
    stop_mm: Annotated[float, setting("last spacing in the plane, halved in the final pass", ge=1e-3, le=1000)] = 1.3
    stop_deg: Annotated[float, setting("last spacing in yaw, halved in the final pass", ge=1e-4, le=90)] = 0.02
    max_extensions: Annotated[int, setting("border extensions a level at most", ge=0, le=1000)] = 3
    hold_below_mm: Annotated[float, setting("narrower levels keep correspondences", ge=0, le=100_000)] = 51.0
    overlap_mm: Annotated[float, setting("farthest points used within a cell; 0: all", ge=0, le=100_000)] = 120.0
    overlap_points: Annotated[float, setting("and least points of the line there", ge=0, le=1e6)] = 8.0
    first_level_points: Annotated[int, setting("sample of points on the first levels", ge=10, le=100_000)] = 100
    sparse_points: Annotated[int, setting("fewer points keep no correspondences", ge=0, le=1_000_000)] = 225
    retry_below: Annotated[float, setting("search wider under this share of inliers", ge=0, le=1)] = 0.8
    conflicts_below: Annotated[float, setting("visibility conflicts that refuse few inliers", ge=0, le=1)] = 0.15
    track_above: Annotated[float, setting("accept a match at this share of inliers", ge=0, le=1)] = 0.6
    regain_above: Annotated[float, setting("accept a match after a gap at this share of inliers", ge=0, le=1)] = 0.7

    line_sigma_m, line_noise_m, truncate_m = in_si(MM, "line_sigma_mm", "line_noise_mm", "truncate_mm")
    near_window_m, window_m, final_window_m = in_si(MM, "near_window_mm", "window_mm", "final_window_mm")
    near_window_rad, window_rad, final_window_rad = in_si(DEG, "near_window_deg", "window_deg", "final_window_deg")
    final_truncate_m, hold_below_m, overlap_m = in_si(MM, "final_truncate_mm", "hold_below_mm", "overlap_mm")
    stop_m, stop_rad = InSI("stop_mm", MM), InSI("stop_deg", DEG)


class RobustConfig(Strict, frozen=True):
    """The robust method: point to local line over the whole map, see docs/method.md."""

    cell_mm: Annotated[float, setting("cell edge of the map", ge=1, le=250)] = 20.0
    near_mm: Annotated[float, setting("nearer returns are not used", ge=0, le=100_000)] = 100.0
    far_mm: Annotated[float, setting("farther returns are not used", gt=0, le=300_000)] = 30000.0
    deskew: Annotated[Literal["auto", "on", "off"], setting("correct scans for motion during the sweep")] = "auto"
    voxel_mm: Annotated[float, setting("points are averaged in voxels of this size", gt=0, le=5000)] = 30.0
    min_points: Annotated[int, setting("scans with fewer points are not matched", ge=3, le=100_000)] = 30
    max_speed_m_s: Annotated[float, setting("reject faster motion", gt=0, le=1000)] = 3.0
    max_turn_deg_s: Annotated[float, setting("reject faster turns", gt=0, le=100_000)] = 300.0
    expert: Annotated[RobustExpert, setting("for experts")] = RobustExpert()

    cell_m, near_m, far_m, voxel_m = in_si(MM, "cell_mm", "near_mm", "far_mm", "voxel_mm")
    max_turn_rad_s = InSI("max_turn_deg_s", DEG)


class OdometryConfig(Strict, frozen=True):
    """What corrects odometry before it is used, as ``mavnav calibrate`` finds it (docs/calibrate.md)."""

    offset_s: Annotated[float, setting("time to add to the stamps of the odometry", ge=-100, le=100)] = 0.0
    distance_scale: Annotated[float, setting("factor on the distances of the odometry", gt=0, le=1000)] = 1.0
    turn_scale: Annotated[float, setting("factor on the turns of the odometry", gt=0, le=1000)] = 1.0
    veer_deg_per_m: Annotated[float, setting("turn to add to the odometry for every meter driven", ge=-90, le=90)] = 0.0


class Config(Strict, frozen=True):
    """Everything that decides a run's result besides the log and the version.

    ``azimuth`` is by default twice the points of the grid along an axis, 40 at most. ``search`` exhaustive evaluates
    every pose of every grid.
    """

    method: MethodName = "robust"
    grid: Annotated[Grid, setting("points of the search grid in the plane, as 10x10")] = GridSize()
    azimuth: Annotated[int, setting("yaw samples of the search", ge=2, le=2000)] = field(default_factory=int)
    odom: Annotated[str, setting("odometry used as motion prior: auto, off, or a topic")] = "auto"
    attitude: Annotated[str, setting("tilt and height of the laser, to level scans: auto, off, or a topic")] = "auto"
    slice_mm: Annotated[float, setting("thickness of the maps by height", ge=50, le=10_000)] = 300.0
    odometry: OdometryConfig = OdometryConfig()
    truth_at: Annotated[
        Literal["first", "middle", "last"], setting("beam of a scan at whose time a true pose with its stamp holds")
    ] = "first"
    upside_down: Annotated[bool, setting("the laser is mounted upside down, whatever the log says")] = False
    search: Annotated[Literal["pruned", "exhaustive"], setting("how poses are searched; same minimum")] = "pruned"
    final_pass: Annotated[bool, setting("match every scan once more against the finished map")] = True
    loop_closure: Annotated[Literal["auto", "off"], setting("detect and close loops (with the final pass)")] = "auto"
    robust: Annotated[RobustConfig, setting("settings of the method robust")] = RobustConfig()
    paper: Annotated[PaperConfig, setting("settings of the method paper")] = PaperConfig()

    slice_m = InSI("slice_mm", MM)

    def __post_init__(self) -> None:
        """Read the search grid where it is text, and choose the yaw samples where none are given."""
        if isinstance(self.grid, str):
            force_setattr(self, "grid", GridSize.parse(self.grid))
        if not self.azimuth:
            force_setattr(self, "azimuth", paired_yaw_samples(self.grid))

    def without_effect(self, keys: Iterable[str]) -> list[str]:
        """Return those of the dotted keys that ask for something that the method does not do."""
        others = tuple(f"{name}." for name in get_args(MethodName) if name != self.method)
        others += () if self.method == "robust" else ("odometry.",)
        asked = {"odom": self.odom != "off", "final_pass": self.final_pass, "loop_closure": self.loop_closure != "off"}
        unread = {key for key, on in asked.items() if on and self.method != "robust"}
        return [key for key in keys if key.startswith(others) or key in unread]

    def with_voxels(self, factor: float) -> Config:
        """Return the configuration with voxels of ``factor`` times their size."""
        return replace(self, robust=replace(self.robust, voxel_mm=factor * self.robust.voxel_mm))

    def document(self) -> dict[str, Any]:
        """Return the effective configuration as plain data, grid as text."""
        return {**to_builtins(self), "grid": str(self.grid)}


TechniqueName = Literal["wavefront", "field", "wall_following", "virtual_obstacles"]


class PlannerConfig(Strict, frozen=True):
    """Parameters of the planner (paper, "Path Planning"); see docs/planner.md.

    Forces have no unit: at force 1 the vehicle moves by ``max_step_mm`` in free space.
    """

    technique: Annotated[TechniqueName, setting("method against local minima")] = "wavefront"
    attraction_gain: Annotated[float, setting("force of the goal", gt=0, le=1_000_000)] = 1.0
    repulsion_gain: Annotated[float, setting("force of the occupied cells", ge=0, le=1_000_000)] = 0.5
    repulsion_range_mm: Annotated[float, setting("cells farther away do not repel", gt=0, le=5000)] = 600.0
    mass_kg: Annotated[float, setting("virtual mass; a larger one smooths the path", gt=0, le=1_000_000)] = 1.0
    max_step_mm: Annotated[float, setting("longest command in the plane", gt=0, le=1000)] = 100.0
    max_turn_deg: Annotated[float, setting("largest turn of a command", gt=0, le=180)] = 15.0
    view_deg: Annotated[float, setting("at a larger angle to its heading, the vehicle turns first", gt=30, le=180)] = (
        110.0
    )
    safety_mm: Annotated[float, setting("clearance that commands keep where possible", ge=0, le=5000)] = 250.0
    least_safety_mm: Annotated[float, setting("clearance kept in narrow passages", ge=0, le=5000)] = 150.0
    min_hits: Annotated[int, setting("least hits in 5x5 cells of an obstacle; paper: 1", ge=1, le=1_000_000)] = 2
    min_share: Annotated[float, setting("least share of beams that end in an obstacle; paper: 0", ge=0, le=1)] = 0.1
    plan_cell_mm: Annotated[float, setting("cell edge of the wavefront grid", ge=10, le=1000)] = 50.0
    open_cost: Annotated[float, setting("factor on the cost of wavefront cells far from walls", ge=1, le=100)] = 1.0
    stall_steps: Annotated[int, setting("steps within stall_mm that count as a stall", ge=2)] = 25
    stall_mm: Annotated[float, setting("a vehicle that stays within this has stalled", gt=0, le=1_000_000)] = 200.0

    repulsion_range_m, max_step_m, stall_m = in_si(MM, "repulsion_range_mm", "max_step_mm", "stall_mm")
    safety_m, least_safety_m, plan_cell_m = in_si(MM, "safety_mm", "least_safety_mm", "plan_cell_mm")
    max_turn_rad, view_rad = in_si(DEG, "max_turn_deg", "view_deg")

    def __post_init__(self) -> None:
        """Raise ValueError if the clearances are not in order."""
        if self.least_safety_mm > self.safety_mm:
            least_mm, most_mm = self.least_safety_mm, self.safety_mm
            raise ValueError(f"has least_safety_mm {least_mm:g} above safety_mm {most_mm:g}; lower it")
