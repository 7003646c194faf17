"""The pipeline of ``mavnav simulate``: scenario -> flight -> recording -> metrics -> outputs."""

from __future__ import annotations

import os
from hashlib import sha256
from math import inf
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from msgspec import Struct, field
from msgspec.structs import asdict, replace

from mavnav.atomic_files import short_name, temporary_folder
from mavnav.errors import NoScansError, UsageError
from mavnav.ground_truth.references import References, compare_to, of_scenario
from mavnav.logs import Log, open_log
from mavnav.logs.writing.recorder import Recording, check_recording, record
from mavnav.mapping.occupancy_grid import GridBuilder, occupied_xy_m
from mavnav.metrics.reference import LEAST_POSES, absolute_error, position_errors
from mavnav.outputs.directory import check_apart, check_directory, check_file, check_parent
from mavnav.outputs.documents.provenance import Typed, provenance
from mavnav.outputs.documents.run_json import MissionResult, TruthErrors
from mavnav.outputs.pictures.animation import animate
from mavnav.outputs.run import MissionRecord, RunResult, Timing, Truth, WallShapes
from mavnav.outputs.writers import WRITERS, check_groups, write_run
from mavnav.pipelines.maps import measured_map, slices_of
from mavnav.pose import Pose, correct_path, rigid_fit
from mavnav.profiling import Progress, new_profile, scans_s
from mavnav.simulation.mission import Flight, fly
from mavnav.simulation.vehicle import mid_sweep_s
from mavnav.simulation.world.laser import EDGE_M
from mavnav.simulation.world.scenario import Scenario
from mavnav.slam.methods.registry import load_kernels
from mavnav.units import DEG, NS

EDGE_BEAMS, STEEP_RAD = 10, 60 * DEG
"""Walls are not measured so near to an edge, nor by beams farther from their normal: there the laser sees none."""

WALL_GAP_CELLS = 8
"""Empty cells that a noisy wall may hold along a beam: its densest cell then is the wall, not a stray in front."""


class SimulationRequest(Struct, frozen=True):
    """One mission: the scenario and its file, the run directory, and the paths of further outputs.

    ``outputs`` are the groups of files to write, None for all; ``typed`` is the command line; ``content`` SHA-256 and
    size in bytes of the file, if it is not to be read.
    """

    scenario: Scenario
    path: Path
    directory: Path
    recording: Path | None = None
    animation: Path | None = None
    force: bool = False
    report: bool = False
    outputs: tuple[str, ...] | None = None
    typed: Typed = field(default_factory=Typed)
    content: tuple[str, int] | None = None


def simulation_directory(scenario: Scenario) -> Path:
    """Return ``runs/<scenario>-<method>-<yaw samples>-<grid>``."""
    slam = scenario.slam
    return Path("runs") / f"{short_name(scenario.name)}-{slam.method}-{slam.azimuth}-{slam.grid}"


def simulate_mission(
    request: SimulationRequest, progress: Progress, compile_s: float
) -> tuple[RunResult, dict[str, Any]]:
    """Fly a mission and return the run with its document (run.json).

    Raises what the steps raise: UsageError, OutputError; whether the outputs can be written is checked before the work.
    NoScansError where no scan could even begin a map.
    """
    check_outputs(request)
    origin = provenance(request.typed, ["mavnav", "simulate", "--again", str(request.directory.absolute())])
    started_s = perf_counter()
    load_kernels(request.scenario.slam, progress)
    compile_s += perf_counter() - started_s
    wall_s, cpu_s, stages = perf_counter(), process_time(), new_profile()
    flight = fly(request.scenario, lambda phase, done: progress(phase, done, None))
    timing = Timing(perf_counter() - wall_s, process_time() - cpu_s, compile_s, stages, scans_s())
    if not len(flight.slam.trajectory):
        text = f"in {flight.mission.steps} scans the laser saw too little to begin a map"
        raise NoScansError(f"{request.path}: {text}; change its section, or move the start")
    recording = recording_of(flight)
    progress("writing", 0, None)
    with temporary_folder() as folder:
        kept = folder / f"{short_name(request.scenario.name)}.mcap"
        record(recording, kept)
        log = _open_recording(kept, request.scenario)
        known = References(truth=flight.map_T_laser, true_map=of_scenario(flight.scenario, flight.world_T_map))
        run = RunResult(
            log=log,
            config=request.scenario.slam,
            slam=flight.slam,
            metrics=measured_map(flight.slam, log),
            slices=slices_of(flight.slam, log, request.scenario.slam),
            timing=timing,
            truth=(truth := _truth(flight)),
            position_errors_m=position_errors(flight.slam.trajectory, truth.map_T_laser, aligned=False),
            mission=_mission(request, flight),
            reference=compare_to(known, flight.slam.trajectory, occupied_xy_m(flight.slam.grid)),
            provenance=origin,
        )
        document = write_run(run, request.directory, force=request.force, report=request.report, groups=request.outputs)
        if request.recording:
            record(recording, request.recording, force=request.force)
        if request.animation:
            animate(run, request.animation, force=request.force)
    return run, document


