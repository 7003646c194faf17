"""The model of run.json: its sections and keys in their order, each number with its description.

A new key is a field here, or in the record of its section in `mavnav.metrics`. JSON Schema, names of gates, titles and
units follow from the fields (`mavnav.outputs.schema`). A field of `absent` is a key that not every run has.
"""

from dataclasses import dataclass, field
from typing import Any, Final

from mavnav.config.models import Config, MethodName
from mavnav.logs import Damage
from mavnav.metrics.fields import Measured, absent, number, text
from mavnav.metrics.map_quality import MapQuality
from mavnav.metrics.reference import Reference
from mavnav.metrics.wall_report import WallThicknessReport
from mavnav.outputs.continued_section import Continued
from mavnav.outputs.slices_section import AttitudeSource, MapSlice
from mavnav.outputs.tracking_section import Tracking


@dataclass(frozen=True, slots=True)
class LaserPose:
    """The pose of the laser on the robot's base."""

    x_m: float = field(metadata=number("forward"))
    y_m: float = field(metadata=number("to the left"))
    yaw_rad: float = field(metadata=number("counter-clockwise"))


@dataclass(frozen=True, slots=True)
class OdometrySource:
    """The odometry of the log: its topic, and whether it is of odometry messages or of transforms."""

    topic: str = field(metadata=text("topic of the odometry"))
    source: str = field(metadata=text("odom: odometry messages; tf: transforms"))


@dataclass(frozen=True, slots=True)
class ImuSource:
    """The inertial sensor of the log: its topic, and its messages."""

    topic: str
    messages: int = field(metadata=number("messages of the sensor"))


@dataclass(frozen=True, slots=True)
class RecordedTruthSource:
    """The recorded ground truth that the run is compared with; ``body_frame`` is what was tracked, null if unknown."""

    topic: str = field(metadata=text("topic of the ground truth"))
    body_frame: str | None = field(metadata=text("frame that was tracked, null if unknown"))


@dataclass(frozen=True, slots=True)
class Sensor:
    """The laser as it is in the first usable scan."""

    beams: int = field(metadata=number("beams of a scan"))
    field_of_view_deg: float = field(metadata=number("angle between the first beam and the last"))
    range_min_m: Measured = field(metadata=number("least range"))
    range_max_m: Measured = field(metadata=number("greatest range, null without a limit"))
    rate_hz: Measured = field(metadata=number("scans per second, by the median period"))


@dataclass(frozen=True, slots=True)
class Input:
    """The log, or the scenario of a simulated run, and what was read of it."""

    path: str = field(metadata=text("the log as it was named, or the scenario"))
    sha256: str = field(metadata=text("SHA-256 of the content"))
    size_bytes: int = field(metadata=number("size of the file, or of all files of a folder"))
    format: str = field(metadata=text("format of the log, with the program that compressed it"))
    topic: str = field(metadata=text("scan topic"))
    frame_id: str = field(metadata=text("frame of the scans"))
    stamp_source: str = field(metadata=text("header: stamps of the messages; log: of the recorder"))
    first_stamp_s: float = field(metadata=number("stamp of the first usable scan"))
    duration_s: float = field(metadata=number("time from the first usable scan to the last"))
    base_frame: str | None = field(metadata=text("frame of the base, null if unknown"))
    base_T_laser: LaserPose | None = field(metadata=text("pose of the laser on the base, null if unknown"))
    mounting_source: str | None = field(metadata=text("tf_static, or option for --extrinsic; null if unknown"))
    odometry: OdometrySource | None = field(metadata=text("odometry in the log, null without"))
    sensor: Sensor
    truth: RecordedTruthSource = field(default_factory=absent)
    imu: ImuSource = field(default_factory=absent)
    attitude: AttitudeSource = field(default_factory=absent)


@dataclass(frozen=True, slots=True)
class Scans:
    """What became of the scans."""

    total: int = field(metadata=number("scan messages in the log"))
    usable: int = field(metadata=number("scans that can be used"))
    processed: int = field(metadata=number("scans that were given to SLAM"))
    tracked: int = field(metadata=number("scans with a pose"))
    accepted: int = field(metadata=number("scans in the map, the same as tracked"))
    rejected: int = field(metadata=number("processed scans without a pose"))
    skipped: dict[str, int] = field(metadata=number("scans that cannot be used, by reason"))
    suspect: int = field(metadata=number("usable scans from where a checksum does not match, or could not be checked"))


