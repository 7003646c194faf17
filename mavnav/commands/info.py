"""``mavnav info LOG``: what a log holds, and everything odd about it."""

from __future__ import annotations

from collections import Counter
from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import reporting
from mavnav.commands.sources import local_log
from mavnav.commands.terminal import LISTED, Rows, note_problems, print_result
from mavnav.config.options import read_options
from mavnav.errors import ExitCode, MavnavError
from mavnav.units import DEG, NS, pluralize

if TYPE_CHECKING:
    from mavnav.commands.sources import LocalLog
    from mavnav.logs import Log, Survey
    from mavnav.logs.levelling import RecordedAttitude
    from mavnav.logs.records import Imu, Odometry
    from mavnav.pose import Pose

SCHEMA_VERSION = 1

EPILOG = """
[bold]Examples[/bold]
mavnav info drive.mcap
mavnav info rosbag2_folder --topic /front/scan
mavnav info drive.bag --json | jq .scans
ssh robot cat drive.mcap | mavnav info -
"""


@shared.with_options("topic", "strict")
def info(logs: shared.LogParts, *, json: shared.Json = False, quiet: shared.Quiet = False, **given: object) -> None:
    """Examine a log: topics, sensor, scans, rate, validity of ranges, odometry, and everything that is damaged."""
    options = read_options(given)
    with local_log(logs) as source:
        _print_info(source, options.get("topic"), options.get("strict", False), json=json, quiet=quiet)


def _print_info(log: LocalLog, name: str | None, strict: bool, *, json: bool, quiet: bool) -> None:
    from mavnav.logs import survey

    with reporting(quiet=quiet) as report:
        contents = survey(log.path, topic=name, strict=strict, progress=partial(report, "reading"), more=log.more)
    logs, error = _choices(contents, name)
    code = error.exit_code if error else ExitCode.DAMAGED_INPUT if contents.damage else ExitCode.DONE
    shown = document(contents, logs, code)
    shown["input"] |= {"path": log.name} | ({"parts": [*map(str, log.more)]} if log.more else {})
    if error and not json:  # the error line names its cause
        shown["damage"] = [each for each in shown["damage"] if each["what"] not in str(error)]
    print_result(shown, _rows(shown), json=json)
    if not json:
        note_problems(shown)
    raise error or typer.Exit(code)


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
        "odometry": _odometry(log.odometry) if log and log.odometry else None,
        "imu": _imu(log.imu) if log and log.imu else None,
        "attitude": _attitude(log.attitude) if log and log.attitude else None,
        "mounting": _mounting(log, log.base_T_laser) if log and log.base_T_laser else None,
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

    # JSON has no infinity: null means that the sensor has no limit.
    limit_m = None if log.sensor.range_max_m == float("inf") else log.sensor.range_max_m
    return asdict(log.sensor) | {
        "range_max_m": limit_m,
        "field_of_view_rad": log.sensor.field_of_view_rad,
        "stated_turn_s": log.sensor.stated_turn_s,
        "usual_turn_s": log.sensor.usual_turn_s(log.period_s),
        "plausible_sweep": log.sensor.has_plausible_sweep(log.period_s),
    }


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


def _imu(imu: Imu) -> dict[str, Any]:
    stamps_ns = imu.rotation.stamps_ns
    span_s = float(stamps_ns[-1] - stamps_ns[0]) * NS
    return {"topic": imu.topic, "messages": len(stamps_ns), "rate_hz": (len(stamps_ns) - 1) / span_s}


def _attitude(attitude: RecordedAttitude) -> dict[str, Any]:
    from mavnav.outputs.documents.sections import attitude_source
    from mavnav.outputs.files.document import plain

    described: dict[str, Any] = plain(attitude_source(attitude))
    return described


def _odometry(odometry: Odometry) -> dict[str, Any]:
    track = odometry.odom_T_base
    length_m = track.length_m if len(track) > 1 else 0.0
    return {"topic": odometry.topic, "source": odometry.source, "poses": len(track), "length_m": length_m}


def _mounting(log: Log, base_T_laser: Pose) -> dict[str, Any]:
    return {"source": log.mounting_source, "base_frame": log.base_frame, **base_T_laser._asdict()}