def _open_recording(path: Path, scenario: Scenario) -> Log:
    """Open the recording of a mission, with the odometry that was used; scans are levelled as they were in flight."""
    log = open_log(path, odom="auto" if scenario.uses_odometry else "off", attitude=scenario.slam.attitude)
    if log.attitude is None:
        return log
    return replace(log, attitude=replace(log.attitude, ceiling_m=scenario.ceiling_m or inf), _kept=[])


def check_outputs(request: SimulationRequest) -> None:
    """Raise OutputError or UsageError for what could not be written at the end."""
    places = [Path(os.path.realpath(p)) for p in (request.directory, request.recording, request.animation) if p]
    if twice := [str(p) for p in places if places.count(p) > 1]:
        raise UsageError(f"{twice[0]} is to be two things; give run directory, recording and animation a name each")
    run, *others = places
    for place in others:
        if run.is_relative_to(place) or place in {run / name for name in WRITERS}:
            raise UsageError(f"{place} is a part of the run, or contains it; name recording and animation otherwise")
    check_groups(request.outputs or ())
    config = Path(request.typed.config) if request.typed.config else None
    check_directory(request.directory, force=request.force, inputs=(request.path, config))
    check_apart({"--record": request.recording, "--animate": request.animation}, (request.path, config))
    if request.recording:
        check_recording(request.recording, force=request.force)
        check_parent(request.recording)
    check_file(request.animation, ".gif", force=request.force)


def recording_of(flight: Flight) -> Recording:
    """Return the flight as a recorder on the vehicle would have kept it, the truth beside it."""
    base_T_laser = flight.scenario.base_T_laser
    laser_T_base = base_T_laser.inverse()
    spec = flight.scenario.laser.spec
    mid_ns = round(mid_sweep_s(spec) / NS) if flight.scenario.laser.moving else 0
    world_T_base = correct_path(flight.map_T_laser.seen_from(flight.world_T_map).compose(laser_T_base), mid_ns)
    attitudes = [(scan.stamp_ns + mid_ns, a) for scan, a in zip(flight.scans, flight.attitudes, strict=False)]
    return Recording(flight.scans, flight.odom_T_base, world_T_base, base_T_laser, attitudes)


def _truth(flight: Flight) -> Truth:
    """Bring walls and goal to the map frame."""
    walls = flight.scenario.obstacles.seen_from(flight.world_T_map)
    measured = flight.scenario.measured_walls
    sketch = measured.seen_from(flight.world_T_map) if measured else None
    goal = flight.world_T_map.inverse() @ Pose(*flight.scenario.goals_xy_m[-1])
    return Truth(
        map_T_laser=flight.map_T_laser,
        segments_map=walls.segments,
        arcs_map=walls.arcs,
        goal_xy_map_m=(goal.x_m, goal.y_m),
        measured_by_hand=WallShapes(sketch.segments, sketch.arcs) if sketch else None,
        slice_m=flight.scenario.flight.slice_m if flight.scenario.flight else None,
    )


