"""``mavnav info LOG``: what a log holds, and everything odd about it.

Examples
--------
mavnav info drive.mcap
mavnav info rosbag2_folder --topic /front/scan
mavnav info drive.bag --json | jq .scans
ssh robot cat drive.mcap | mavnav info -
"""

from __future__ import annotations

from functools import partial
from itertools import zip_longest
from typing import Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import reporting
from mavnav.commands.sources import local_log
from mavnav.commands.terminal import Rows, note_problems, print_result
from mavnav.config.options import read_options
from mavnav.errors import ExitCode
from mavnav.units import DEG, NS, pluralize


@shared.with_options("topic", "strict")
def info(logs: shared.LogParts, *, json: shared.Json = False, quiet: shared.Quiet = False, **given: object) -> None:
    """Examine a log: topics, sensor, scans, rate, validity of ranges, odometry, and everything that is damaged."""
    options = read_options(given)
    with local_log(logs) as log:
        from mavnav.pipelines.info import info_document

        with reporting(quiet=quiet) as report:
            strict, progress = options.get("strict", False), partial(report, "reading")
            document, error = info_document(log.path, options.get("topic"), log.more, strict=strict, progress=progress)
        document["input"] |= {"path": log.name} | ({"parts": [*map(str, log.more)]} if log.more else {})
        if error and not json:  # the error line names its cause
            document["damage"] = [each for each in document["damage"] if each["what"] not in str(error)]
        print_result(document, _rows(document), json=json)
        if not json:
            note_problems(document)
        raise error or typer.Exit(document["exit_code"])


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
        yield "scan topic", f"{topic['topic']}, frame {topic['frame_id'] or '(none)'}, {topic['scans']['usable']} scans"
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
        once = "no time_increment: right if all beams are taken at once"
        if not usual_s:
            return once
        beam_s = usual_s / max(round(360 * DEG / abs(sensor["angle_step_rad"])), 1)
        text = f"a laser that turns once in {usual_s:.3g} s needs {beam_s:.3g} s a beam, which a replay tries"
        return f"{once}; {text}"
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
