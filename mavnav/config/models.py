"""The configuration: strict models and their defaults; ``loading`` reads files and presets.

A configuration is the defaults below, overlaid by the method's preset in ``configs/``, a file (``--config``),
single values (``--set robust.cell_mm=25``) and the command line's own options, in this order.
Lengths and angles are in the paper's units and say so in their names.

The models are dataclasses: pydantic, which takes 0.1 s to load, checks the values that are given (`loading.validated`)
by the metadata of the fields, which are keyword arguments of ``pydantic.Field``. The defaults need no check.
"""

from __future__ import annotations

from dataclasses import asdict, field, replace
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args

from mavnav.config.sections import Section, section
from mavnav.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable

MethodName = Literal["robust", "paper"]


_STRICT: Final = {"extra": "forbid", "allow_inf_nan": False}
"""Pydantic's settings: what is unknown is refused."""


def setting(default: Any, **checks: Any) -> Any:  # noqa: ANN401  the default of a field of any type
    """Return a field with its default; ``checks`` are its bounds and its description."""
    return field(default=default, metadata=checks)


@section
class GridSize(Section):
    """Points of the search grid in the plane, ``NxM``."""

    __pydantic_config__ = _STRICT

    nx: int = setting(10, ge=2, le=200)
    ny: int = setting(10, ge=2, le=200)

    @classmethod
    def parse(cls, text: str) -> GridSize:
        """Read ``10x10``; raises ConfigError."""
        parts = text.lower().split("x")
        if len(parts) != 2 or not all(p.isdecimal() for p in parts):
            msg = f"grid {text!r} is not of the form NxM; write for example --grid 10x10"
            raise ConfigError(msg)
        nx, ny = int(parts[0]), int(parts[1])
        if not (2 <= nx <= 200 and 2 <= ny <= 200):
            msg = f"grid {text!r} is out of range; each side takes 2 to 200 points, for example --grid 10x10"
            raise ConfigError(msg)
        return cls(nx=nx, ny=ny)

    def __str__(self) -> str:
        """Write as ``NxM``."""
        return f"{self.nx}x{self.ny}"

    def refined(self, factor: int) -> GridSize:
        """Return the grid with ``factor`` times the points on each axis."""
        return self if factor == 1 else replace(self, nx=self.nx * factor, ny=self.ny * factor)

    @property
    def points(self) -> int:
        """Number of points in the plane."""
        return self.nx * self.ny


_SIDE: Final = "0*([2-9]|[1-9][0-9]|1[0-9][0-9]|200)"
"""Pattern of the points along a side of a search grid, in its text."""


class _AsText:
    """The mark of a search grid that is read as text too, and written as text."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:  # noqa: ANN401  pydantic's types
        def parsed(value: object) -> object:
            return value if isinstance(value, (GridSize, dict)) else GridSize.parse(str(value))

        return {
            "type": "function-before",
            "function": {"type": "no-info", "function": parsed},
            "schema": handler(source),
        }

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> Any:  # noqa: ANN401  pydantic's types
        if handler.mode == "serialization":
            return {"type": "string"}
        return {"anyOf": [handler(schema), {"type": "string", "pattern": f"^{_SIDE}[xX]{_SIDE}$"}]}


MOST_YAW_SAMPLES: Final = 40
"""Yaw samples that go with the finest grids: the paper's Fig. 7 pairs 40 with 40x40."""


def paired_yaw_samples(grid: GridSize) -> int:
    """Return the number of yaw samples that goes with a grid: twice its points along an axis, 40 at most.

    That holds both pairs that the paper names, 20 with 10x10 and 40 with 40x40 (its Fig. 7).
    """
    return min(2 * max(grid.nx, grid.ny), MOST_YAW_SAMPLES)


