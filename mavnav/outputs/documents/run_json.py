"""The model of run.json: its sections and keys in their order, each number with its description.

A new key is a field here, or in the record of its section in `mavnav.metrics`. JSON Schema, names of gates, titles and
units follow from the fields (`mavnav.outputs.documents.schema`). A field of `OPTIONAL` is a key that not every run has.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, TypeAlias

from msgspec import Struct

from mavnav.config.models import Config, MethodName
from mavnav.logs import Damage
from mavnav.metrics.fields import OPTIONAL, Measured, number, text
from mavnav.metrics.map_quality import MapQuality
from mavnav.metrics.reference import Reference
from mavnav.metrics.wall_spread import WallThicknessReport
from mavnav.outputs.documents.sections import AttitudeSource, Continued, MapSlice, Options, PoseJump, Tracking
from mavnav.outputs.documents.verdict import Verdict


class LaserPose(Struct, frozen=True):
    """The pose of the laser on the robot's base."""

    x_m: Annotated[float, number("forward")]
    y_m: Annotated[float, number("to the left")]
    yaw_rad: Annotated[float, number("counter-clockwise")]


class OdometrySource(Struct, frozen=True):
    """The odometry of the log: its topic, and whether it is of odometry messages or of transforms."""

    topic: Annotated[str, text("topic of the odometry")]
    source: Annotated[str, text("odom: odometry messages; tf: transforms")]


class ImuSource(Struct, frozen=True):
    """The inertial sensor of the log: its topic, and its messages."""

    topic: str
    messages: Annotated[int, number("messages of the sensor")]


class RecordedTruthSource(Struct, frozen=True):
    """The recorded ground truth that the run is compared with; ``body_frame`` is what was tracked, null if unknown."""

    topic: Annotated[str, text("topic of the ground truth")]
    body_frame: Annotated[str | None, text("frame that was tracked, null if unknown")]


class Sensor(Struct, frozen=True):
    """The laser as it is in the first usable scan."""

    beams: Annotated[int, number("beams of a scan")]
    field_of_view_deg: Annotated[float, number("angle between the first beam and the last")]
    range_min_m: Annotated[Measured, number("least range")]
    range_max_m: Annotated[Measured, number("greatest range, null without a limit")]
    rate_hz: Annotated[Measured, number("scans per second, by the median period")]


class LogInput(Struct, frozen=True):
    """The log, or the scenario of a simulated run, and what was read of it."""

    path: Annotated[str, text("the log as it was named, or the scenario")]
    sha256: Annotated[str, text("SHA-256 of the content")]
    size_bytes: Annotated[int, number("size of the file, or of all files of a folder")]
    format: Annotated[str, text("format of the log, with the program that compressed it")]
    topic: Annotated[str, text("scan topic")]
    frame_id: Annotated[str, text("frame of the scans")]
    stamp_source: Annotated[str, text("header: stamps of the messages; log: of the recorder")]
    first_stamp_s: Annotated[float, number("stamp of the first usable scan")]
    duration_s: Annotated[float, number("time from the first usable scan to the last")]
    base_frame: Annotated[str | None, text("frame of the base, null if unknown")]
    base_T_laser: Annotated[LaserPose | None, text("pose of the laser on the base, null if unknown")]
    mounting_source: Annotated[str | None, text("tf_static, or option for --extrinsic; null if unknown")]
    odometry: Annotated[OdometrySource | None, text("odometry in the log, null without")]
    sensor: Sensor
    start_s: Annotated[float, number("--start: time from the log's first usable scan to that of the run")] = OPTIONAL
    truth: RecordedTruthSource = OPTIONAL
    imu: ImuSource = OPTIONAL
    attitude: AttitudeSource = OPTIONAL
    parts: Annotated[list[str], text("further files of a log that was named in parts")] = OPTIONAL


Rule: TypeAlias = Literal["cost", "share", "beams"]


class Refusals(Struct, frozen=True):
    """The scans that one rule of the paper's method refused, and by how much; trajectory.csv has each of them.

    ``median`` and ``worst`` are, of ``cost``, the cost as a multiple of its threshold; of ``share``, the share of the
    valid beams that agree with the map; of ``beams``, the number of valid beams.
    """

    rule: Annotated[Rule, text("cost too high; too few beams agree; too few beams")]
    scans: Annotated[int, number("scans that the rule refused")]
    median: Annotated[Measured, number("median of the refused values", unit="1")]
    worst: Annotated[Measured, number("refused value farthest from the bound", unit="1")]


