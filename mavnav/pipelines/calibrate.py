"""The pipeline of ``mavnav calibrate``: a log -> a track without odometry -> calibration -> document, file, picture."""

from __future__ import annotations

from functools import partial
from math import isfinite
from pathlib import Path
from shlex import quote
from typing import Any, Final

from msgspec import Struct, field
from msgspec.structs import replace

from mavnav.config.models import Config, OdometryConfig
from mavnav.config.options import ReplayOptions
from mavnav.errors import ExitCode, TopicError, UsageError, worst
from mavnav.logs import Log, check_log, open_log
from mavnav.logs.formats.detect import log_name
from mavnav.logs.records import Odometry
from mavnav.metrics.calibration.motion import Motions, motions_of
from mavnav.metrics.calibration.quantities import (
    LEAST_TURN_RAD,
    Calibration,
    QuantityKind,
    QuantityValue,
    calibration_of,
    motion_of,
    refusal,
)
from mavnav.outputs.directory import check_apart, check_file, write_file
from mavnav.outputs.files.document import plain, to_json, track_verdict, with_picture
from mavnav.outputs.pictures import calibration_picture
from mavnav.outputs.report.summary_page import calibration_summary, draw_png, write_summary
from mavnav.outputs.run import half_sweep_s
from mavnav.pipelines.maps import config_for_log
from mavnav.pose import Pose
from mavnav.profiling import Progress
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, LogOdometry, fit_odometry
from mavnav.slam.methods.registry import load_kernels
from mavnav.slam.pipeline import MEASURING, run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries import beam_order
from mavnav.units import DEG
from mavnav.version import DOCUMENT_HEAD

MOUNTING: Final = ("x_m", "y_m", "yaw_deg")
"""Quantities of the mounting; the others are settings that correct the odometry."""

RANGE_BIAS: Final = "an additive bias of all ranges moves the walls, not the track; measure a known distance"


class CalibrationRequest(Struct, frozen=True):
    """The log and what of it, the configuration of the track and its file, and the files to write, if any.

    ``name`` is what the log is called, its path if empty.
    """

    log: Path
    config: Config
    options: ReplayOptions[Path] = field(default_factory=ReplayOptions[Path])
    document: Path | None = None
    picture: Path | None = None
    report: Path | None = None
    force: bool = False
    config_file: Path | None = None
    name: str = ""


def calibrate(request: CalibrationRequest, progress: Progress) -> dict[str, Any]:
    """Calibrate laser and odometry of a log, and return the document.

    The exit code in it is 1 where nothing could be estimated, 5 where the track was lost, 3 where the log is damaged.
    Raises UsageError, TopicError (no odometry, too), NoScansError and OutputError.
    """
    _check(request)
    log, odometry = _open(request, progress)
    load_kernels(request.config, progress)
    config, warnings = config_for_log(request.config, log)
    outcome = run_slam(
        log.scans,
        config,
        log.period_s,
        log.odom_T_laser,
        rotation=log.imu.rotation if log.imu else None,
        on_step=lambda phase, done: progress(phase, done, log.counts.usable),
        last=MEASURING,
        base_T_laser=log.base_T_laser or Pose(),
        start_s=log.start_s,
        recorded_ns=odometry.recorded_ns,
        predicting=False,
    )
    outcome = replace(outcome, warnings=(*warnings, *outcome.warnings))
    progress("calibrating", 0, None)
    motions = _motions(log, odometry, outcome)
    verdict = track_verdict(outcome, log, request.config)
    verdict = replace(verdict, advice=with_picture(verdict.advice, ()))
    doubtful = outcome.doubt is not None and outcome.doubt.high
    result = calibration_of(motions, doubtful=doubtful)
    if outcome.lost_for_good or (doubtful and result.refused):
        result = refusal(f"{verdict.reason}; {verdict.advice}", motion_of(motions))
    document = _document(request, log, outcome, result)
    document |= {"verdict": plain(verdict), "headline": calibration_headline(document)}
    _write(request, document, result, motions)
    return document


