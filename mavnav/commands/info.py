"""``mavnav info LOG``: what a log holds, and everything odd about it."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import reporting
from mavnav.commands.terminal import LISTED, emit_json, note_problems, print_table
from mavnav.config.options import read_options
from mavnav.errors import ExitCode, MavnavError
from mavnav.units import DEG, NS, pluralize

if TYPE_CHECKING:
    from mavnav.logs import Log, Survey

SCHEMA_VERSION = 1

EPILOG = """
[bold]Examples[/bold]
mavnav info drive.mcap
mavnav info rosbag2_folder --topic /front/scan
mavnav info drive.bag --json | jq .scans
"""


@shared.with_options("topic", "strict")
def info(log: shared.LogFile, *, json: shared.Json = False, quiet: shared.Quiet = False, **given: object) -> None:
    """Examine a log: topics, sensor, scans, rate, validity of ranges, odometry, and everything that is damaged."""
    from mavnav.logs import survey

    options = read_options(given)
    name = options.get("topic")
    with reporting(quiet=quiet) as report:
        contents = survey(
            log,
            topic=name,
            strict=options.get("strict", False),
            progress=lambda done, total: report("reading", done, total),
        )
    logs, error = _choices(contents, name)
    if error is not None:
        shown = document(contents, logs, error.exit_code)
        if not json:  # the error line names its cause
            shown["damage"] = [each for each in shown["damage"] if each["what"] not in str(error)]
        _print_result(shown, json=json)
        raise error
    code = ExitCode.DAMAGED_INPUT if contents.damage else ExitCode.DONE
    _print_result(document(contents, logs, code), json=json)
    raise typer.Exit(code)


def _choices(survey: Survey, topic: str | None) -> tuple[list[Log], MavnavError | None]:
    """Return a log for every scan topic that is usable; where none is, the reason."""
    from mavnav.logs import choose

    logs, errors = [], []
    names: list[str | None] = [topic] if topic else [*sorted(survey.scans)] or [None]
    for name in names:
        try:
            logs.append(choose(survey, topic=name))
        except MavnavError as error:
            errors.append(error)
    return logs, None if logs else errors[0]


def document(survey: Survey, logs: list[Log], code: ExitCode) -> dict[str, Any]:
    """Return what ``--json`` prints.

    ``logs`` holds the usable scan topics. The fields about one topic are empty where there are several, or none;
    ``scan_topics`` has them for each.
    """
    from msgspec.structs import asdict

    log, topics = logs[0] if len(logs) == 1 else None, [_topic(each) for each in logs]
    return {
        "schema_version": SCHEMA_VERSION,
        "input": {
            "path": str(survey.path),
            "sha256": survey.sha256,
            "format": survey.format,
            "size_bytes": survey.size_bytes,
        },
        "topics": [asdict(topic) for topic in survey.topics],
        "scans": _counts(survey, logs),
        **(_topic(log) if log is None else topics[0]),
        "scan_topics": [{"scans": asdict(each.counts), **topic} for each, topic in zip(logs, topics, strict=True)],
        "damage": [asdict(damage) for damage in survey.damage],
        "warnings": _warnings(survey, logs),
        "exit_code": int(code),
    }


def _topic(log: Log | None) -> dict[str, Any]:
    """Return what is printed about one scan topic."""
    return {
        "topic": log.topic if log else None,
        "frame_id": log.frame_id if log else None,
        "sensor": _sensor(log) if log else None,
        "time": _time(log) if log else None,
        "health": _health(log) if log else None,
        "cleaning": log.cleaning if log else {},
        "odometry": _odometry(log) if log else None,
        "imu": _imu(log) if log else None,
        "attitude": _attitude(log) if log else None,
        "mounting": _mounting(log) if log else None,
    }


def _warnings(survey: Survey, logs: list[Log]) -> list[str]:
    texts = dict.fromkeys(text for log in logs for text in log.warnings) or dict.fromkeys(survey.warnings)
    if len(logs) > 1:
        names = ", ".join([log.topic for log in logs[:LISTED]] + ["..."] * (len(logs) > LISTED))
        texts[f"several scan topics ({names}); a replay needs --topic"] = None
    return list(texts)


def _counts(survey: Survey, logs: list[Log]) -> dict[str, Any]:
    """Add up the scans of all scan topics."""
    skipped: Counter[str] = Counter()
    for scans in survey.scans.values():
        skipped += scans.refused + scans.timeline(survey.window_s).skipped
    return {
        "total": sum(scans.total for scans in survey.scans.values()),
        "usable": sum(log.counts.usable for log in logs),
        "skipped": dict(sorted(skipped.items())),
        "suspect": sum(log.counts.suspect for log in logs),
    }


def _sensor(log: Log) -> dict[str, Any]:
    from msgspec.structs import asdict

    sensor = asdict(log.sensor)
    # JSON has no infinity: null means that the sensor has no limit.
    limit = sensor["range_max_m"]
    sensor["range_max_m"] = None if limit == float("inf") else limit
    return {**sensor, "field_of_view_rad": log.sensor.field_of_view_rad}


def _time(log: Log) -> dict[str, Any]:
    from msgspec.structs import asdict

    return {
        "first_ns": log.first_ns,
        "last_ns": log.last_ns,
        "duration_s": log.duration_s,
        "period_s": log.period_s,
        "rate_hz": 1.0 / log.period_s if log.period_s else None,
        "stamp_source": log.stamp_source,
        "gaps": [asdict(gap) for gap in log.gaps],
    }


def _health(log: Log) -> dict[str, Any]:
    from msgspec.structs import asdict

    from mavnav.config.models import RobustConfig
    from mavnav.logs.health import sensor_health

    health = sensor_health(log, RobustConfig().far_m)
    return {**asdict(health), "findings": [asdict(finding) for finding in health.findings]}


def _imu(log: Log) -> dict[str, Any] | None:
    if log.imu is None:
        return None
    turns = log.imu.rotation
    span_s = float(turns.stamps_ns[-1] - turns.stamps_ns[0]) * NS
    return {"topic": log.imu.topic, "messages": len(turns.stamps_ns), "rate_hz": (len(turns.stamps_ns) - 1) / span_s}


def _attitude(log: Log) -> dict[str, Any] | None:
    from mavnav.outputs.documents.slices_section import attitude_source
    from mavnav.outputs.files.document import plain

    return None if log.attitude is None else plain(attitude_source(log.attitude))


def _odometry(log: Log) -> dict[str, Any] | None:
    if log.odometry is None:
        return None
    track = log.odometry.odom_T_base
    return {
        "topic": log.odometry.topic,
        "source": log.odometry.source,
        "poses": len(track),
        "length_m": track.length_m if len(track) > 1 else 0.0,
    }


def _mounting(log: Log) -> dict[str, Any] | None:
    if log.base_T_laser is None:
        return None
    return {"source": log.mounting_source, "base_frame": log.base_frame, **log.base_T_laser._asdict()}


def _print_result(document: dict[str, Any], *, json: bool) -> None:
    """Print the document, or the table and on stderr what must not be missed."""
    if json:
        emit_json(document)
        return
    print_table(_rows(document))
    note_problems(document)


def _rows(document: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the table."""
    source, scans = document["input"], document["scans"]
    rows = [
        ("log", source["path"]),
        ("format", f"{source['format']}, {source['size_bytes'] / 1e6:.1f} MB"),
        *_topic_rows(document["topics"]),
    ]
    skipped = "".join(f", {count} {reason.replace('_', ' ')}" for reason, count in scans["skipped"].items())
    suspect = f", {scans['suspect']} of the usable are suspect" if scans["suspect"] else ""
    rows.append(("scans", f"{scans['usable']} usable of {scans['total']}{skipped}{suspect}"))
    for topic in document["scan_topics"]:
        rows += [
            ("scan topic", f"{topic['topic']}, frame {topic['frame_id']}, {topic['scans']['usable']} scans"),
            *_sensor_rows(topic["sensor"]),
            *_time_rows(topic["time"]),
            ("ranges", _shares(topic["cleaning"])),
            *_health_rows(topic["health"]),
            ("odometry", _odometry_text(topic["odometry"])),
            *_imu_row(topic["imu"]),
            ("attitude", _attitude_text(topic["attitude"])),
            ("mounting", _mounting_text(topic["mounting"])),
        ]
    return [*rows, ("verdict", _verdict(document))]