class Scans(Struct, frozen=True):
    """What became of the scans."""

    total: Annotated[int, number("scan messages in the log")]
    usable: Annotated[int, number("scans that can be used")]
    processed: Annotated[int, number("scans that were given to SLAM")]
    tracked: Annotated[int, number("scans with a pose")]
    accepted: Annotated[int, number("scans in the map, the same as tracked")]
    rejected: Annotated[int, number("processed scans without a pose")]
    skipped: Annotated[dict[str, int], number("scans that cannot be used, by reason")]
    suspect: Annotated[int, number("usable scans from where a checksum does not match, or could not be checked")]
    refused: Annotated[list[Refusals], text("why the paper's method refused scans")] = OPTIONAL


class ClosedLoop(Struct, frozen=True):
    """A closed loop; times from the first scan."""

    from_scan: Annotated[int, number("index of the earlier scan")]
    to_scan: Annotated[int, number("index of the later scan")]
    from_s: Annotated[float, number("time of the earlier scan")]
    to_s: Annotated[float, number("time of the later scan")]
    correction_m: Annotated[float, number("distance by which the later scan was off")]
    correction_deg: Annotated[float, number("angle by which the later scan was off")]
    inliers: Annotated[float, number("part of the points that agree with the old part of the map")]


class LoopClosure(Struct, frozen=True):
    """The loops that were closed, and whether the trajectory was corrected by them."""

    closures: Annotated[list[ClosedLoop], text("closed loops")]
    rejected: Annotated[int, number("closures that were found and not used")]
    corrected: Annotated[bool, text("whether the trajectory was corrected")]


class StartPose(Struct, frozen=True):
    """A pose of the laser in a map."""

    x_m: Annotated[float, number("position in the map frame")]
    y_m: Annotated[float, number("position in the map frame")]
    yaw_deg: Annotated[float, number("heading in the map frame, counter-clockwise")]


class FoundPose(Struct, frozen=True):
    """The first accepted pose of the laser in the given map."""

    scan: Annotated[int, number("index of the scan")]
    x_m: Annotated[float, number("position in the map frame")]
    y_m: Annotated[float, number("position in the map frame")]
    yaw_deg: Annotated[float, number("heading in the map frame, counter-clockwise")]


class Localisation(Struct, frozen=True):
    """The map that the laser was localized in, where it was said to begin, and where it was found."""

    map: Annotated[str, text("the given map")]
    start_pose: Annotated[StartPose | None, text("start pose as given, null without")]
    found: Annotated[FoundPose | None, text("first accepted pose, null if the laser was found nowhere")]


class External(Struct, frozen=True):
    """The trajectory at which the scans were drawn and judged; ``origin`` is the pose of the map frame in its frame."""

    name: Annotated[str, text("name of the trajectory")]
    source: Annotated[str, text("file, topic or frames of the poses, or the command that wrote them")]
    frame: Annotated[str, text("what the poses are of: laser, base or a frame of the log")]
    pose_at: Annotated[
        str, text("beam, first, middle or last, at whose time a pose holds, or whole: of the scan as recorded")
    ]
    poses: Annotated[int, number("poses of the trajectory")]
    origin: StartPose
    misfit_mm: Annotated[Measured, number("how far from its pose the median scan fits the map of all best")] = OPTIONAL
    late_s: Annotated[float, number("how late the poses are beside mavnav's own track, 0 if hardly")] = OPTIONAL
    distance_scale: Annotated[float, number("their distances as a multiple of its distances, 1 if hardly")] = OPTIONAL
    jumps: Annotated[list[PoseJump], text("their jumps that the scans do not show")] = OPTIONAL
    wall_s: Annotated[float, number("time that the command took by the clock")] = OPTIONAL
    cpu_s: Annotated[Measured, number("processor time of the command")] = OPTIONAL
    peak_memory_mb: Annotated[Measured, number("largest memory of a process of the command")] = OPTIONAL


class Spread(Struct, frozen=True):
    """The distribution of a number over the scans; null without any."""

    mean: Annotated[Measured, number("mean over the scans")]
    median: Annotated[Measured, number("median over the scans")]
    min: Annotated[Measured, number("least of the scans")]
    max: Annotated[Measured, number("greatest of the scans")]


