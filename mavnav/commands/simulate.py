"""``mavnav simulate SCENARIO``: fly a mission in closed loop.

Examples
--------
mavnav simulate corner.yaml
mavnav simulate complex --seed 7 --grid 20x20 --animate complex.gif
mavnav simulate u_trap --planner field
mavnav simulate corner --method paper
mavnav simulate hover --attitude off
mavnav simulate corridor --record flight.mcap && mavnav replay flight.mcap
mavnav simulate --again runs/corner-robust-20-10x10 -o runs/repeated
mavnav simulate --list
"""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from mavnav.commands import completion, shared
from mavnav.commands.progress import MISSION, loading_modules, reporting
from mavnav.commands.run_screen import map_rows, print_run, refusal_rows
from mavnav.commands.terminal import Rows, emit_json, note, print_table
from mavnav.config.options import SEARCHING, read_options, settings_of
from mavnav.errors import ExitCode, UsageError
from mavnav.units import DEG


@shared.with_options("attitude", *SEARCHING, attitude={"usage": "--attitude auto|off", "completer": ""})
def simulate(
    context: typer.Context,
    scenario: Annotated[
        str | None, typer.Argument(metavar="SCENARIO", show_default=False, autocompletion=completion.scenarios)
    ] = None,
    *,
    again: shared.Again = None,
    seed: Annotated[int | None, shared.input_option(metavar="N")] = None,
    planner: Annotated[str | None, shared.input_option(metavar="NAME", autocompletion=completion.planners)] = None,
    list_: Annotated[bool, shared.input_option("--list")] = False,
    schema: Annotated[bool, shared.schema_option()] = False,
    config: shared.ConfigFile = None,
    sets: shared.Sets = None,
    directory: Annotated[Path | None, shared.directory_option()] = None,
    record: Annotated[Path | None, shared.output_option(metavar="FILE")] = None,
    animate: Annotated[Path | None, shared.output_option(metavar="FILE.gif")] = None,
    force: shared.Force = False,
    report: shared.Report = False,
    outputs: shared.Outputs = None,
    preview: shared.Preview = None,
    verbose: shared.Verbose = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    gates: shared.Gates = None,
    **given: object,
) -> None:
    """Fly a mission in closed loop: laser, scan matching, map, planner, noisy vehicle.

    Parameters
    ----------
    attitude
        Level the scans of a vehicle that tilts by its measured attitude (default auto).
    scenario
        YAML file, or a shipped scenario.
    seed
        Seed of all random numbers (default the scenario's).
    planner
        wavefront, field, wall_following or virtual_obstacles (default the scenario's).
    list_
        List the shipped scenarios.
    schema
        Print the JSON Schema of scenario files.
    sets
        Override one key of the scenario file; those of a replay are below slam. Repeatable.
    directory
        Run directory (default runs/SCENARIO-METHOD-YAW-GRID, with a number where that exists).
    record
        Record the mission: .mcap, .bag, or a ROS 2 folder.
    animate
        Also write an animation.
    """
    from mavnav.config.loading import scenarios
    from mavnav.simulation.world.scenario_file import load_scenario, scenario_path, scenario_schema

    if schema:
        emit_json(scenario_schema())
        return
    if list_:
        print_table((name, load_scenario(name).about) for name in scenarios())
        return
    if scenario is None and again is None:
        raise UsageError("no scenario; name a YAML file or one of 'mavnav simulate --list'")
    bounds, written = shared.gates_of(gates), shared.output_values(outputs, report=report, preview=preview)
    fields = {} if again is None else _earlier_fields(context, again, directory)
    options = {f"slam.{key}": value for key, value in settings_of(read_options(given)).items()}
    options |= {"seed": seed, "planner.technique": planner}
    chosen = fields.pop("scenario", None) or load_scenario(str(scenario), sets or (), options, config)
    shared.check_gates(bounds, "mission", "truth", "reference")
    with reporting(quiet=quiet, stages=MISSION) as progress:
        started_s = perf_counter()
        with loading_modules():
            from mavnav.outputs.documents.provenance import Typed
            from mavnav.pipelines.simulate import SimulationRequest, simulate_mission, simulation_directory
        compile_s = perf_counter() - started_s
        usual = shared.again_directory(again) if again else simulation_directory(chosen)
        target = directory or shared.free_directory(context, usual, force=force)
        path = fields.pop("path", None) or scenario_path(str(scenario))
        fields = {"typed": Typed(context.obj, config, tuple(sets or ())), **written, **fields}
        request = SimulationRequest(chosen, path, target, record, animate, force, **fields)
        _, document = simulate_mission(request, progress, compile_s)
    if directory is None:
        shared.link_latest(target)
    about, measures = _flight_rows(document), _measures(document)
    print_run(document, target, about, measures, json=json, preview=preview, verbose=verbose)
    _note_failure(document, target)
    if again:
        shared.note_repetition(again, document)
    raise typer.Exit(shared.gated_code(document, bounds))