def _check(request: CalibrationRequest) -> None:
    """Raise UsageError or OutputError for what can be known to fail before the work."""
    if request.config.method != "robust" or not request.config.final_pass:
        raise UsageError("calibrate: the track needs the robust method with its final pass; leave --set and --config")
    if request.config.odom == "off":
        raise UsageError("calibrate compares the laser with odometry; leave --odom off away, or name a topic")
    if request.config.odometry != OdometryConfig() or request.config.upside_down:
        raise UsageError("calibrate looks at a log as recorded; leave the settings odometry and upside_down out")
    options = request.options
    if "," in (options.get("topic") or ""):
        raise UsageError("calibrate takes one laser; name one --topic at a time")
    check_log(request.log, options.get("start_s"), options.get("end_s"))
    check_file(request.document, ".json", force=request.force)
    check_file(request.picture, ".png", force=request.force)
    check_file(request.report, ".html", force=request.force)
    files = {"--output": request.document, "--picture": request.picture, "--report": request.report}
    check_apart(files, (request.log, request.config_file))


def _open(request: CalibrationRequest, progress: Progress) -> tuple[Log, Odometry]:
    """Survey the log, and return it with its odometry; raises TopicError where it has no odometry to use."""
    options = request.options
    log = open_log(
        request.log,
        topic=options.get("topic"),
        odom=request.config.odom,
        start_s=options.get("start_s"),
        end_s=options.get("end_s"),
        strict=options.get("strict", False),
        progress=lambda done, total: progress("reading", done, total),
    )
    if log.odometry is None:
        known = [text for text in log.warnings if "odometry" in text]
        text = known[0] if known else "no odometry; record nav_msgs/Odometry or the transform odom -> base_link in /tf"
        raise TopicError(f"{request.log}: {text}")
    return log, log.odometry


def _motions(log: Log, odometry: Odometry, outcome: SlamResult) -> Motions:
    """Return the motions of the track, at the stamps that fit the odometry better: recorded, or averaged."""
    known = LogOdometry(odometry.odom_T_base, log.base_T_laser or Pose(), log.stamps_ns)
    fit = fit_odometry(known, outcome.trajectory, GOOD_ODOMETRY)
    track = known.with_mean_stamps(outcome.trajectory) if fit and fit.mean_stamps else None
    return motions_of(track or outcome.trajectory, odometry.odom_T_base, 2.0 * half_sweep_s(log, outcome))


def _document(request: CalibrationRequest, log: Log, outcome: SlamResult, result: Calibration) -> dict[str, Any]:
    assert log.odometry  # noqa: S101  checked by `_open`
    motion, quantities = result.motion, [_row(quantity, log) for quantity in result.quantities]
    order = _TURN if log.sensor.time_increment_s else "the scans have no time between their beams (time_increment is 0)"
    upside_down = None if result.mirrored is None else result.mirrored != log.upside_down
    overhead = log.upside_down if upside_down is None else upside_down
    code = ExitCode.GATE_FAILED if all(q["refused"] for q in quantities) else ExitCode.DONE
    codes = [code, ExitCode.TRACKING_LOST] if outcome.lost_for_good else [code]
    return {
        **DOCUMENT_HEAD,
        "verdict": None,
        "headline": "",
        "input": {
            "path": request.name or str(request.log),
            "topic": log.topic,
            "frame_id": log.frame_id,
            "base_frame": log.base_frame,
            "odometry": {"topic": log.odometry.topic, "source": log.odometry.source},
            "duration_s": round(log.duration_s, 3),
        },
        "tracking": {
            "scans": log.counts.usable,
            "tracked_share": round(outcome.tracked_share, 4),
            "lost": outcome.lost_for_good,
            "doubt": None if outcome.doubt is None else round(outcome.doubt.probability, 4),
        },
        "motion": {
            "path_m": round(motion.path_m, 3),
            "turned_deg": round(motion.turned_rad / DEG, 1),
            "odometry_path_m": round(motion.odom_path_m, 3),
            "odometry_turned_deg": round(motion.odom_turned_rad / DEG, 1),
            "steps": motion.steps,
            "correlation": None if result.fit is None else round(result.fit.correlation, 4),
        },
        "refused": result.refused or None,
        "quantities": quantities,
        "upside_down": _switch(upside_down, log.upside_down, _TURN if result.fit else result.refused),
        "beams_reversed": _switch(_is_reversed(log, outcome, result), False, order),
        "range_bias": {"value": None, "in_log": None, "agrees": None, "refused": RANGE_BIAS},
        "lines": {
            "static_transform": transform_line(quantities, log, overhead=overhead),
            "replay": replay_line(request, quantities, log, overhead=overhead),
        },
        "warnings": [with_picture(line, ()) for line in (*log.warnings, *outcome.warnings)],
        "damage": [{"what": damage.what, "where": damage.where} for damage in log.damage],
        "exit_code": int(worst([*codes, *(ExitCode.DAMAGED_INPUT for _ in log.damage[:1])])),
    }


