"""The larger sections of run.json: tracking, the continued run, attitude and slices, and the options of a replay."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from msgspec import Struct, defstruct

from mavnav.config.option_kinds import NUMBER, POSE, SWITCH, Option
from mavnav.config.options import OPTIONS, ReplayOptions
from mavnav.logs.derived_scans import RecordedAttitude
from mavnav.mapping.occupancy_grid import OCCUPIED, occupancy
from mavnav.mapping.slices import Slice, slice_name
from mavnav.metrics.fields import OPTIONAL, Measured, number, text
from mavnav.metrics.wall_spread import PAPER_MIN_HITS, WallThicknessReport, wall_report
from mavnav.metrics.walls import wall_sections
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.config.models import Config
    from mavnav.sessions.group import Join


class Interval(Struct, frozen=True):
    """A stretch of scans without a pose; times from the first scan."""

    start_s: Annotated[float, number("first scan without a pose")]
    end_s: Annotated[float, number("last scan without a pose")]
    scans: Annotated[int, number("scans without a pose; 0: the path jumps faster than any vehicle")]
    recovered: Annotated[bool, text("whether tracking came back")]


class DoubtReason(Struct, frozen=True):
    """A reason to doubt the track, and where it holds; times from the first scan."""

    reason: Annotated[str, text("evidence of an error")]
    from_s: Annotated[float, number("first scan that shows it")]
    to_s: Annotated[float, number("last scan that shows it")]
    value: Annotated[float, number("strength: 1 is much", better="lower")]


class DoubtSection(Struct, frozen=True):
    """Whether trajectory or map may be wrong although the scans were accepted (docs/method.md, "Doubt").

    The strongest reason comes first; ``tried`` is what was done because of the doubt. ``probability`` is null on line,
    in a known map and for methods without a final pass.
    """

    probability: Annotated[
        Measured, number("probability that the track is off by 0.2 m or 5 deg somewhere", title="doubt", better="lower")
    ]
    reasons: Annotated[list[DoubtReason], text("strongest first")]
    tried: Annotated[list[str], text("what was done because of the doubt")]


class OtherTrack(Struct, frozen=True):
    """Another track of the log, with one thing changed. ``kept``: it replaced the track before it."""

    name: Annotated[str, text("what was changed")]
    kept: Annotated[bool, text("whether the other track was kept")]


class TrackedPart(Struct, frozen=True):
    """A stretch of scans with a map of its own at first; times from the first scan.

    ``joined``: its scans are in the map and in the trajectory of the run.
    """

    from_s: Annotated[float, number("first scan with a pose in the map of the part")]
    to_s: Annotated[float, number("last scan with a pose in the map of the part")]
    scans: Annotated[int, number("scans with a pose in the map of the part")]
    joined: Annotated[bool, text("whether its scans are in the map and in the trajectory")]


class OdometryNoise(Struct, frozen=True):
    """RMS errors of odometry over motions of a second, those of the fifth that fits worst left out."""

    m_per_m: Annotated[Measured, number("error of the distance, as a share of it")]
    rad_per_rad: Annotated[Measured, number("error of the turn, as a share of it")]


class OdometryLeftOut(Struct, frozen=True):
    """What was left out of the odometry as no vehicle moves so: jumps that were bridged, and poses."""

    jumps: Annotated[int, number("jumps that were bridged")]
    poses: Annotated[int, number("poses that do not continue the others")]
    first_s: Annotated[float, number("time of the first of them after the first pose", unit="s")]


class OdometryUse(Struct, frozen=True):
    """How the odometry of the log was used: as recorded where offset and scales are 0 and 1.

    Corrections are estimated anew beside the finished path.
    """

    used: Annotated[bool, text("false where it contradicts the scans")]
    offset_s: Annotated[float, number("time that was added to its stamps")]
    distance_scale: Annotated[float, number("factor on its distances")]
    turn_scale: Annotated[float, number("factor on its turns")]
    noise: Annotated[OdometryNoise, text("its errors, null where too little moves")]
    left_out: Annotated[list[OdometryLeftOut], text("what was left out of it")]


class Tracking(Struct, frozen=True):
    """Where the track was lost; ``lost`` means for good. ``frames`` are parent and child of each trajectory file.

    ``parts`` is absent where one map holds all tracked scans from the first usable one on, ``attempts`` where the log
    was tracked once.
    """

    lost: Annotated[bool, text("whether tracking was lost for good")]
    intervals: Annotated[list[Interval], text("stretches of scans without a pose")]
    tracked_share: Annotated[float, number("part of the processed scans with a pose", better="higher")]
    opinions: Annotated[int, number("tracks compared, of which the sharpest was kept")]
    path_length_m: Annotated[float, number("length of the path of the laser, standstill noise left out", title="path")]
    doubt: DoubtSection
    frames: Annotated[dict[str, list[str]], text("parent and child frame of each trajectory file")]
    holds_s: Annotated[float, number("time after its stamp at which the pose of a scan holds")] = 0.0
    parts: Annotated[list[TrackedPart], text("stretches with maps of their own, joined or not")] = OPTIONAL
    attempts: Annotated[list[OtherTrack], text("other tracks of the log, each with one thing changed")] = OPTIONAL
    odometry: Annotated[OdometryUse, text("how the odometry of the log was used, absent without odometry")] = OPTIONAL


class EarlierSession(Struct, frozen=True):
    """A session of the run that was continued, with its files in this run directory."""

    name: Annotated[str, text("name of the session")]
    scans: Annotated[int, number("scans with a pose")]
    trajectory: Annotated[str, text("file of its poses, in the map frame of this run")]
    recording: Annotated[str, text("file of its scans")]
    doubtful: Annotated[bool, text("whether its track was lost for good or doubtful")]


class JoinedTo(Struct, frozen=True):
    """A session whose key frames others matched."""

    name: Annotated[str, text("name of the session")]
    closures: Annotated[int, number("closures with it")]


class PlacementEvidence(Struct, frozen=True):
    """How a session was placed in the map of others, as merge.json has it (docs/merge.md)."""

    after: Annotated[str | None, text("session at whose end it was placed, null if it was found elsewhere")]
    searched: Annotated[int, number("key frames that were searched in the whole map")]
    found: Annotated[int, number("of them, those that fit in one place")]
    agreeing: Annotated[int, number("of them, those that agree")]
    tested: Annotated[int, number("key frames that closures were searched for")]
    closures: Annotated[int, number("of them, those that agree with the map")]
    contradicting: Annotated[int, number("of them, those that contradict the map")]
    overlap: Annotated[Measured, number("closures as a share of tested, null without any")]
    residual_mm: Annotated[Measured, number("RMS distance that the closures are left with")]
    residual_deg: Annotated[Measured, number("RMS angle that the closures are left with")]
    joined_to: Annotated[list[JoinedTo], text("sessions that it was joined to")]


class Continued(Struct, frozen=True):
    """The run that was continued. If the session did not join it, this run has the session alone, in its own frame."""

    run: Annotated[str, text("directory of the run that was continued")]
    name: Annotated[str, text("name of the new session")]
    joined: Annotated[bool, text("whether the session is in the map of the run")]
    why: Annotated[str | None, text("why it did not join, null if it did")]
    evidence: PlacementEvidence
    sessions: Annotated[list[EarlierSession], text("earlier sessions in the map")]


def evidence(join: Join) -> PlacementEvidence:
    """Describe what a session was joined by; of the one that others joined there is none."""
    known = bool(join.closures)
    return PlacementEvidence(
        after=join.after or None,
        searched=join.searched,
        found=join.found,
        agreeing=join.agreeing,
        tested=join.tested,
        closures=join.closures,
        contradicting=join.contradicting,
        overlap=round(join.closures / join.tested, 3) if join.tested else np.nan,
        residual_mm=round(join.residual_m / MM, 1) if known else np.nan,
        residual_deg=round(join.residual_rad / DEG, 3) if known else np.nan,
        joined_to=[JoinedTo(*pair) for pair in join.joined_to],
    )


class AttitudeSource(Struct, frozen=True):
    """What the scans were levelled by: roll, pitch and, if known, height of the laser."""

    topic: Annotated[str, text("topic of the attitude")]
    source: Annotated[str, text("pose: PoseStamped; odom: Odometry; imu: Imu, without height")]
    messages: Annotated[int, number("attitudes that are used")]
    tilt_median_deg: Annotated[Measured, number("half of the time the laser tilts less")]
    tilt_max_deg: Annotated[Measured, number("largest tilt of the laser")]
    height_min_m: Annotated[Measured, number("least height of the laser above the floor, null if unknown")]
    height_max_m: Annotated[Measured, number("greatest height of the laser above the floor, null if unknown")]
    ceiling_m: Annotated[Measured, number("height of the ceiling, null if none was found")]


class MapSlice(Struct, frozen=True):
    """The map of what was hit between two heights above the floor."""

    map: Annotated[str, text("file of the map, as map_server describes it")]
    middle_m: Annotated[float, number("height of its middle above the floor")]
    from_m: Annotated[float, number("height at which it begins")]
    to_m: Annotated[float, number("height at which it ends")]
    hits: Annotated[int, number("hits of all cells")]
    occupied: Annotated[int, number("occupied cells")]
    free: Annotated[int, number("free cells")]
    wall_thickness: WallThicknessReport


def attitude_source(attitude: RecordedAttitude) -> AttitudeSource:
    """Describe what the scans were levelled by."""
    tilts_deg, heights_m = attitude.tilt_rad / DEG, attitude.height_m
    known = attitude.has_heights
    return AttitudeSource(
        topic=attitude.topic,
        source=attitude.source,
        messages=len(attitude.stamps_ns),
        tilt_median_deg=float(np.median(tilts_deg)),
        tilt_max_deg=float(tilts_deg.max()),
        height_min_m=float(heights_m.min()) if known else np.nan,
        height_max_m=float(heights_m.max()) if known else np.nan,
        ceiling_m=attitude.ceiling_m,
    )


def map_slice(layer: Slice) -> MapSlice:
    """Describe a slice, and measure its walls."""
    grid, cells = layer.grid, occupancy(layer.grid)
    sections = {PAPER_MIN_HITS: wall_sections(grid.hits, grid.cell_m, PAPER_MIN_HITS)}
    published = wall_sections((cells == OCCUPIED).astype(np.uint16), grid.cell_m, 1)
    return MapSlice(
        map=f"{slice_name(layer)}.yaml",
        middle_m=layer.middle_m,
        from_m=layer.from_m,
        to_m=layer.to_m,
        hits=int(grid.hits.sum(dtype=np.int64)),
        occupied=int((cells == OCCUPIED).sum()),
        free=int((cells == 0).sum()),
        wall_thickness=wall_report(sections, published, None, grid.cell_m),
    )


class GivenPose(Struct, frozen=True):
    """A pose of the laser as it was given, on its base or in a map."""

    x_m: Annotated[float, number("position")]
    y_m: Annotated[float, number("position")]
    yaw_rad: Annotated[float, number("heading, counter-clockwise")]


_RECORDED: Final = {name: option for name, option in OPTIONS.items() if option.recorded or not option.setting}


def _field(name: str, option: Option) -> tuple[Any, ...]:
    describe = number if option.kind is NUMBER else text
    kind = GivenPose if option.kind is POSE else option.kind.stored
    always = option.recorded or option.absent or option.kind is SWITCH
    annotation: Any = Annotated[kind if always else kind | None, describe(option.help)]
    return (name, annotation, OPTIONAL) if option.absent else (name, annotation)


_FIELDS: Final = [
    *(_field(name, option) for name, option in _RECORDED.items() if not option.absent),
    ("config", Annotated[str | None, text("--config as typed")]),
    ("sets", Annotated[list[str], text("--set as typed")]),
    *(_field(name, option) for name, option in _RECORDED.items() if option.absent),
]

_DOC: Final = """The options of a replay, null where not given; those that change the configuration are in ``config``.