def _verdict(document: dict[str, Any]) -> str:
    """Say in a line what to make of the log."""
    match document["exit_code"]:
        case ExitCode.DONE:
            odd = sum(len(topic["health"]["findings"]) for topic in document["scan_topics"])
            return f"sound; {pluralize(odd, 'finding')} of the sensor to check" if odd else "sound"
        case ExitCode.DAMAGED_INPUT:
            return f"damaged in {pluralize(len(document['damage']), 'place')}; what is intact can be used"
        case _:
            return "no scan can be used"


def _topic_rows(topics: list[dict[str, Any]]) -> list[tuple[str, str]]:
    lines = [f"{t['name']}  {t['type']}  {t['encoding']}  {t['count']}" for t in topics] or ["none"]
    return [("topics" if k == 0 else "", line) for k, line in enumerate(lines)]


def _sensor_rows(sensor: dict[str, Any]) -> list[tuple[str, str]]:
    limit = sensor["range_max_m"]
    reach = f"{sensor['range_min_m']:g} m to {limit:g} m" if limit else f"from {sensor['range_min_m']:g} m on"
    field, step = sensor["field_of_view_rad"] / DEG, sensor["angle_step_rad"] / DEG
    return [("sensor", f"{sensor['beams']} beams over {field:.1f} deg, step {step:.3f} deg, {reach}")]


