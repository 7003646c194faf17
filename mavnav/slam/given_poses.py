"""The scans of a log at the poses of another program: drawn and judged, never moved."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.pose import MAX_GAP_NS, Pose, Trajectory
from mavnav.slam.doubt.judge import UNASKED, UNDECIDED, judge, match_again, redraw
from mavnav.slam.findings import SECOND_LOST
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.odometry_fit import FittedOdometry
from mavnav.slam.matching.scan_matching import first_match, no_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.robust import Robust
from mavnav.slam.result import SlamResult, summarize
from mavnav.slam.retries.beam_order import reverse_beams
from mavnav.slam.retries.sweep_time import time_sweeps
from mavnav.slam.track import LogScans, OnStep, Track
from mavnav.units import DEG

ROUNDED_NS: Final = 1_000_000
"""Largest time of a scan before the first pose or after the last that rounding in a text file explains."""

MOST_SCANS: Final = 0.5
"""Share of the scans with a pose of their own from which on the others have none: they were lost, or left out."""

NEAR_M, NEAR_RAD = 0.1, 1 * DEG
"""Poses that begin this near to their origin, as those of most programs do, keep their frame, and so the same cells."""


def draw_at_poses(
    log_scans: LogScans,
    config: Config,
    period_s: float,
    world_T_laser: Trajectory,
    scans_ns: NDArray[np.int64],
    holds_ns: int = 0,
    *,
    whole: bool = False,
    of_run: bool = False,
    wheels: FittedOdometry | None = None,
    on_step: OnStep | None = None,
) -> tuple[SlamResult, Pose, float]:
    """Draw the map of scans at the poses of a trajectory, and judge it.

    Returns that, the pose of the map frame in the world, and how far from its pose, m, the median scan fits the map.
    The map frame is that of the poses of a run, or of poses that begin near their origin; else the laser at the first.
    An inertial sensor is no evidence. The scans show the order and the time of the beams.

    Parameters
    ----------
    log_scans : returns the scans; every call starts at the first scan
    config : how the map is drawn: the cells, ranges and de-skewing of the robust method
    period_s : time between scans
    world_T_laser : the poses, interpolated between the stamps unless most scans have one of their own
    scans_ns : stamps (n,) of all scans
    holds_ns : time from the stamp of a scan to that of its pose
    whole : the poses are those at which the scans as recorded fit best, not those of the laser at mid-sweep
    of_run : they are those of a run: its map has their frame
    wheels : odometry of the log that mavnav's own track confirms: evidence where walls leave the motion open
    on_step : called with the name of the pass and the number of scans done
    """
    xyyaw = world_T_laser.poses_at(_within_rounding(scans_ns + holds_ns, world_T_laser), MAX_GAP_NS)
    has_pose = np.isin(scans_ns, world_T_laser.stamps_ns)
    if of_run or has_pose.mean() >= MOST_SCANS:
        xyyaw[~has_pose] = np.nan
    known = np.flatnonzero(np.isfinite(xyyaw[:, 0]))
    first = Pose(*xyyaw[known[0]].tolist()) if len(known) else Pose()
    world_T_map = Pose() if of_run or _is_near_origin(first) else first
    steps = Steps(_steps(scans_ns, xyyaw, world_T_map.inverse()))
    causal = replace(config, final_pass=False)  # what warns of a log that mavnav tracked does not apply
    track = Track(log_scans, causal, Motion(period_s), Robust(config), steps=steps, on_step=on_step)
    track = replace(track, recorded_ns=wheels[0].odom_T_base.stamps_ns) if wheels else track
    refiner = redraw(track, recorded=whole)
    for change in (time_sweeps, reverse_beams):
        if changed := change(replace(track, config=config, method=refiner)):
            track = replace(track, log_scans=changed.log_scans, findings=changed.findings)
            refiner = redraw(track, recorded=whole)
    drawn = match_again(track, refiner)
    drawn = drawn.with_odometry(*wheels) if wheels else drawn
    judged = judge(drawn, refiner, UNDECIDED)
    if (doubt := judged.findings.doubt) and SECOND_LOST in {reason.name for reason in doubt.reasons}:
        judged = judge(drawn, refiner, UNASKED)  # a laser that is lost says nothing of where others put it
    unmoved = (
        step._replace(match=best.match._replace(map_T_laser=step.match.map_T_laser, evaluations=0, iterations=0))
        for step, best in zip(steps, drawn.steps, strict=True)
    )
    misfit_m = _misfit_m(steps, drawn.steps)
    return summarize(replace(judged, log_odometry=None, steps=Steps(unmoved))), world_T_map, misfit_m


def _is_near_origin(pose: Pose) -> bool:
    return pose.distance_m <= NEAR_M and abs(pose.yaw_rad) <= NEAR_RAD


def _misfit_m(steps: Steps, fitted: Steps) -> float:
    moved = (fitted.column("map_T_laser") - steps.column("map_T_laser"))[steps.column("tracked"), :2]
    return float(np.median(np.linalg.norm(moved, axis=1))) if len(moved) else np.nan


def _steps(scans_ns: NDArray[np.int64], xyyaw: NDArray[np.float64], map_T_world: Pose) -> Iterator[Step]:
    for k, (stamp_ns, pose) in enumerate(zip(scans_ns.tolist(), xyyaw.tolist(), strict=True)):
        tracked = bool(np.isfinite(pose[0]))
        match = first_match(0)._replace(map_T_laser=map_T_world @ Pose(*pose)) if tracked else no_match(Pose())
        yield Step(k, stamp_ns, match, tracked)


def _within_rounding(stamps_ns: NDArray[np.int64], path: Trajectory) -> NDArray[np.int64]:
    """Return stamps (n,) of which those just outside of a path, by rounding, are moved to its ends."""
    inside = np.clip(stamps_ns, *path.stamps_ns[[0, -1]]) if len(path) else stamps_ns
    return np.where(np.abs(stamps_ns - inside) <= ROUNDED_NS, inside, stamps_ns)