class Search(Struct, frozen=True):
    """The matches of the scans."""

    evaluations_per_scan: Annotated[
        Spread, number("poses that the search tries for each scan", title="evaluations", better="lower")
    ]
    iterations_per_scan: Annotated[Spread, number("grids that the search evaluates for each scan")]
    converged_share: Annotated[Measured, number("part of the searches that converged")]
    cost_m2: Annotated[Spread, number("cost of the best pose")]
    beams_used: Annotated[Spread, number("beams or points that contribute to a match")]
    inliers: Annotated[Spread, number("part of the contributing points that agree with the map")]


class Map(Struct, frozen=True):
    """The published map."""

    cell_mm: Annotated[float, number("edge of a cell")]
    rows: Annotated[int, number("cells along y")]
    cols: Annotated[int, number("cells along x")]
    cells: Annotated[int, number("cells with a hit")]
    hits: Annotated[int, number("hits of all cells")]
    size_m: Annotated[list[float], number("extent along x and y")]
    origin_xy_m: Annotated[list[float], number("corner of the first cell in the map frame")]
    accepted_share: Annotated[float, number("share of the scans that were accepted", title="accepted", better="higher")]


class MissionResult(Struct, frozen=True):
    """How a simulated mission ended; lengths of the true path."""

    reached: Annotated[bool, text("whether the goal was reached")]
    reason: Annotated[str, text("how the mission ended: goal, or what stopped it")]
    steps: Annotated[int, number("scans taken; a command may take several")]
    path_length_m: Annotated[float, number("length of the true path")]
    min_clearance_m: Annotated[Measured, number("least distance from a wall; null if none is at flight height")]
    goal_distance_m: Annotated[Measured, number("distance from the goal at the end")]
    flight_height_m: Annotated[float, number("commanded height of the laser")] = OPTIONAL
    tilt_p95_deg: Annotated[float, number("true tilt of the laser, 95th percentile over the scans")] = OPTIONAL
    height_error_p95_m: Annotated[
        float, number("distance from the commanded height, 95th percentile over the scans")
    ] = OPTIONAL
    attitude_used: Annotated[bool, text("whether scans were levelled by the measured attitude")] = OPTIONAL


class TruthErrors(Struct, frozen=True):
    """The tracked poses of a simulated run compared with the true ones; with too few poses only their number.

    ``ate_*`` after the best rigid motion, ``unaligned_*`` as they are, from the first laser pose on; ``final_*`` of the
    last tracked pose. ``wall_*`` compares the distance to the walls, read off the map along all beams, with the true
    one, where the relative error is the median (paper, "Corner Scenario": about 1 %).
    """

    ate_poses: Annotated[int, number("tracked poses")]
    ate_rmse_m: Annotated[Measured, number("root mean square error, aligned")] = OPTIONAL
    ate_median_m: Annotated[Measured, number("median error, aligned")] = OPTIONAL
    ate_max_m: Annotated[Measured, number("largest error, aligned")] = OPTIONAL
    unaligned_rmse_m: Annotated[Measured, number("root mean square error, not aligned")] = OPTIONAL
    unaligned_median_m: Annotated[Measured, number("median error, not aligned")] = OPTIONAL
    unaligned_max_m: Annotated[Measured, number("largest error, not aligned")] = OPTIONAL
    final_error_m: Annotated[float, number("position error of the last pose")] = OPTIONAL
    final_yaw_error_rad: Annotated[float, number("heading error of the last pose")] = OPTIONAL
    final_aligned_error_m: Annotated[float, number("position error of the last pose, aligned")] = OPTIONAL
    map_yaw_error_rad: Annotated[float, number("rotation of the whole map, which the first headings leave")] = OPTIONAL
    wall_distance_m: Annotated[
        Measured, number("distance to the walls on the map, along the beam with the median relative error")
    ] = OPTIONAL
    true_wall_distance_m: Annotated[Measured, number("true distance along that beam")] = OPTIONAL
    wall_distance_error_share: Annotated[Measured, number("relative error of the distance along that beam")] = OPTIONAL


class ScanTime(Struct, frozen=True):
    """The time that the tracker takes for a scan on one core, by the clock, beside the time until the next scan.

    It is that from the scan at hand to its pose and the map that has it; all attempts to track the log count. The
    passes over the whole log, which an on-board computer does not run, are not in it.
    """

    median_ms: Annotated[float, number("median time of a scan", title="time a scan", better="lower")]
    p95_ms: Annotated[float, number("95 % quantile of the time of a scan", better="lower")]
    max_ms: Annotated[float, number("longest time of a scan", better="lower")]
    period_ms: Annotated[Measured, number("median time between two scans of the log")]