@section
class PaperConfig(Section):
    """The paper's method. Every value is a reading of the paper's text; docs/paper.md has the sentences.

    The defaults are the reading nearest to the letter (``paper-literal``); ``paper`` is the one that works best.
    """

    __pydantic_config__ = _STRICT

    cell_mm: float = setting(14.0, ge=1, le=250, description="cell edge of the map")
    near_mm: float = setting(100.0, ge=0, le=100_000, description="cost step vi: nearer points are left out")
    far_mm: float = setting(5000.0, gt=0, le=300_000, description="cost step vi: farther points are left out")
    mixed_pixel_mm: float = setting(100.0, gt=0, le=100_000, description="cost step vii: least jump to both neighbors")
    occlusion_mm: float = setting(
        300.0, gt=0, le=100_000, description="cost step viii: larger radius differences are occlusions"
    )
    occlusion_shrink: float = setting(
        1.0, gt=0, le=1, description="factor on the occlusion threshold from iteration to iteration; 1: fixed"
    )
    occlusion_least_mm: float = setting(
        100.0, gt=0, le=100_000, description="the occlusion threshold shrinks no further than this"
    )
    occluded: Literal["left_out", "counted"] = setting(
        "left_out",
        description="occluded points are left out of sum and divisor, or count with the squared threshold",
    )
    cluster_gap_cells: int = setting(
        0, ge=0, le=1000, description="empty cells that a thick wall may contain along a ray"
    )
    equal_cells: Literal["nearest", "middle"] = setting(
        "nearest",
        description="of the cells of a thick wall with equally many hits: the nearest, or the one at its middle",
    )
    min_beams_share: float = setting(
        0.1, gt=0, le=1, description="fewer contributing points than this share make no match"
    )
    min_beams_of: Literal["scan", "valid"] = setting(
        "scan", description="that share is of all beams of the scan, or of those with a valid range"
    )
    predict: Literal["rest", "velocity"] = setting(
        "rest", description="without commands the laser is expected at rest, or moving on as before"
    )
    window_mm: float = setting(200.0, gt=0, le=10_000, description="half-width of the first search in the plane")
    window_deg: float = setting(15.0, gt=0, le=180, description="half-width of the first yaw search")
    pivot: Literal["centroid", "laser"] = setting("centroid", description="the search turns the scan about this point")
    shrink: float = setting(0.3, ge=0.01, le=0.99, description="narrowing of the search from iteration to iteration")
    leave_no_gaps: bool = setting(True, description="narrow no further than to the grid's spacing")
    stop_mm: float = setting(0.01, ge=1e-4, le=1000, description="convergence in the plane")
    stop_deg: float = setting(0.01, ge=1e-4, le=90, description="convergence in yaw")
    converged: Literal["both", "either"] = setting(
        "both", description="end the search once both plane and yaw have converged, or either"
    )
    extend_border: bool = setting(True, description="move the search when the minimum lies on its border")
    max_extensions: int = setting(5, ge=0, le=1000, description="border extensions an iteration at most")
    refine_above_mm2: float = setting(
        300.0, gt=0, le=1e9, description="refine the grid where the coarse cost stays above"
    )
    refine_factor: int = setting(
        2, ge=1, le=10, description="points an axis are multiplied by this; 1 turns refinement off"
    )
    give_up: bool = setting(True, description="end a search that can only end far above the acceptance threshold")
    gate_mm2: float = setting(
        400.0, gt=0, le=1e9, description="acceptance threshold: map and pose are updated at this cost or below"
    )
    gate_range_mm: float | None = setting(
        None,
        gt=0,
        le=300_000,
        description="range for which gate_mm2 and refine_above_mm2 hold: both grow with the scan's mean squared range; "
        "null: they are absolute",
    )