``config`` and ``sets`` are the configuration file or preset and the ``--set`` values. ``truth`` is a file, ``auto``
or ``topic:NAME``. Relative paths count from ``folder`` of the provenance.
"""

if TYPE_CHECKING:
    Options = Any
else:
    Options = defstruct("Options", _FIELDS, namespace={"__doc__": _DOC}, module=__name__, frozen=True)


def options_section(
    options: ReplayOptions[Path], config: Config, config_file: str | None, sets: Sequence[str]
) -> Options:
    """Return the section of a replay with its configuration, of a file or preset and of values as typed."""
    values = {name: getattr(config, option.setting) for name, option in _RECORDED.items() if option.setting}
    values |= {name: _plain(value) for name, value in options.items() if not OPTIONS[name].setting}
    missing = {n: False if o.kind is SWITCH else None for n, o in _RECORDED.items() if not o.absent}
    return Options(**missing | values, config=config_file, sets=list(sets))


def _plain(value: Any) -> Any:  # noqa: ANN401  the value of any option
    if isinstance(value, tuple):
        return GivenPose(*value)
    return str(value) if isinstance(value, Path) else value


class PoseJump(Struct, frozen=True):
    """A jump of given poses that the scans do not show."""

    at_s: Annotated[float, number("when, from the beginning of the log")]
    moved_m: Annotated[float, number("distance that the poses move more than the scans")]
    turned_deg: Annotated[float, number("turn that the poses make more than the scans")]