class TimingReport(Struct, frozen=True):
    """The time that the run took until the outputs; rates are without compilation, which a second run does not need."""

    wall_s: Annotated[float, number("seconds that the run took", title="time", better="lower")]
    cpu_s: Annotated[float, number("processor time of the whole run", title="cpu", better="lower")]
    compile_s: Annotated[float, number("time to load or compile the kernels")]
    stages: Annotated[dict[str, float], number("time by stage, outputs included", unit="s")]
    scans_per_s: Annotated[float, number("processed scans per second")]
    realtime_factor: Annotated[float, number("duration of the log as a multiple of the time that the run took")]
    scan: Annotated[ScanTime, text("time of a scan in the tracker")] = OPTIONAL
    peak_memory_mb: Annotated[Measured, number("largest memory of the process until the outputs")] = OPTIONAL


class Host(Struct, frozen=True):
    """The machine: model of the processor, and operating system with its release and architecture."""

    processor: Annotated[str, text("model of the processor")]
    cores: Annotated[int, number("logical processors")]
    system: Annotated[str, text("operating system")]


class Provenance(Struct, frozen=True):
    """Where the run comes from, without user names, passwords and queries of addresses.

    ``started`` is the time in UTC (ISO 8601), ``command`` the command line as typed, ``again`` one that repeats this
    run, both quoted for a shell; ``folder`` is the working directory. ``options`` are those of a replay, ``edits`` the
    command lines by which its map was edited.
    """

    started: Annotated[str, text("start in UTC, ISO 8601")]
    command: Annotated[str | None, text("command line as typed, null from Python")]
    again: Annotated[str, text("command line that repeats the run from any folder")]
    folder: Annotated[str | None, text("working directory, null from Python")]
    options: Annotated[Options | None, text("options of a replay that are not in config, null for a mission")]
    host: Host
    edits: Annotated[list[str], text("command lines by which the map was edited, the first one first")] = OPTIONAL


class RunDocument(Struct, frozen=True, kw_only=True):
    """A run: input, configuration, results and how it ended.

    ``wall_thickness``, ``map_quality`` and ``map`` are absent where no map was asked for. ``outputs`` are the files
    written with their SHA-256. A ``partial`` run was stopped before the log ended. The same log, configuration and
    version give the same bytes of all sections but ``timing`` and ``provenance``.
    """

    schema_version: Annotated[int, number("version of this format")]
    mavnav_version: Annotated[str, text("version of mavnav")]
    verdict: Verdict
    python: Annotated[str, text("version of Python")]
    libraries: Annotated[dict[str, str], text("version of each library")]
    input: LogInput
    config: Config
    method: Annotated[MethodName | Literal["external"], text("SLAM method; external: poses of another program")]
    grid: Annotated[str, text("points of the search grid in x and y")]
    azimuth: Annotated[int, number("yaw samples of the search")]
    scenario: Annotated[dict[str, Any], text("the effective scenario; see mavnav simulate --schema")] = OPTIONAL
    scans: Scans
    cleaning: Annotated[dict[str, int], number("beams of the usable scans by kind")]
    tracking: Tracking
    loop_closure: LoopClosure
    localisation: Localisation = OPTIONAL
    alignment: Annotated[StartPose, text("where --align put the scan that begins the map")] = OPTIONAL
    external: External = OPTIONAL
    continued: Continued = OPTIONAL
    search: Search
    wall_thickness: WallThicknessReport = OPTIONAL
    map_quality: MapQuality = OPTIONAL
    reference: Reference = OPTIONAL
    map: Map = OPTIONAL
    slices: Annotated[list[MapSlice], text("the maps by height, the lowest first")] = OPTIONAL
    mission: MissionResult = OPTIONAL
    truth: TruthErrors = OPTIONAL
    timing: TimingReport
    provenance: Provenance
    damage: Annotated[list[Damage], text("what could not be read, or is suspect")]
    warnings: Annotated[list[str], text("what is odd about the log or the run, a line each")]
    outputs: Annotated[dict[str, str], text("SHA-256 of each file written, by its name")]
    partial: Annotated[bool, text("whether tracking, or a pass over the whole log after it, was stopped")]
    exit_code: Annotated[int, number("exit code of the run, before gates")]


METRICS: Final = (
    "schema_version", "verdict", "scans", "cleaning", "tracking", "loop_closure", "localisation", "external", "search",
    "wall_thickness", "map_quality", "reference", "map", "slices", "mission", "truth",
)  # fmt: skip
"""The keys that metrics.json repeats: they depend on log, configuration and version alone, not on clock or machine."""
