"""Lines to copy: what a calibration found as a static transform, and as options of a replay."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, Any, Final

from mavnav.units import DEG

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.config.options import ReplayOptions
    from mavnav.logs import Log

MOUNTING: Final = ("x_m", "y_m", "yaw_deg")

SETTINGS: Final = {name: f"odometry.{name}" for name in ("offset_s", "distance_scale", "turn_scale", "veer_deg_per_m")}
"""Quantity -> key of the configuration that corrects the odometry by it."""

OVERHEAD: Final = ("--set", "upside_down=true")


def option_of(name: str, value: float | None) -> str | None:
    """Return the option of a replay that takes a quantity; the mounting has one for three."""
    return None if value is None or name not in SETTINGS else f"--set {SETTINGS[name]}={value:.4f}"


def transform_line(rows: list[dict[str, Any]], log: Log, *, upside_down: bool | None) -> str | None:
    """Return the command that publishes the mounting; None where a part of it is not known."""
    mounting = _mounting(rows)
    if mounting is None:
        return None
    x_m, y_m, yaw_rad = mounting
    roll = "3.14159" if _overhead(log, upside_down) else "0"
    frames = f"--frame-id {quote(log.base_frame or 'base_link')} --child-frame-id {quote(log.frame_id)}"
    turned = f"--roll {roll} --pitch 0 --yaw {yaw_rad:z.4f}"
    return f"ros2 run tf2_ros static_transform_publisher --x {x_m:z.4f} --y {y_m:z.4f} --z 0 {turned} {frames}"


def reading_options(options: ReplayOptions[Path], odom: str) -> list[str]:
    """Return the options of a replay that read from a log what was calibrated."""
    given = {"--topic": options.get("topic"), "--odom": None if odom == "auto" else odom}
    words = [f"{option} {quote(value)}" for option, value in given.items() if value]
    return [*words, "--strict"] if options.get("strict") else words


def replay_line(
    path: Path, reading: list[str], rows: list[dict[str, Any]], log: Log, *, upside_down: bool | None
) -> str | None:
    """Return the command that replays the log with all that differs from what it says; None where nothing does."""
    differing = {row["name"] for row in rows if row["value"] is not None and not row["agrees"]}
    mounting, overhead = _mounting(rows), _overhead(log, upside_down)
    words: list[str] = []
    if mounting and (differing & {*MOUNTING} or overhead != log.upside_down):
        words += [f"--extrinsic={','.join(f'{value:.4f}' for value in mounting)}", *(OVERHEAD if overhead else ())]
    words += [row["option"] for row in rows if row["option"] and row["name"] in differing]
    return " ".join(("mavnav replay", quote(str(path)), *reading, *words)) if words else None


def _mounting(rows: list[dict[str, Any]]) -> tuple[float, float, float] | None:
    """Return x, y and yaw of the laser, m, m, rad; None where one is not known."""
    x_m, y_m, yaw_deg = (next(row["value"] for row in rows if row["name"] == name) for name in MOUNTING)
    return None if None in (x_m, y_m, yaw_deg) else (x_m, y_m, yaw_deg * DEG)


def _overhead(log: Log, upside_down: bool | None) -> bool:
    return log.upside_down if upside_down is None else upside_down