def calibration_headline(document: dict[str, Any]) -> str:
    """Say first what differs from what the log says, or that nothing does."""
    if document["refused"]:
        return str(document["refused"])
    rows = {row["name"]: row for row in document["quantities"]}
    differing = {name: row["difference"] for name, row in rows.items() if row["agrees"] is False}
    texts = [_difference_text(name, differing[name]) for name in MOST_TELLING if name in differing]
    texts += [text for name, text in SWITCHES.items() if document[name]["agrees"] is False]
    known = sum(row["value"] is not None for row in rows.values())
    agreeing = f"the log agrees with all that is determined, {known} of {len(rows)} quantities"
    text = "; ".join(texts) or (agreeing if known else f"nothing is determined: {document['quantities'][0]['refused']}")
    return f"{text[0].upper()}{text[1:]}."


def _difference_text(name: str, difference: float) -> str:
    words = ("later", "too short", "right") if difference > 0 else ("earlier", "too long", "left")
    return MOST_TELLING[name].format(abs(difference), *words).replace("%", " %")


MOST_TELLING: Final = {
    "offset_s": "the laser's stamps are {0:.2f} s {1} than the odometry's",
    "distance_scale": "the distances of the odometry are {2} by {0:.1%}",
    "turn_scale": "the turns of the odometry are {2} by {0:.1%}",
    "x_m": "the laser is {0:.3f} m off in x",
    "y_m": "the laser is {0:.3f} m off in y",
    "yaw_deg": "the laser is turned by {0:.1f} deg",
    "veer_deg_per_m": "the odometry veers to the {3} by {0:.2f} deg per m",
}
"""What differs, the most telling first -> how it is said: of the absolute difference, and of its sign in words."""

SWITCHES: Final = {"upside_down": "the laser is mounted the other way up", "beams_reversed": "the beams are in reverse"}

_TURN: Final = f"the laser turns by less than {LEAST_TURN_RAD / DEG:.0f} deg in all"


def _row(quantity: QuantityValue, log: Log) -> dict[str, Any]:
    """Describe a quantity: what was found, what the log says now, and whether they agree.

    ``option`` is that of a replay which takes it; the mounting has one for three.
    """
    kind, value, ci95 = quantity.kind, quantity.value, quantity.ci95
    in_log = _in_log(kind, log)
    if value is not None and kind.name == "offset_s" and log.odometry:
        value += log.odometry.clock_s
    difference = None if value is None or in_log is None else value - in_log
    if difference is not None and kind.name == "yaw_deg":
        difference = (difference + 180.0) % 360.0 - 180.0
        value = in_log + difference if in_log is not None else value
    agrees = None if difference is None or ci95 is None else abs(difference) <= ci95
    return {
        "name": kind.name,
        "value": _round(value),
        "ci95": _round(ci95),
        "unit": kind.unit,
        "in_log": _round(in_log),
        "difference": _round(difference),
        "agrees": agrees,
        "refused": quantity.refused or None,
        "option": None if value is None or kind.name in MOUNTING else f"--set odometry.{kind.name}={value:.4f}",
    }


def _round(value: float | None) -> float | None:
    return None if value is None or not isfinite(value) else round(value, 4) + 0.0  # -0.0 becomes 0.0