@dataclass(frozen=True, slots=True)
class Closure:
    """A closed loop; times from the first scan."""

    from_scan: int = field(metadata=number("index of the earlier scan"))
    to_scan: int = field(metadata=number("index of the later scan"))
    from_s: float = field(metadata=number("time of the earlier scan"))
    to_s: float = field(metadata=number("time of the later scan"))
    correction_m: float = field(metadata=number("distance by which the later scan was off"))
    correction_deg: float = field(metadata=number("angle by which the later scan was off"))
    inliers: float = field(metadata=number("part of the points that agree with the old part of the map"))


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """The loops that were closed, and whether the trajectory was corrected by them."""

    closures: list[Closure] = field(metadata=text("closed loops"))
    rejected: int = field(metadata=number("closures that were found and not used"))
    corrected: bool = field(metadata=text("whether the trajectory was corrected"))


@dataclass(frozen=True, slots=True)
class StartPose:
    """A pose of the laser in the given map."""

    x_m: float = field(metadata=number("position in the map frame"))
    y_m: float = field(metadata=number("position in the map frame"))
    yaw_deg: float = field(metadata=number("heading in the map frame, counter-clockwise"))


@dataclass(frozen=True, slots=True)
class FoundPose:
    """The first accepted pose of the laser in the given map."""

    scan: int = field(metadata=number("index of the scan"))
    x_m: float = field(metadata=number("position in the map frame"))
    y_m: float = field(metadata=number("position in the map frame"))
    yaw_deg: float = field(metadata=number("heading in the map frame, counter-clockwise"))


@dataclass(frozen=True, slots=True)
class Localisation:
    """The map that the laser was localized in, where it was said to begin, and where it was found."""

    map: str = field(metadata=text("the given map"))
    start_pose: StartPose | None = field(metadata=text("start pose as given, null without"))
    found: FoundPose | None = field(metadata=text("first accepted pose, null if the laser was found nowhere"))


@dataclass(frozen=True, slots=True)
class Spread:
    """The distribution of a number over the scans; null without any."""

    mean: Measured = field(metadata=number("mean over the scans"))
    median: Measured = field(metadata=number("median over the scans"))
    min: Measured = field(metadata=number("least of the scans"))
    max: Measured = field(metadata=number("greatest of the scans"))


@dataclass(frozen=True, slots=True)
class Search:
    """The matches of the scans."""

    evaluations_per_scan: Spread = field(
        metadata=number("poses that the search tries for each scan", title="evaluations", better="lower")
    )
    iterations_per_scan: Spread = field(metadata=number("grids that the search evaluates for each scan"))
    converged_share: Measured = field(metadata=number("part of the searches that converged"))
    cost_m2: Spread = field(metadata=number("cost of the best pose"))
    beams_used: Spread = field(metadata=number("beams or points that contribute to a match"))
    inliers: Spread = field(metadata=number("part of the contributing points that agree with the map"))


@dataclass(frozen=True, slots=True)
class Map:
    """The published map."""

    cell_mm: float = field(metadata=number("edge of a cell"))
    rows: int = field(metadata=number("cells along y"))
    cols: int = field(metadata=number("cells along x"))
    cells: int = field(metadata=number("cells with a hit"))
    hits: int = field(metadata=number("hits of all cells"))
    size_m: list[float] = field(metadata=number("extent along x and y"))
    origin_xy_m: list[float] = field(metadata=number("corner of the first cell in the map frame"))
    accepted_share: float = field(
        metadata=number("share of the scans that are on the map", title="mapped", better="higher")
    )