def _earlier_fields(context: typer.Context, again: Path, directory: Path | None) -> dict[str, Any]:
    """Return the fields of a request that repeat a mission, and report what differs."""
    from mavnav.pipelines.again import simulation_again

    return simulation_again(shared.run_to_repeat(context, again, directory, "record", "animate", simulated=True))


def _note_failure(document: dict[str, Any], directory: Path) -> None:
    """Print on stderr why a mission failed."""
    mission, lost = document["mission"], document["exit_code"] == ExitCode.TRACKING_LOST
    if not mission["reached"]:
        from mavnav.outputs.files.document import MAP_PICTURE, OTHER_PICTURE

        picture = directory / MAP_PICTURE if MAP_PICTURE in document["outputs"] else OTHER_PICTURE
        also = ", and tracking was lost for good" if lost and mission["reason"] != "tracking lost" else ""
        note(f"mavnav: error: the mission failed: {mission['reason']}{also}; look at {picture}")


def _flight_rows(document: dict[str, Any]) -> Rows:
    """Yield the rows on how a mission went."""
    mission = document["mission"]
    steps, least_m = mission["steps"], mission["min_clearance_m"]
    lost = ", but tracking was lost for good" if document["exit_code"] == ExitCode.TRACKING_LOST else ""
    outcome = f"goal reached{lost}" if mission["reached"] else mission["reason"]
    clearance = "no wall at flight height" if least_m is None else f"clearance {least_m:.2f} m at least"
    yield "mission", f"{outcome}; {mission['path_length_m']:.2f} m flown, {clearance}"
    yield "used", f"{100 * document['scans']['accepted'] / steps:.0f} % of {steps} scans have a pose"
    yield from refusal_rows(document)


def _measures(document: dict[str, Any]) -> Rows:
    """Yield the rows below the map."""
    truth = document["truth"]
    yield from map_rows(document)
    if "ate_rmse_m" in truth:
        yield from _truth_rows(truth)
    else:
        yield "error", f"not measurable, {truth['ate_poses']} poses"


def _truth_rows(truth: dict[str, Any]) -> Rows:
    ate_mm, final_mm = 1e3 * truth["ate_rmse_m"], 1e3 * truth["final_aligned_error_m"]
    yield "ATE, aligned", f"{ate_mm:.0f} mm, final {final_mm:.0f} mm"
    drift_mm, turned_deg = 1e3 * truth["final_error_m"], truth["map_yaw_error_rad"] / DEG
    yield "from the start", f"drift at the end {drift_mm:.0f} mm, map rotated by {turned_deg:.1f} deg"
    on_map_m, true_m = truth["wall_distance_m"], truth["true_wall_distance_m"]
    measured = on_map_m is not None and true_m is not None
    yield "wall distance", f"{on_map_m:.3f} m, true {true_m:.3f} m" if measured else "not on the map"
