"""``mavnav simulate SCENARIO``: fly a mission in closed loop."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands import completion
from mavnav.commands.gating import Gates, check_gates, gated_code, gates_of
from mavnav.commands.map_preview import Preview, show_preview
from mavnav.commands.options import (
    Again,
    ConfigFile,
    Force,
    Json,
    Outputs,
    Quiet,
    ScenarioSets,
    WriteReport,
    again_directory,
    directory_option,
    input_option,
    note_repetition,
    output_option,
    output_values,
    run_to_repeat,
    schema_option,
    with_options,
)
from mavnav.commands.progress import MISSION, loading_modules, reporting
from mavnav.commands.quality_rows import closing_rows, doubt_rows, wall_rows
from mavnav.commands.terminal import emit_json, note, print_table
from mavnav.config.options import SEARCHING, read_options, settings_of
from mavnav.errors import ExitCode, UsageError
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.simulation.world import Scenario

EPILOG = """
[bold]Examples[/bold]

mavnav simulate corner.yaml

mavnav simulate complex --seed 7 --grid 20x20 --animate complex.gif

mavnav simulate u_trap --planner field

mavnav simulate corner --method paper

mavnav simulate hover --attitude off

mavnav simulate corridor --record flight.mcap && mavnav replay flight.mcap

mavnav simulate --again runs/corner-robust-20-10x10 -o runs/repeated

