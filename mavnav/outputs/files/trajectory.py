"""Trajectory files: TUM for the tools of the field, CSV for everything known about each scan; the truth beside them."""

from __future__ import annotations

import csv
import json
from math import cos, isfinite, nan, sin
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mavnav.outputs.run import RunResult, Walls
    from mavnav.pose import Trajectory

COLUMNS = (
    "index", "stamp", "x_m", "y_m", "yaw_rad", "cost_m2", "beams_used", "inliers", "evaluations", "iterations",
    "converged", "tracked", "accepted", "threshold_m2", "doubtful",
    "cov_xx_m2", "cov_xy_m2", "cov_yy_m2", "cov_xyaw_m_rad", "cov_yyaw_m_rad", "cov_yawyaw_rad2",
    "position_error_m",
)  # fmt: skip

ATTITUDE_COLUMNS: Final = ("roll_rad", "pitch_rad", "height_m")
"""Further columns of logs with an attitude."""

UNKNOWN: Final = (nan,) * 6
TRUE_WALLS_FILE: Final = "true_walls.json"


def write_tum(run: RunResult, path: Path) -> None:
    """Write map_T_laser of every tracked scan as ``t x y z qx qy qz qw`` (seconds, metres, unit quaternion)."""
    path.write_text("".join(tum_lines(run.slam.trajectory)), encoding="ascii")


def write_base_tum(run: RunResult, path: Path) -> None:
    """Write map_T_base in the same format; the run must know the mounting."""
    trajectory = run.map_T_base
    if trajectory is None:
        msg = "the laser's mounting is not known"
        raise ValueError(msg)
    path.write_text("".join(tum_lines(trajectory)), encoding="ascii")


def write_truth_tum(run: RunResult, path: Path) -> None:
    """Write the true map_T_laser of every scan in the same format; the run must be a mission."""
    if run.truth is None:
        msg = "the truth is not known"
        raise ValueError(msg)
    path.write_text("".join(tum_lines(run.truth.map_T_laser)), encoding="ascii")


def write_true_walls(run: RunResult, path: Path) -> None:
    """Write the true walls in the map frame, m and rad, as `Truth` holds them, and of a mission the goal."""
    true = run.true_walls
    if true is None:
        msg = "the truth is not known"
        raise ValueError(msg)
    goal = {} if run.truth is None else {"goal": list(run.truth.goal_xy_map_m)}
    measured = run.truth and run.truth.measured_by_hand
    hand = {"measured_by_hand": _shapes(measured)} if measured else {}
    walls = {"frame": "map", **_shapes(true), **goal, **hand}
    path.write_text(json.dumps(walls) + "\n", encoding="ascii")


def _shapes(walls: Walls) -> dict[str, Any]:
    return {"segments": walls.segments_map.tolist(), "arcs": walls.arcs_map.tolist()}


def tum_lines(trajectory: Trajectory) -> Iterator[str]:
    """Write poses as lines ``t x y z qx qy qz qw`` (seconds, metres, unit quaternion)."""
    for stamp_ns, (x, y, yaw) in zip(trajectory.stamps_ns.tolist(), trajectory.xyyaw.tolist(), strict=True):
        z, w = sin(yaw / 2.0), cos(yaw / 2.0)
        yield f"{seconds(stamp_ns)} {x:z.9f} {y:z.9f} 0 0 0 {z:z.12f} {w:z.12f}\n"


def seconds(stamp_ns: int) -> str:
    """Write a stamp in seconds with all its nanoseconds: a float would lose the last three digits."""
    sign = "-" if stamp_ns < 0 else ""
    whole, rest = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{sign}{whole}.{rest:09d}"


def write_csv(run: RunResult, path: Path) -> None:
    """Write a row for every scan that was matched; one that was not tracked has no pose.

    ``doubtful`` is 1 for scans of a reason to doubt the track, if the doubt is high. The covariance of the pose is in
    the map frame; empty where it is not known. So is the position error without a truth. Logs with an attitude have
    that of every scan as well.
    """
    trajectory, errors_m = run.slam.trajectory, run.position_errors_m
    values = trajectory.xyyaw if errors_m is None else np.column_stack((trajectory.xyyaw, errors_m))
    poses = dict(zip(trajectory.stamps_ns.tolist(), values.tolist(), strict=True))
    columns = [
        run.slam.steps.column(name).tolist() for name in ("index", "stamp_ns", *COLUMNS[5:12], "tracked", COLUMNS[13])
    ]
    columns.append(run.slam.doubtful(run.slam.steps.column("stamp_ns")).astype(int).tolist())
    covariances = run.slam.covariances
    columns.append([()] * len(run.slam.steps) if covariances is None else covariances.tolist())
    tilts, names = _attitudes(run), () if run.log.attitude is None else ATTITUDE_COLUMNS
    with path.open("w", encoding="ascii", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow((*COLUMNS, *names))
        rows.writerows((*_csv_row(row, poses.get(row[1])), *next(tilts)) for row in zip(*columns, strict=True))


def _attitudes(run: RunResult) -> Iterator[tuple[str, ...]]:
    """Yield the fields of a scan's attitude for each scan; none where the log has none."""
    attitude, stamps_ns = run.log.attitude, run.slam.steps.column("stamp_ns")
    if attitude is None:
        yield from ((),) * len(stamps_ns)
        return
    for values in np.column_stack(attitude.at((stamps_ns - attitude.stamps_ns[0]).astype(np.float64))).tolist():
        yield tuple(f"{value:z.6f}" if isfinite(value) else "" for value in values)


def _csv_row(row: tuple[Any, ...], placed: list[float] | None) -> tuple[object, ...]:
    """Return a row of the table; ``placed`` is x, y, yaw, and the position error if there is a truth."""
    index, stamp_ns, cost_m2, beams, inliers, evaluations, iterations, *flags, threshold_m2, doubtful, covariance = row
    pose = ("", "", "") if placed is None else (f"{v:z.9f}" for v in placed[:3])
    error_m = placed[3] if placed and len(placed) > 3 else nan
    cost, threshold = (f"{value:.9g}" if isfinite(value) else "" for value in (cost_m2, threshold_m2))
    effort = (evaluations, iterations)
    return (
        index,
        seconds(stamp_ns),
        *pose,
        cost,
        beams,
        f"{inliers:.6f}",
        *effort,
        *map(int, flags),
        threshold,
        doubtful,
        *(f"{value:z.4g}" if isfinite(value) else "" for value in covariance or UNKNOWN),
        f"{error_m:.6f}" if isfinite(error_m) else "",
    )