def _mission(request: SimulationRequest, flight: Flight) -> MissionRecord:
    mission, content = flight.mission, b"" if request.content else request.path.read_bytes()
    numbers = {name: value for name, value in asdict(mission).items() if name != "end"}
    result = MissionResult(mission.reached, mission.end.value, **numbers, **_attitude_numbers(flight))
    digest, size_bytes = request.content or (sha256(content).hexdigest(), len(content))
    return MissionRecord(request.path, digest, size_bytes, flight.scenario.document(), result, truth_errors(flight))


def _attitude_numbers(flight: Flight) -> dict[str, Any]:
    """Return what run.json says of the tilt and the height of an aerial vehicle; nothing of another."""
    aerial = flight.scenario.flight
    if aerial is None:
        return {}
    roll_rad, pitch_rad, height_m = np.array(flight.tilts).T
    tilt_rad = np.arccos(np.cos(roll_rad) * np.cos(pitch_rad))
    return {
        "flight_height_m": aerial.height_m,
        "tilt_p95_deg": float(np.percentile(tilt_rad, 95)) / DEG,
        "height_error_p95_m": float(np.percentile(np.abs(height_m - aerial.height_m), 95)),
        "attitude_used": flight.scenario.levels_scans,
    }


def truth_errors(flight: Flight) -> TruthErrors:
    """Compare the tracked poses with the truth."""
    estimate = flight.slam.trajectory
    truth = flight.map_T_laser.xyyaw[np.searchsorted(flight.map_T_laser.stamps_ns, estimate.stamps_ns)]
    if len(estimate) < LEAST_POSES:
        return TruthErrors(len(estimate))
    aligned = absolute_error(estimate.xyyaw[:, :2], truth[:, :2])
    plain = absolute_error(estimate.xyyaw[:, :2], truth[:, :2], aligned=False)
    motion = rigid_fit(estimate.xyyaw[:, :2], truth[:, :2])
    last, true = estimate[len(estimate) - 1], Pose(*map(float, truth[-1]))
    error = true.between(last)
    wall, true_wall = wall_distances_m(flight, last, true)
    errors = {f"ate_{name}": value for name, value in asdict(aligned).items()}
    errors |= {f"unaligned_{name}": value for name, value in asdict(plain).items() if name != "poses"}
    return TruthErrors(
        final_error_m=error.distance_m,
        final_yaw_error_rad=error.yaw_rad,
        final_aligned_error_m=true.between(motion @ last).distance_m,
        map_yaw_error_rad=-motion.yaw_rad,
        wall_distance_m=wall,
        true_wall_distance_m=true_wall,
        wall_distance_error_share=abs(wall - true_wall) / true_wall,
        **errors,
    )


def wall_distances_m(flight: Flight, estimate: Pose, truth: Pose) -> tuple[float, float]:
    """Distance to the walls as the map has it from the estimated pose, and the true one, m.

    The map is read like the laser reads the world, by the virtual scan. Of all beams that meet a wall away from edges
    the one with the median relative error is reported; NaN where the map has no wall at all.
    """
    world, spec = flight.scenario.obstacles, flight.scenario.laser.spec
    there = flight.world_T_map @ truth
    true_ranges, incidence_rad = world.cast((there.x_m, there.y_m), spec.angles_rad + there.yaw_rad)
    builder = GridBuilder.of(flight.slam.grid)
    seen = builder.virtual_scan(estimate, spec.directions, spec.range_max_m, WALL_GAP_CELLS, middle=True)
    with np.errstate(invalid="ignore"):  # inf - inf: two beams that meet nothing
        edges = np.abs(np.diff(true_ranges, prepend=true_ranges[0])) > EDGE_M
    near_edge = np.convolve(edges, np.ones(2 * EDGE_BEAMS + 1), mode="same") > 0
    steep = incidence_rad < STEEP_RAD
    used = np.flatnonzero(np.isfinite(seen) & np.isfinite(true_ranges) & steep & ~near_edge)
    if not len(used):
        return np.nan, float(true_ranges.min())
    errors = np.abs(seen[used] - true_ranges[used]) / true_ranges[used]
    median = used[np.argsort(errors, kind="stable")[len(used) // 2]]
    return float(seen[median]), float(true_ranges[median])