@dataclass(frozen=True, slots=True)
class MissionResult:
    """How a simulated mission ended; lengths of the true path."""

    reached: bool = field(metadata=text("whether the goal was reached"))
    reason: str = field(metadata=text("how the mission ended: goal, or what stopped it"))
    steps: int = field(metadata=number("commands given"))
    path_length_m: float = field(metadata=number("length of the true path"))
    min_clearance_m: Measured = field(metadata=number("least distance from a wall"))
    goal_distance_m: Measured = field(metadata=number("distance from the goal at the end"))
    flight_height_m: float = field(default_factory=absent, metadata=number("commanded height of the laser"))
    tilt_p95_deg: float = field(
        default_factory=absent, metadata=number("true tilt of the laser, 95th percentile over the scans")
    )
    height_error_p95_m: float = field(
        default_factory=absent, metadata=number("distance from the commanded height, 95th percentile over the scans")
    )
    attitude_used: bool = field(
        default_factory=absent, metadata=text("whether scans were levelled by the measured attitude")
    )


@dataclass(frozen=True, slots=True)
class TruthErrors:
    """The tracked poses of a simulated run compared with the true ones; with too few poses only their number.

    ``ate_*`` after the best rigid motion, ``unaligned_*`` as they are, from the first laser pose on; ``final_*`` of the
    last tracked pose. ``wall_*`` compares the distance to the walls, read off the map along all beams, with the true
    one, where the relative error is the median (paper, "Corner Scenario": about 1 %).
    """

    ate_poses: int = field(metadata=number("tracked poses"))
    ate_rmse_m: Measured = field(default_factory=absent, metadata=number("root mean square error, aligned"))
    ate_median_m: Measured = field(default_factory=absent, metadata=number("median error, aligned"))
    ate_max_m: Measured = field(default_factory=absent, metadata=number("largest error, aligned"))
    unaligned_rmse_m: Measured = field(default_factory=absent, metadata=number("root mean square error, not aligned"))
    unaligned_median_m: Measured = field(default_factory=absent, metadata=number("median error, not aligned"))
    unaligned_max_m: Measured = field(default_factory=absent, metadata=number("largest error, not aligned"))
    final_error_m: float = field(default_factory=absent, metadata=number("position error of the last pose"))
    final_yaw_error_rad: float = field(default_factory=absent, metadata=number("heading error of the last pose"))
    final_aligned_error_m: float = field(
        default_factory=absent, metadata=number("position error of the last pose, aligned")
    )
    map_yaw_error_rad: float = field(
        default_factory=absent, metadata=number("rotation of the whole map, which the first headings leave")
    )
    wall_distance_m: Measured = field(default_factory=absent, metadata=number("distance to the walls on the map"))
    true_wall_distance_m: Measured = field(default_factory=absent, metadata=number("distance to the true walls"))
    wall_distance_error_share: Measured = field(
        default_factory=absent, metadata=number("relative error of the distance to the walls")
    )


@dataclass(frozen=True, slots=True)
class TimingReport:
    """The time that the run took until the outputs; rates are without compilation, which a second run does not need."""

    wall_s: float = field(metadata=number("seconds that the run took", title="time", better="lower"))
    cpu_s: float = field(metadata=number("processor time of the whole run", title="cpu", better="lower"))
    compile_s: float = field(metadata=number("time to load or compile the kernels"))
    stages: dict[str, float] = field(metadata=number("time by stage, outputs included", unit="s"))
    scans_per_s: float = field(metadata=number("processed scans per second"))
    realtime_factor: float = field(metadata=number("duration of the log as a multiple of the time that the run took"))


@dataclass(frozen=True, slots=True)
class Host:
    """The machine: model of the processor, and operating system with its release and architecture."""

    processor: str = field(metadata=text("model of the processor"))
    cores: int = field(metadata=number("logical processors"))
    system: str = field(metadata=text("operating system"))


@dataclass(frozen=True, slots=True)
class GivenPose:
    """A pose of the laser as it was given, on its base or in a map."""

    x_m: float = field(metadata=number("position"))
    y_m: float = field(metadata=number("position"))
    yaw_rad: float = field(metadata=number("heading, counter-clockwise"))


