"""Trajectory files: TUM and g2o for the tools of the field, CSV for all that is known of each scan; truth, sessions."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import cos, isfinite, nan, sin
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavnav.logs.messages import cdr, definitions
from mavnav.logs.writing.mcap_writer import OutputChannel, write_serialized
from mavnav.outputs.run import RunResult, Walls, half_sweep_s, require
from mavnav.pose import Trajectory, correct_path
from mavnav.scan import Scan
from mavnav.slam.findings import Edge
from mavnav.slam.matching.steps import refused_by
from mavnav.units import NS

COLUMNS = (
    "index", "stamp", "x_m", "y_m", "yaw_rad", "cost_m2", "beams_used", "inliers", "evaluations", "iterations",
    "converged", "tracked", "accepted", "threshold_m2", "refused_by", "doubtful",
    "cov_xx_m2", "cov_xy_m2", "cov_yy_m2", "cov_xyaw_m_rad", "cov_yyaw_m_rad", "cov_yawyaw_rad2",
    "position_error_m",
)  # fmt: skip

ATTITUDE_COLUMNS: Final = ("roll_rad", "pitch_rad", "height_m")
"""Further columns of logs with an attitude."""

UNKNOWN: Final = (nan,) * 6
TRUE_WALLS_FILE: Final = "true_walls.json"


def write_poses(map_T_laser: Trajectory, path: Path) -> None:
    """Write poses as lines ``t x y z qx qy qz qw`` (seconds, metres, unit quaternion)."""
    path.write_text("".join(tum_lines(map_T_laser)), encoding="ascii")


def write_tum(run: RunResult, path: Path) -> None:
    """Write map_T_laser of every tracked scan, and of lost ones that have a pose by odometry."""
    write_poses(run.slam.path, path)


def write_base_tum(run: RunResult, path: Path) -> None:
    """Write map_T_base; raises ValueError where the run does not know the mounting."""
    write_poses(run.slam.path.compose(require(run.log.base_T_laser, "the laser's mounting").inverse()), path)


def write_truth_tum(run: RunResult, path: Path) -> None:
    """Write the true map_T_laser of every scan with the time of it; raises ValueError where the run is no mission."""
    truth = require(run.truth, "the truth")
    write_poses(correct_path(truth.map_T_laser, round(half_sweep_s(run.log, run.slam) / NS)), path)


def write_true_walls(run: RunResult, path: Path) -> None:
    """Write the true walls in the map frame, m and rad, as `Truth` holds them, and of a mission the goal.

    Raises ValueError where they are not known.
    """
    if (true := run.true_walls) is None:
        raise ValueError("the truth is not known")
    walls: dict[str, Any] = {"frame": "map", **_shapes(true)}
    if run.truth:
        walls["goal"] = list(run.truth.goal_xy_map_m)
        if run.truth.measured_by_hand:
            walls["measured_by_hand"] = _shapes(run.truth.measured_by_hand)
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
    """Write a row for every scan that was matched; one that was not tracked has no pose, or one by odometry.

    ``refused_by`` is the rule of the paper's method that refused a scan, empty where none did. ``doubtful`` is 1 for
    scans of a reason to doubt the track, if the doubt is high. The covariance of the pose is in
    the map frame; empty where it is not known. So is the position error without a truth. Logs with an attitude have
    that of every scan as well.
    """
    trajectory, steps, attitude = run.slam.trajectory, run.slam.steps, run.log.attitude
    stamps_ns, covariances = steps.column("stamp_ns"), run.slam.covariances
    errors_m = np.full(len(trajectory), nan) if run.position_errors_m is None else run.position_errors_m
    poses = np.column_stack((trajectory.xyyaw, errors_m)).tolist()
    pose_of = dict(zip(trajectory.stamps_ns.tolist(), poses, strict=True))
    bridged = run.slam.bridges.trajectory
    pose_of |= dict(zip(bridged.stamps_ns.tolist(), [[*pose, nan] for pose in bridged.xyyaw.tolist()], strict=True))
    tilts: list[Any] = [()] * len(steps)
    if attitude is not None:
        tilts = np.column_stack(attitude.at((stamps_ns - attitude.stamps_ns[0]).astype(np.float64))).tolist()
    columns = [
        *(steps.column(name).tolist() for name in ("index", "stamp_ns", *COLUMNS[5:12], "tracked", COLUMNS[13])),
        refused_by(steps).tolist() if run.config.method == "paper" else [""] * len(steps),
        run.slam.doubtful(stamps_ns).astype(int).tolist(),
        [UNKNOWN] * len(steps) if covariances is None else covariances.tolist(),
        tilts,
    ]
    with path.open("w", encoding="ascii", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS if attitude is None else (*COLUMNS, *ATTITUDE_COLUMNS))
        rows.writerows(_csv_row(pose_of.get(row[1], UNKNOWN[:4]), *row) for row in zip(*columns, strict=True))


def _csv_row(pose_and_error: Sequence[float], index: int, stamp_ns: int, *values: Any) -> tuple[object, ...]:  # noqa: ANN401
    """Return a row of the table, of x, y, yaw and position error, and what is known of the scan."""
    cost_m2, beams, inliers, evaluations, iterations, *flags = values[:-5]
    threshold_m2, rule, doubtful, covariance, attitude = values[-5:]
    *pose, error_m = pose_and_error
    return (
        *(index, seconds(stamp_ns), *(_field(value, "z.9f") for value in pose)),
        *(_field(cost_m2, ".9g"), beams, f"{inliers:.6f}", evaluations, iterations),
        *(*map(int, flags), _field(threshold_m2, ".9g"), rule, doubtful),
        *(_field(value, "z.4g") for value in covariance),
        *(_field(error_m, ".6f"), *(_field(value, "z.6f") for value in attitude)),
    )


def _field(value: float, form: str) -> str:
    """Write a number; empty where it is not known."""
    return format(value, form) if isfinite(value) else ""


def write_graph(run: RunResult, path: Path) -> None:
    """Write key frames, the motion between them and the closed loops for g2o, GTSAM and Ceres; m, rad.

    A vertex is numbered as its scan in trajectory.csv, at its final pose. Raises ValueError if no loops were searched.
    """
    graph = require(run.slam.loops.graph, "the pose graph")
    numbers, rows = run.slam.steps.column("index")[run.slam.steps.column("tracked")], list(graph.rows)
    names, poses = numbers[rows].tolist(), run.slam.trajectory.xyyaw[rows].tolist()
    lines = [f"VERTEX_SE2 {k} {x:z.9f} {y:z.9f} {yaw:z.9f}\n" for k, (x, y, yaw) in zip(names, poses, strict=True)]
    lines.append(f"FIX {names[0]}\n")
    lines += [f"EDGE_SE2 {names[edge.start]} {names[edge.end]} {_edge_values(edge)}\n" for edge in graph.edges]
    path.write_text("".join(lines), encoding="ascii")


def _edge_values(edge: Edge) -> str:
    """Return the pose of the end seen from the start, and the upper triangle of the information matrix."""
    x, y, yaw = edge.start_T_end
    information = edge.sqrt_information.T @ edge.sqrt_information
    upper = information[np.triu_indices(3)].tolist()
    return " ".join([f"{x:z.9f} {y:z.9f} {yaw:z.9f}", *(f"{value + 0.0:.9g}" for value in upper)])


def session_files(name: str) -> tuple[str, str]:
    """Return the names of the files of the poses and of the scans of a session."""
    return f"session_{name}.tum", f"session_{name}.mcap"


def write_scans(scans: Callable[[], Iterable[Scan]], path: Path) -> None:
    """Write scans as a log with nothing else in it."""
    message = cdr.scans("laser")
    with write_serialized(path, {"/scan": OutputChannel(definitions.SCAN)}) as put:
        for scan in scans():
            put("/scan", scan.stamp_ns, message(scan))
