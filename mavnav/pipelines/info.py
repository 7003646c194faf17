"""What is found in a log: the document of ``mavnav info``.

It imports no more than it needs: importing the rest of the package took half of the time of a command.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from msgspec.structs import asdict

from mavnav.config.models import RobustConfig
from mavnav.errors import ExitCode, MavnavError
from mavnav.logs import Log, Survey, choose, survey
from mavnav.logs.derived_scans import RecordedAttitude
from mavnav.logs.health import sensor_health
from mavnav.logs.records import Imu, Odometry
from mavnav.pose import Pose
from mavnav.units import NS

SCHEMA_VERSION: Final = 1
LISTED: Final = 10
"""Most topics that a warning names."""


def info_document(
    log: Path,
    topic: str | None,
    more: tuple[Path, ...] = (),
    *,
    strict: bool = False,
    progress: Callable[[int, int | None], None] | None = None,
) -> tuple[dict[str, Any], MavnavError | None]:
    """Examine a log, or the scan topic of that name; return the document, and why no scan can be used.

    The fields about one topic are empty where there are several, or none; ``scan_topics`` has them for each.
    ``more`` are further parts of the log. With ``strict``, scans from where a checksum does not match are left out.
    Raises UsageError and NoScansError where there is no log to examine.
    """
    contents = survey(log, topic=topic, strict=strict, progress=progress, more=more)
    logs, error = _choices(contents, topic)
    code = error.exit_code if error else ExitCode.DAMAGED_INPUT if contents.damage else ExitCode.DONE
    topics = [_topic(each) for each in logs]
    document = {
        "schema_version": SCHEMA_VERSION,
        "input": {
            "path": str(contents.path),
            "sha256": contents.sha256,
            "format": contents.format,
            "size_bytes": contents.size_bytes,
        },
        "topics": [asdict(topic) for topic in contents.topics],
        "scans": _counts(contents, logs),
        **(topics[0] if len(topics) == 1 else _topic(None)),
        "scan_topics": [{"scans": asdict(each.counts), **topic} for each, topic in zip(logs, topics, strict=True)],
        "damage": [asdict(damage) for damage in contents.damage],
        "warnings": _warnings(contents, logs),
        "exit_code": int(code),
    }
    return document, error


def _choices(contents: Survey, topic: str | None) -> tuple[list[Log], MavnavError | None]:
    """Return a log for every scan topic that is usable; where none is, the reason."""
    logs, errors = [], []
    names: list[str | None] = [topic] if topic else [*sorted(contents.scans)] or [None]
    for name in names:
        try:
            logs.append(choose(contents, topic=name))
        except MavnavError as error:
            errors.append(error)
    return logs, None if logs else errors[0]


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


def _warnings(contents: Survey, logs: list[Log]) -> list[str]:
    texts = dict.fromkeys(text for log in logs for text in log.warnings) or dict.fromkeys(contents.warnings)
    if len(logs) > 1:
        names = ", ".join([log.topic for log in logs[:LISTED]] + ["..."] * (len(logs) > LISTED))
        texts[f"several scan topics ({names}); a replay needs --topic"] = None
    return list(texts)


def _counts(contents: Survey, logs: list[Log]) -> dict[str, Any]:
    """Add up the scans of all scan topics."""
    skipped: Counter[str] = Counter()
    for scans in contents.scans.values():
        skipped += scans.refused + scans.timeline(contents.window_s).skipped
    return {
        "total": sum(scans.total for scans in contents.scans.values()),
        "usable": sum(log.counts.usable for log in logs),
        "skipped": dict(sorted(skipped.items())),
        "suspect": sum(log.counts.suspect for log in logs),
    }


def _sensor(log: Log) -> dict[str, Any]:
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
    health = sensor_health(log, RobustConfig().far_m)
    return {**asdict(health), "findings": [asdict(finding) for finding in health.findings]}


def _imu(imu: Imu) -> dict[str, Any]:
    stamps_ns = imu.rotation.stamps_ns
    span_s = float(stamps_ns[-1] - stamps_ns[0]) * NS
    return {"topic": imu.topic, "messages": len(stamps_ns), "rate_hz": (len(stamps_ns) - 1) / span_s}


def _attitude(attitude: RecordedAttitude) -> dict[str, Any]:
    from mavnav.outputs.documents.sections import attitude_source  # noqa: PLC0415  rarely needed
    from mavnav.outputs.files.document import plain  # noqa: PLC0415

    described: dict[str, Any] = plain(attitude_source(attitude))
    return described


def _odometry(odometry: Odometry) -> dict[str, Any]:
    track = odometry.odom_T_base
    return {"topic": odometry.topic, "source": odometry.source, "poses": len(track), "length_m": track.length_m}


def _mounting(log: Log, base_T_laser: Pose) -> dict[str, Any]:
    return {"source": log.mounting_source, "base_frame": log.base_frame, **base_T_laser._asdict()}