def _rows(document: dict[str, Any]) -> Rows:
    """Yield the rows of the table."""
    source, scans = document["input"], document["scans"]
    yield "log", " ".join([source["path"], *source.get("parts", [])])
    yield "format", f"{source['format']}, {source['size_bytes'] / 1e6:.1f} MB"
    yield from _list("topics", [f"{t['name']}  {t['type']}  {t['encoding']}  {t['count']}" for t in document["topics"]])
    skipped = "".join(f", {count} {reason.replace('_', ' ')}" for reason, count in scans["skipped"].items())
    suspect = f", {scans['suspect']} of the usable are suspect" if scans["suspect"] else ""
    yield "scans", f"{scans['usable']} usable of {scans['total']}{skipped}{suspect}"
    for topic in document["scan_topics"]:
        odometry, imu, findings = topic["odometry"], topic["imu"], topic["health"]["findings"]
        yield "scan topic", f"{topic['topic']}, frame {topic['frame_id']}, {topic['scans']['usable']} scans"
        yield "sensor", _sensor_text(topic["sensor"])
        yield "sweep", _sweep_text(topic["sensor"])
        yield from _time_rows(topic["time"])
        yield "ranges", _shares(topic["cleaning"])
        yield from _list("health", [f"{each['what']}: {each['advice']}" for each in findings], "healthy")
        poses = f"{odometry['topic']}, {odometry['poses']} poses, {odometry['length_m']:.2f} m" if odometry else "none"
        yield "odometry", poses
        if imu:
            yield "imu", f"{imu['topic']}, {imu['messages']} messages, {imu['rate_hz']:.0f} Hz"
        yield "attitude", _attitude_text(topic["attitude"])
        yield "mounting", _mounting_text(topic["mounting"])
    yield "state", _state(document)


def _list(name: str, lines: list[str], otherwise: str = "none") -> Rows:
    """Return a row for each line, the first with the name; without any line, one that says so."""
    return zip_longest([name], lines or [otherwise], fillvalue="")


def _state(document: dict[str, Any]) -> str:
    """Say in a line what to make of the log."""
    match document["exit_code"]:
        case ExitCode.DONE:
            odd = sum(len(topic["health"]["findings"]) for topic in document["scan_topics"])
            return f"sound; {pluralize(odd, 'finding')} of the sensor to check" if odd else "sound"
        case ExitCode.DAMAGED_INPUT:
            return f"damaged in {pluralize(len(document['damage']), 'place')}; what is intact can be used"
        case _:
            return "no scan can be used"


def _sensor_text(sensor: dict[str, Any]) -> str:
    limit = sensor["range_max_m"]
    reach = f"{sensor['range_min_m']:g} m to {limit:g} m" if limit else f"from {sensor['range_min_m']:g} m on"
    field, step = sensor["field_of_view_rad"] / DEG, sensor["angle_step_rad"] / DEG
    return f"{sensor['beams']} beams over {field:.1f} deg, step {step:.3f} deg, {reach}"


def _sweep_text(sensor: dict[str, Any]) -> str:
    stated_s, usual_s = sensor["stated_turn_s"], sensor["usual_turn_s"]
    if not stated_s:
        beam_s = usual_s / max(round(360 * DEG / abs(sensor["angle_step_rad"])), 1)
        text = f"a laser that turns once in {usual_s:.3g} s needs {beam_s:.3g} s a beam, which a replay tries"
        return f"no time_increment: right if all beams are taken at once; {text}"
    verdict = "plausible" if sensor["plausible_sweep"] else "not plausible, see health"
    return f"a turn in {stated_s:.3g} s by time_increment, {usual_s:.3g} s by the scans: {verdict}"


def _time_rows(time: dict[str, Any]) -> Rows:
    rate = f", {time['rate_hz']:.2f} Hz" if time["rate_hz"] else ""
    start = f"from {time['first_ns'] * NS:.3f} s, {time['stamp_source']} stamps"
    yield "time", f"{time['duration_s']:.2f} s{rate}, {start}"
    longest = max((gap["duration_s"] for gap in time["gaps"]), default=0.0)
    yield "gaps", f"{len(time['gaps'])}, the longest {longest:.2f} s" if time["gaps"] else "none"


def _shares(cleaning: dict[str, int]) -> str:
    beams = max(sum(cleaning.values()), 1)
    return ", ".join(f"{kind.replace('_', ' ')} {100 * n / beams:.2f} %" for kind, n in cleaning.items() if n)


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
    return f"{place} on {mounting['base_frame']}, by the transforms"