def _in_log(kind: QuantityKind, log: Log) -> float | None:
    """Return what the log says of a quantity: the mounting in its transforms; odometry is taken as it is."""
    if kind.name not in MOUNTING:
        return kind.assumed
    if (mounting := log.base_T_laser) is None:
        return None
    return {"x_m": mounting.x_m, "y_m": mounting.y_m, "yaw_deg": mounting.yaw_rad / DEG}[kind.name]


def _switch(value: bool | None, in_log: bool, why: str) -> dict[str, Any]:
    """Describe a finding of yes or no; ``why`` it is refused where it is None."""
    agrees, refused = (None, why) if value is None else (value == in_log, None)
    return {"value": value, "in_log": in_log, "agrees": agrees, "refused": refused}


def _is_reversed(log: Log, outcome: SlamResult, result: Calibration) -> bool | None:
    """Return whether the beams are fired in the reverse of the listed order; None where nothing shows it."""
    if beam_order.WARNING in outcome.warnings:
        return True
    shown = log.sensor.time_increment_s and result.motion.turned_rad >= LEAST_TURN_RAD and not result.refused
    return False if shown else None


def _write(request: CalibrationRequest, document: dict[str, Any], result: Calibration, motions: Motions) -> None:
    """Write the files that are asked for; raises OutputError."""
    title = log_name(request.log)
    picture = partial(calibration_picture.write, motions, result.fit, title) if result.fit else None
    if request.document:
        write_file(request.document, lambda path: path.write_text(to_json(document), "utf-8"), force=request.force)
    if request.picture and picture:
        write_file(request.picture, picture, force=request.force)
    if request.report:
        summary = calibration_summary(document, title, draw_png(picture) if picture else None)
        write_file(request.report, partial(write_summary, summary), force=request.force)


def transform_line(rows: list[dict[str, Any]], log: Log, *, overhead: bool) -> str | None:
    """Return the command that publishes the mounting; None where a part of it is not known."""
    mounting = _mounting(rows)
    if mounting is None:
        return None
    x_m, y_m, yaw_rad = mounting
    roll = "3.14159" if overhead else "0"
    frames = f"--frame-id {quote(log.base_frame or 'base_link')} --child-frame-id {quote(log.frame_id)}"
    turned = f"--roll {roll} --pitch 0 --yaw {yaw_rad:z.4f}"
    return f"ros2 run tf2_ros static_transform_publisher --x {x_m:z.4f} --y {y_m:z.4f} --z 0 {turned} {frames}"


def reading_options(options: ReplayOptions[Path], odom: str) -> list[str]:
    """Return the options of a replay that read from a log what was calibrated."""
    given = {"--topic": options.get("topic"), "--odom": None if odom == "auto" else odom}
    words = [f"{option} {quote(value)}" for option, value in given.items() if value]
    return [*words, "--strict"] if options.get("strict") else words


def replay_line(request: CalibrationRequest, rows: list[dict[str, Any]], log: Log, *, overhead: bool) -> str | None:
    """Return the command that replays the log with all that differs from what it says; None where nothing does."""
    differing = {row["name"] for row in rows if row["value"] is not None and not row["agrees"]}
    mounting, words = _mounting(rows), list[str]()
    if mounting and (differing & {*MOUNTING} or overhead != log.upside_down):
        words.append(f"--extrinsic={','.join(f'{value:.4f}' for value in mounting)}")
        words += ["--set upside_down=true"] if overhead else []
    words += [row["option"] for row in rows if row["option"] and row["name"] in differing]
    reading = reading_options(request.options, request.config.odom)
    return " ".join(("mavnav replay", quote(request.name or str(request.log)), *reading, *words)) if words else None


def _mounting(rows: list[dict[str, Any]]) -> tuple[float, float, float] | None:
    """Return x, y and yaw of the laser, m, m, rad; None where one is not known."""
    x_m, y_m, yaw_deg = (next(row["value"] for row in rows if row["name"] == name) for name in MOUNTING)
    return None if None in (x_m, y_m, yaw_deg) else (x_m, y_m, yaw_deg * DEG)