mavnav simulate --list
"""


@with_options(
    "attitude",
    *SEARCHING,
    attitude={
        "usage": "--attitude auto|off",
        "help": "Level the scans of a vehicle that tilts by its measured attitude (default auto).",
        "completer": "",
    },
)
def simulate(
    context: typer.Context,
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="YAML file, or a shipped scenario.",
            show_default=False,
            autocompletion=completion.scenarios,
        ),
    ] = None,
    *,
    again: Again = None,
    seed: Annotated[
        int | None, input_option(metavar="N", help="Seed of all random numbers (default the scenario's).")
    ] = None,
    planner: Annotated[
        str | None,
        input_option(
            metavar="NAME",
            help="wavefront, field, wall_following or virtual_obstacles (default the scenario's).",
            autocompletion=completion.words("wavefront", "field", "wall_following", "virtual_obstacles"),
        ),
    ] = None,
    list_: Annotated[bool, input_option("--list", help="List the shipped scenarios.")] = False,
    schema: Annotated[bool, schema_option(help="Print the JSON Schema of scenario files.")] = False,
    config: ConfigFile = None,
    sets: ScenarioSets = None,
    directory: Annotated[
        Path | None, directory_option(help="Run directory (default runs/SCENARIO-METHOD-YAW-GRID).")
    ] = None,
    record: Annotated[
        Path | None, output_option(metavar="FILE", help="Record the mission: .mcap, .bag, or a ROS 2 folder.")
    ] = None,
    animate: Annotated[Path | None, output_option(metavar="FILE.gif", help="Also write an animation.")] = None,
    force: Force = False,
    report: WriteReport = False,
    outputs: Outputs = None,
    preview: Preview = False,
    json: Json = False,
    quiet: Quiet = False,
    gates: Gates = None,
    **given: object,
) -> None:
    """Fly a mission in closed loop: laser, scan matching, map, planner, noisy vehicle."""
    if list_ or schema:
        _show(schema=schema)
        return
    if scenario is None and again is None:
        raise UsageError("no scenario; name a YAML file or one of 'mavnav simulate --list'")
    bounds, written = gates_of(gates), output_values(outputs, report=report, preview=preview)
    fields = {} if again is None else _earlier_fields(context, again, directory)
    options = {f"slam.{key}": value for key, value in settings_of(read_options(given)).items()}
    options |= {"seed": seed, "planner.technique": planner}
    chosen = fields.get("scenario") or _load(str(scenario), sets or (), config, options)
    check_gates(bounds, "mission", "truth", "reference")
    with reporting(quiet=quiet, stages=MISSION) as progress:
        started_s = perf_counter()
        with loading_modules():
            from msgspec.structs import replace

            from mavnav.outputs.documents.provenance import Typed
            from mavnav.pipelines.simulate import SimulationRequest, simulate_mission, simulation_directory
            from mavnav.simulation.world.scenario_file import scenario_path
        compile_s = perf_counter() - started_s
        target = directory or (again_directory(again) if again else simulation_directory(chosen))
        path = fields.get("path") or scenario_path(str(scenario))
        typed = Typed(context.obj, config, tuple(sets or ()))
        request = SimulationRequest(chosen, path, target, record, animate, force, typed=typed, **written)
        request = replace(request, **fields)
        _, document = simulate_mission(request, progress, compile_s)
    _print_result(document, target, json=json)
    if again:
        note_repetition(again, document)
    if preview:
        show_preview(target, stderr=json)
    raise typer.Exit(gated_code(document, bounds))


def _earlier_fields(context: typer.Context, again: Path, directory: Path | None) -> dict[str, Any]:
    """Return the fields of a request that repeat a mission, and report what differs."""
    from mavnav.pipelines.again import simulation_again

    return simulation_again(run_to_repeat(context, again, directory, "record", "animate", simulated=True))


def _show(*, schema: bool) -> None:
    from mavnav.config.loading import scenarios
    from mavnav.simulation.world import load_scenario, scenario_schema

    if schema:
        emit_json(scenario_schema())
    else:
        print_table([(name, load_scenario(name).about) for name in scenarios()])


def _load(scenario: str, sets: Sequence[str], config: str | None, options: dict[str, object]) -> Scenario:
    from mavnav.simulation.world import load_scenario

    return load_scenario(scenario, sets, options, config)


def _print_result(document: dict[str, Any], directory: Path, *, json: bool) -> None:
    if json:
        emit_json(document)
    else:
        print_table(_summary(document, directory))
    if document["exit_code"] in (ExitCode.GATE_FAILED, ExitCode.TRACKING_LOST):
        from mavnav.outputs.files.document import MAP_PICTURE, OTHER_PICTURE

        picture = directory / MAP_PICTURE if MAP_PICTURE in document["outputs"] else OTHER_PICTURE
        note(f"mavnav: error: {_failure(document)}; look at {picture}")


def _failure(document: dict[str, Any]) -> str:
    mission, lost = document["mission"], document["exit_code"] == ExitCode.TRACKING_LOST
    if mission["reached"]:
        return "tracking was lost for good, although the goal was reached"
    also = ", and tracking was lost for good" if lost and mission["reason"] != "tracking lost" else ""
    return f"the mission failed: {mission['reason']}{also}"


def _outcome(document: dict[str, Any]) -> str:
    mission, lost = document["mission"], document["exit_code"] == ExitCode.TRACKING_LOST
    if mission["reached"]:
        return "goal reached, but tracking was lost for good" if lost else "goal reached"
    return str(mission["reason"])


def _summary(document: dict[str, Any], directory: Path) -> list[tuple[str, str]]:
    mission, truth, timing = document["mission"], document["truth"], document["timing"]
    rows = [
        ("mission", _outcome(document)),
        (
            "scans",
            f"{mission['steps']}, {100 * document['scans']['accepted'] / mission['steps']:.0f} % of them accepted",
        ),
        ("path", f"{mission['path_length_m']:.2f} m, {_clearance(mission['min_clearance_m'])}"),
        *doubt_rows(document["tracking"]["doubt"]),
    ]
    return [
        *rows,
        *_truth_rows(truth),
        *wall_rows(document),
        ("speed", f"{mission['steps'] / timing['wall_s']:.0f} scans/s"),
        *closing_rows(directory, document, "true_map.png"),
    ]


def _clearance(least_m: float | None) -> str:
    return "no wall at flight height" if least_m is None else f"clearance {least_m:.2f} m at least"


def _truth_rows(truth: dict[str, Any]) -> list[tuple[str, str]]:
    if "ate_rmse_m" not in truth:
        return [("error", f"not measurable, {truth['ate_poses']} poses")]
    turned_deg = truth["map_yaw_error_rad"] / DEG
    return [
        ("ATE, aligned", f"{1e3 * truth['ate_rmse_m']:.0f} mm, final {1e3 * truth['final_aligned_error_m']:.0f} mm"),
        (
            "from the start",
            f"drift at the end {1e3 * truth['final_error_m']:.0f} mm, map rotated by {turned_deg:.1f} deg",
        ),
        ("wall distance", _wall_distance(truth)),
    ]


def _wall_distance(truth: dict[str, Any]) -> str:
    on_map_m, true = truth["wall_distance_m"], truth["true_wall_distance_m"]
    return "not on the map" if on_map_m is None or true is None else f"{on_map_m:.3f} m, true {true:.3f} m"
