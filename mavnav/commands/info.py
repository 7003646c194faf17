"""``mavnav info LOG``: what a log holds, and everything odd about it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands.progress import reporting
from mavnav.commands.terminal import console, emit, note, printable
from mavnav.errors import ExitCode, MavnavError
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from mavnav.logs import Log, Survey

SCHEMA_VERSION = 1
_LISTED = 10

EPILOG = """
[bold]Examples[/bold]

mavnav info drive.mcap

mavnav info rosbag2_folder --topic /front/scan

mavnav info drive.bag --json | jq .scans
"""


def info(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="MCAP file, ROS 1 bag, ROS 2 bag folder or .db3.", show_default=False)
    ],
    *,
    topic: Annotated[str | None, typer.Option(help="Scan topic, where there are several.", show_default=False)] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")] = False,
) -> None:
    """Show what a log holds: topics, sensor, scans, rate, validity of ranges, odometry, damage."""
    from mavnav.logs import choose, survey

    with reporting(quiet=quiet) as report:
        found = survey(log, topic=topic, progress=lambda done, total: report("reading", done, total))
    try:
        chosen = choose(found, topic=topic)
    except MavnavError as error:
        _tell(document(found, None, error.exit_code), json=json)
        raise
    code = ExitCode.DAMAGED_INPUT if chosen.damage else ExitCode.DONE
    _tell(document(found, chosen, code), json=json)
    raise typer.Exit(code)


def document(found: Survey, log: Log | None, code: ExitCode) -> dict[str, Any]:
    """Return what ``--json`` prints.

    ``log`` is None where no scans can be used: the fields about the scans are then empty.
    """
    return {
        "schema_version": SCHEMA_VERSION,
        "input": {
            "path": str(found.path),
            "sha256": found.sha256,
            "format": found.format,
            "size_bytes": found.size_bytes,
        },
        "topics": [asdict(topic) for topic in found.topics],
        "topic": log.topic if log else None,
        "frame_id": log.frame_id if log else None,
        "scans": asdict(log.counts) if log else _unused_counts(found),
        "sensor": _sensor(log) if log else None,
        "time": _time(log) if log else None,
        "cleaning": log.cleaning if log else {},
        "odometry": _odometry(log) if log else None,
        "mounting": _mounting(log) if log else None,
        "damage": [asdict(damage) for damage in found.damage],
        "warnings": list(log.warnings if log else found.warnings),
        "exit_code": int(code),
    }


def _unused_counts(found: Survey) -> dict[str, Any]:
    """Count the scans of a log of which none is used: those of every scan topic, with the reasons of the only one."""
    total = sum(scans.total for scans in found.scans.values())
    skipped: dict[str, int] = {}
    if len(found.scans) == 1:
        scans = next(iter(found.scans.values()))
        skipped = dict(sorted((scans.refused + scans.timeline(found.window_s).skipped).items()))
    return {"total": total, "usable": 0, "skipped": skipped, "suspect": 0}


def _sensor(log: Log) -> dict[str, Any]:
    sensor = asdict(log.sensor)
    # JSON has no infinity: null means that the sensor tells no limit.
    limit = sensor["range_max_m"]
    sensor["range_max_m"] = None if limit == float("inf") else limit
    return {**sensor, "field_of_view_rad": log.sensor.field_of_view_rad}


def _time(log: Log) -> dict[str, Any]:
    return {
        "first_ns": log.first_ns,
        "last_ns": log.last_ns,
        "duration_s": log.duration_s,
        "period_s": log.period_s,
        "rate_hz": 1.0 / log.period_s if log.period_s else None,
        "stamp_source": log.stamp_source,
        "gaps": [asdict(gap) for gap in log.gaps],
    }


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
    return {
        "source": log.mounting_source,
        "base_frame": log.base_frame,
        **asdict(log.base_T_laser),
    }


def _tell(document: dict[str, Any], *, json: bool) -> None:
    """Print the document, or the table and on stderr what must not be missed."""
    if json:
        from json import dumps

        emit(dumps(document, indent=2, allow_nan=False))
        return
    _print_rows(_rows(document))
    for warning in document["warnings"]:
        note(f"mavnav: warning: {warning}")
    for damage in document["damage"][:_LISTED]:
        note(f"mavnav: damage: {damage['what']}, {damage['where']}")
    if len(document["damage"]) > _LISTED:
        note(f"mavnav: damage: {len(document['damage']) - _LISTED} more; --json lists them")


def _rows(document: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the table."""
    source, scans = document["input"], document["scans"]
    rows = [
        ("log", source["path"]),
        ("format", f"{source['format']}, {source['size_bytes'] / 1e6:.1f} MB"),
        *_topic_rows(document["topics"]),
    ]
    skipped = "".join(f", {count} {reason.replace('_', ' ')}" for reason, count in scans["skipped"].items())
    rows.append(("scans", f"{scans['usable']} usable of {scans['total']}{skipped}"))
    if document["topic"] is not None:
        rows += [
            ("scan topic", f"{document['topic']}, frame {document['frame_id']}"),
            *_sensor_rows(document["sensor"]),
            *_time_rows(document["time"]),
            ("ranges", _shares(document["cleaning"])),
            ("odometry", _odometry_text(document["odometry"])),
            ("mounting", _mounting_text(document["mounting"])),
        ]
    return rows


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


def _odometry_text(odometry: dict[str, Any] | None) -> str:
    if odometry is None:
        return "none"
    return f"{odometry['topic']}, {odometry['poses']} poses, {odometry['length_m']:.2f} m"


def _mounting_text(mounting: dict[str, Any] | None) -> str:
    if mounting is None:
        return "unknown"
    place = f"x {mounting['x_m']:.3f} m, y {mounting['y_m']:.3f} m, yaw {mounting['yaw_rad'] / DEG:.2f} deg"
    return f"{place} on {mounting['base_frame']} ({mounting['source']})"


def _print_rows(rows: list[tuple[str, str]]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in rows:
        table.add_row(Text(name, style="bold"), Text(printable(value), overflow="fold"))
    console().print(table)
