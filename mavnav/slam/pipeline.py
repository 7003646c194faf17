"""The passes over a whole log, as they run; numbers and titles are those of the steps in docs/method.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.pose import Pose, Rotation, Trajectory
from mavnav.slam.doubt.judge import judge_flown, judge_redrawn, judge_track
from mavnav.slam.doubt.without_wheels import without_erring_wheels
from mavnav.slam.loop_closure.detection import close_loops
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, LogOdometry, in_meters
from mavnav.slam.matching.prior_map import PriorMap
from mavnav.slam.methods.registry import make_method
from mavnav.slam.recovery.own_map import or_with_own_map, place_in_given_map
from mavnav.slam.recovery.parts import drop_late_poses, join_lost_parts
from mavnav.slam.recovery.rematch import rematch_rejected
from mavnav.slam.refinement.contradicted import drop_contradicted
from mavnav.slam.refinement.place import place_map
from mavnav.slam.refinement.refine import draw_map, match_deskewed, refine_poses, remove_dynamic_cells, smooth_jitter
from mavnav.slam.result import SlamResult, summarize
from mavnav.slam.retries.attempt import COARSER_VOXELS, Attempt, try_again
from mavnav.slam.retries.beam_order import REVERSED_BEAMS
from mavnav.slam.retries.beginning import track_from_good_beginning
from mavnav.slam.retries.floor_line import drives_along, without_floor
from mavnav.slam.retries.levelling import as_recorded
from mavnav.slam.retries.odometry import FITTING_ODOMETRY
from mavnav.slam.retries.sweep_time import TIMED_SWEEPS
from mavnav.slam.retries.wheel_scale import with_scaled_wheels
from mavnav.slam.track import LogScans, OnStep, Pass, Placement, Track

SHORTEST_PERIOD_S = 1e-3
"""Minimum scan period, s, also that of a log of one scan, whose period is unknown."""

ATTEMPTS: Final = (TIMED_SWEEPS, REVERSED_BEAMS, COARSER_VOXELS)
"""Attempts to track the log again, where an input check fails ("Input checks") or scans are sparse (step 10)."""

RECOVERING: Final[tuple[Pass, ...]] = (drop_late_poses, rematch_rejected, join_lost_parts)
"""Passes that match the lost scans of a track once more: "Parts", and `rematch_rejected`, step 9."""

CHECKING: Final[tuple[Pass, ...]] = (
    place_in_given_map,  # "Localization in a given map"
    close_loops,  # step 11
    drop_contradicted,  # "Localization in a given map"
    place_map,  # --align
    remove_dynamic_cells,  # step 12
    refine_poses,  # step 13
    judge_track,  # "Doubt"
)
"""Passes that correct and judge the finished track, and make the final map."""

SMOOTHING: Final[tuple[Pass, ...]] = (smooth_jitter,)
"""What makes the final poses, where no map is asked for: step 14."""

FINISHING: Final[tuple[Pass, ...]] = (*SMOOTHING, draw_map)
"""What makes the final poses and the map of the scans there: steps 14 and 15."""

MEASURING: Final[tuple[Pass, ...]] = (match_deskewed,)
"""What makes the poses of a calibration instead: nothing is smoothed or drawn."""


def run_slam(
    log_scans: LogScans,
    config: Config,
    period_s: float,
    odom_T_laser: Trajectory | None = None,
    on_step: OnStep | None = None,
    prior_map: PriorMap | None = None,
    rotation: Rotation | None = None,
    last: tuple[Pass, ...] = FINISHING,
    base_T_laser: Pose | None = None,
    scans_ns: NDArray[np.int64] | None = None,
    recorded: LogScans | None = None,
    placement: Placement | None = None,
    start_s: float = 0.0,
    recorded_ns: NDArray[np.int64] | None = None,
    predicting: bool = True,
) -> SlamResult:
    """Run the configured method over a recorded log.

    Parameters
    ----------
    log_scans : returns the scans; every call starts at the first scan
    config : the method, its search grids and its parameters
    period_s : the sensor's time between scans, 0 if unknown
    odom_T_laser : odometry of the laser, used as the prediction; where not ``predicting``, only to show the floor
    on_step : called with the name of the pass ("track", "close loops", "final pass", ...) and the number of scans done
    prior_map : localize in this map, which is not changed, instead of building one
    rotation : measurements of an inertial sensor: its yaw rate predicts turns where odometry does not, its tilt is
        evidence of motion that is not planar
    last : the passes that end the run
    base_T_laser : the mounting of the laser, for which odometry is scaled where it should be
    scans_ns : the stamps (n,) of all scans, which are averaged where odometry then fits better
    recorded : returns the scans as recorded, where those of ``log_scans`` are levelled by a tilt that may be wrong
    placement : where in the map frame the finished map is put; by default the scan that begins it is at the origin
    start_s : time from the first scan of the log to the first of ``log_scans``, from which advice counts
    recorded_ns : the stamps (n,) of all odometry in the log, that which is left out or not used, too
    """
    method = make_method(config, prior_map)
    given: LogOdometry | None = None
    if odom_T_laser is not None and len(odom_T_laser):
        mounting = base_T_laser or Pose()
        given = LogOdometry(odom_T_laser.compose(mounting.inverse()), mounting, scans_ns)
    fastest = config.robust.max_speed_m_s, config.robust.max_turn_rad_s
    fit = in_meters(given, config.robust.max_speed_m_s) if given else GOOD_ODOMETRY
    odometry = given.lookup(fit) if given else None
    motion = Motion(max(period_s, SHORTEST_PERIOD_S), odometry, method.expects_rest, rotation=rotation, fastest=fastest)
    start = Track(log_scans, config, motion, method, prior_map=prior_map, on_step=on_step, log_odometry=given)
    start = replace(start.with_findings(odometry=fit), placement=placement, start_s=start_s)
    start = start if recorded_ns is None else replace(start, recorded_ns=recorded_ns)
    unlevelled = (as_recorded(recorded),) if recorded else ()
    start, track = track_without_floor(start, (*FITTING_ODOMETRY, *unlevelled), predicting)  # steps 1 to 8 first
    track = try_again(or_with_own_map(track, start), ATTEMPTS)
    return summarize(after(track, (*RECOVERING, *CHECKING, *last)))


def track_without_floor(start: Track, attempts: Sequence[Attempt], predicting: bool) -> tuple[Track, Track]:
    """Track a log without the floor that its laser sees; also return what the track begins with, first."""
    cut = without_floor(start)
    begin, whole = (each if predicting else each.without_odometry() for each in (cut, start))
    track = track_with_odometry(begin, attempts)
    if cut is start or drives_along(track, start):
        return begin, track
    return whole, track_with_odometry(whole, attempts)


def track_with_odometry(start: Track, attempts: Sequence[Attempt]) -> Track:
    """Track a log with its odometry, corrected or in part as it fits, or without."""
    return without_erring_wheels(with_scaled_wheels(try_again(track_from_good_beginning(start), attempts)))


def finish(track: Track) -> SlamResult:
    """Run the last passes over the track of a mission and summarize it."""
    return summarize(after(track, (*CHECKING[:-1], judge_flown, *FINISHING)))


def after(track: Track, passes: tuple[Pass, ...]) -> Track:
    """Run passes over a track in order, none in causal mode and with a method that has no refiner, and judge it."""
    for each in passes:
        track = each(track, track.refiner) if track.refiner else track
    return track if track.findings.doubt else judge_redrawn(track)