@dataclass(frozen=True, slots=True)
class Options:
    """The options of a replay, null where not given; those that change the configuration are in ``config``.

    ``config`` and ``sets`` are the configuration file or preset and the ``--set`` values. ``truth`` is a file, ``auto``
    or ``topic:NAME``. Relative paths count from ``folder`` of the provenance.
    """

    topic: str | None = field(metadata=text("--topic"))
    start_s: float | None = field(metadata=number("time after the first usable scan to begin at"))
    end_s: float | None = field(metadata=number("time after the first usable scan to end at"))
    odom: str = field(metadata=text("--odom"))
    extrinsic: GivenPose | None = field(metadata=text("--extrinsic"))
    strict: bool = field(metadata=text("--strict"))
    map: str | None = field(metadata=text("--map"))
    start_pose: GivenPose | None = field(metadata=text("--start-pose"))
    truth: str | None = field(metadata=text("--truth"))
    truth_map: str | None = field(metadata=text("--truth-map"))
    relations: str | None = field(metadata=text("--relations"))
    config: str | None = field(metadata=text("--config as typed"))
    sets: list[str] = field(metadata=text("--set as typed"))
    continue_from: str = field(default_factory=absent, metadata=text("--continue"))


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where the run comes from, without user names, passwords and queries of addresses.

    ``started`` is the time in UTC (ISO 8601), ``command`` the command line as typed, ``again`` one that repeats this
    run, both quoted for a shell; ``folder`` is the working directory. ``options`` are those of a replay.
    """

    started: str = field(metadata=text("start in UTC, ISO 8601"))
    command: str | None = field(metadata=text("command line as typed, null from Python"))
    again: str = field(metadata=text("command line that repeats the run from any folder"))
    folder: str | None = field(metadata=text("working directory, null from Python"))
    options: Options | None = field(metadata=text("options of a replay that are not in config, null for a mission"))
    host: Host


@dataclass(frozen=True, slots=True, kw_only=True)
class RunDocument:
    """A run: input, configuration, results and how it ended.

    ``outputs`` are the files written with their SHA-256. A ``partial`` run was stopped before the log ended. The same
    log, configuration and version give the same bytes of all sections but ``timing`` and ``provenance``.
    """

    schema_version: int = field(metadata=number("version of this format"))
    mavnav_version: str = field(metadata=text("version of mavnav"))
    python: str = field(metadata=text("version of Python"))
    libraries: dict[str, str] = field(metadata=text("version of each library"))
    input: Input
    config: Config
    method: MethodName = field(metadata=text("SLAM method"))
    grid: str = field(metadata=text("points of the search grid in x and y"))
    azimuth: int = field(metadata=number("yaw samples of the search"))
    scenario: dict[str, Any] = field(
        default_factory=absent, metadata={"description": "the effective scenario; see mavnav simulate --schema"}
    )
    scans: Scans
    cleaning: dict[str, int] = field(metadata=number("beams of the usable scans by kind"))
    tracking: Tracking
    loop_closure: LoopClosure
    localisation: Localisation = field(default_factory=absent)
    continued: Continued = field(default_factory=absent)
    search: Search
    wall_thickness: WallThicknessReport
    map_quality: MapQuality
    reference: Reference = field(default_factory=absent)
    map: Map
    slices: list[MapSlice] = field(default_factory=absent, metadata=text("the maps by height, the lowest first"))
    mission: MissionResult = field(default_factory=absent)
    truth: TruthErrors = field(default_factory=absent)
    timing: TimingReport
    provenance: Provenance
    damage: list[Damage] = field(metadata=text("what could not be read, or is suspect"))
    warnings: list[str] = field(metadata=text("what is odd about the log or the run, a line each"))
    outputs: dict[str, str] = field(metadata=text("SHA-256 of each file written, by its name"))
    partial: bool = field(metadata=text("whether the run was stopped before the last scan"))
    exit_code: int = field(metadata=number("exit code of the run, before gates"))


METRICS: Final = (
    "schema_version",
    "scans",
    "cleaning",
    "tracking",
    "loop_closure",
    "localisation",
    "search",
    "wall_thickness",
    "map_quality",
    "reference",
    "map",
    "slices",
    "mission",
    "truth",
)
"""The keys that metrics.json repeats: they depend on log, configuration and version alone, not on clock or machine."""