def _time_rows(time: dict[str, Any]) -> list[tuple[str, str]]:
    rate = f", {time['rate_hz']:.2f} Hz" if time["rate_hz"] else ""
    start = f"from {time['first_ns'] * NS:.3f} s, {time['stamp_source']} stamps"
    longest = max((gap["duration_s"] for gap in time["gaps"]), default=0.0)
    gaps = f"{len(time['gaps'])}, the longest {longest:.2f} s" if time["gaps"] else "none"
    return [("time", f"{time['duration_s']:.2f} s{rate}, {start}"), ("gaps", gaps)]


def _shares(cleaning: dict[str, int]) -> str:
    beams = max(sum(cleaning.values()), 1)
    return ", ".join(f"{kind.replace('_', ' ')} {100 * n / beams:.2f} %" for kind, n in cleaning.items() if n)


def _health_rows(health: dict[str, Any]) -> list[tuple[str, str]]:
    """Return a row for a healthy sensor, else one for each finding with what to do."""
    lines = [f"{finding['what']}: {finding['advice']}" for finding in health["findings"]] or ["healthy"]
    return [("health" if k == 0 else "", line) for k, line in enumerate(lines)]


def _odometry_text(odometry: dict[str, Any] | None) -> str:
    if odometry is None:
        return "none"
    return f"{odometry['topic']}, {odometry['poses']} poses, {odometry['length_m']:.2f} m"


def _imu_row(imu: dict[str, Any] | None) -> list[tuple[str, str]]:
    return [] if imu is None else [("imu", f"{imu['topic']}, {imu['messages']} messages, {imu['rate_hz']:.0f} Hz")]


def _attitude_text(attitude: dict[str, Any] | None) -> str:
    if attitude is None:
        return "none"
    tilt = f"tilt {attitude['tilt_median_deg']:.1f} deg in the median, {attitude['tilt_max_deg']:.1f} deg at most"
    low, high = attitude["height_min_m"], attitude["height_max_m"]
    height = "height unknown" if low is None else f"height {low:.2f} to {high:.2f} m"
    return f"{attitude['topic']}, {attitude['messages']} messages, {tilt}, {height}"


def _mounting_text(mounting: dict[str, Any] | None) -> str:
    if mounting is None:
        return "unknown"
    place = f"x {mounting['x_m']:z.3f} m, y {mounting['y_m']:z.3f} m, yaw {mounting['yaw_rad'] / DEG:z.2f} deg"
    return f"{place} on {mounting['base_frame']} ({mounting['source']})"