@section
class RobustConfig(Section):
    """The robust method: point to local line over the whole map, see docs/method.md."""

    __pydantic_config__ = _STRICT

    cell_mm: float = setting(20.0, ge=1, le=250, description="cell edge of the map")
    near_mm: float = setting(100.0, ge=0, le=100_000, description="nearer returns are not used")
    far_mm: float = setting(30000.0, gt=0, le=300_000, description="farther returns are not used")
    deskew: Literal["auto", "on", "off"] = setting(
        "auto", description="correct scans for motion during the sweep; auto detects the beam order"
    )
    voxel_mm: float = setting(
        30.0, gt=0, le=5000, description="points are averaged in voxels of this size before matching"
    )
    line_sigma_mm: float = setting(60.0, gt=0, le=1000, description="Gaussian window of the local line fit")
    line_noise_mm: float = setting(10.0, gt=0, le=1000, description="noise floor of the local line fit")
    waiting_share: float = setting(
        0.2,
        ge=0,
        le=1000,
        description="refit the lines of a cell once its new points exceed this share of the old ones",
    )
    truncate_mm: float = setting(150.0, gt=0, le=10_000, description="distances are capped here")
    near_window_mm: float = setting(
        50.0, ge=0, le=10_000, description="half-width of the first search around the prediction; 0 skips it"
    )
    near_window_deg: float = setting(5.0, gt=0, le=180, description="half-width of that search in yaw")
    window_mm: float = setting(
        350.0, gt=0, le=10_000, description="half-width of the second search, made where the first is not accepted"
    )
    window_deg: float = setting(20.0, gt=0, le=180, description="half-width of that search in yaw")
    final_window_mm: float = setting(50.0, gt=0, le=10_000, description="half-width of the final pass in the plane")
    final_window_deg: float = setting(3.0, gt=0, le=180, description="half-width of the final pass in yaw")
    final_truncate_mm: float = setting(50.0, gt=0, le=10_000, description="distances are capped here in the final pass")
    stop_mm: float = setting(
        1.3, ge=1e-3, le=1000, description="search ends at this spacing in the plane, the final pass at half of it"
    )
    stop_deg: float = setting(
        0.02, ge=1e-4, le=90, description="search ends at this yaw spacing, the final pass at half of it"
    )
    max_extensions: int = setting(3, ge=0, le=1000, description="border extensions a level at most")
    hold_below_mm: float = setting(
        51.0,
        ge=0,
        le=100_000,
        description="levels of this half-width or less keep correspondences fixed and search yaw and plane jointly",
    )
    overlap_mm: float = setting(
        120.0,
        ge=0,
        le=100_000,
        description="levels within a cell use only points this close to an occupied cell; 0: all points",
    )
    overlap_points: float = setting(
        8.0, ge=0, le=1e6, description="and only if the line there was fitted to at least this many points"
    )
    prior: float = setting(
        0.01, ge=0, le=1e6, description="motion-prior cost of a squared meter of distance from the odometry prediction"
    )
    first_level_points: int = setting(100, ge=10, le=100_000, description="sample of points used on the first levels")
    sparse_points: int = setting(
        225,
        ge=0,
        le=1_000_000,
        description="scans with fewer points do not use fixed correspondences on levels within a cell",
    )
    min_points: int = setting(30, ge=3, le=100_000, description="scans with fewer points are not matched")
    retry_below: float = setting(0.8, ge=0, le=1, description="search wider under this share of inliers")
    conflicts_below: float = setting(
        0.15,
        ge=0,
        le=1,
        description="reject a match of few inliers with this share of visibility conflicts (free space, occlusion)",
    )
    track_above: float = setting(0.6, ge=0, le=1, description="accept a match at this share of inliers")
    regain_above: float = setting(0.7, ge=0, le=1, description="accept a match after a gap at this share of inliers")
    max_speed_m_s: float = setting(3.0, gt=0, le=1000, description="reject faster motion")
    max_turn_deg_s: float = setting(300.0, gt=0, le=100_000, description="reject faster turns")


@section
class OdometryConfig(Section):
    """What corrects odometry before it is used, as ``mavnav calibrate`` finds it (docs/calibrate.md)."""

    __pydantic_config__ = _STRICT

    offset_s: float = setting(0.0, ge=-10, le=10, description="time to add to the stamps of the odometry")
    distance_scale: float = setting(1.0, gt=0, le=1000, description="factor on the distances of the odometry")
    turn_scale: float = setting(1.0, gt=0, le=1000, description="factor on the turns of the odometry")
    veer_deg_per_m: float = setting(
        0.0, ge=-90, le=90, description="turn to add to the odometry for every meter driven"
    )


@section
class Config(Section):
    """Everything that decides a run's result besides the log and the version."""

    __pydantic_config__ = _STRICT

    method: MethodName = "robust"
    grid: Annotated[GridSize, _AsText()] = GridSize()
    azimuth: int = field(
        default_factory=int,
        metadata={
            "ge": 2,
            "le": 2000,
            "description": "yaw samples of the search; default: twice the points of the grid along an axis, at most 40",
        },
    )
    odom: str = setting("auto", description="odometry used as motion prior: auto, off, or a topic")
    attitude: str = setting(
        "auto", description="tilt and height of the laser, by which scans are levelled: auto, off, or a topic"
    )
    slice_mm: float = setting(
        300.0, ge=50, le=10_000, description="thickness of the maps by height, where the height of the laser is known"
    )
    odometry: OdometryConfig = OdometryConfig()
    upside_down: bool = setting(
        False, description="the laser is mounted upside down, whatever the log says: its scans are turned over"
    )
    search: Literal["pruned", "exhaustive"] = setting(
        "pruned", description="exhaustive evaluates every pose of every grid and finds the same minimum"
    )
    final_pass: bool = setting(True, description="match every scan once more against the finished map")
    loop_closure: Literal["auto", "off"] = setting("auto", description="detect and close loops (with the final pass)")
    paper: PaperConfig = PaperConfig()
    robust: RobustConfig = RobustConfig()

    def __post_init__(self) -> None:
        """Choose the yaw samples where none are given."""
        if not self.azimuth:
            object.__setattr__(self, "azimuth", paired_yaw_samples(self.grid))

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
        return {**asdict(self), "grid": str(self.grid)}
