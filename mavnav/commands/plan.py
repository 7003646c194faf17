"""``mavnav plan RUN|MAP.yaml``: the floor plan of a map, as SVG or DXF.

Examples
--------
mavnav plan runs/drive
mavnav plan runs/drive -o drive.dxf
mavnav plan toolbox/map.yaml -o office.svg --scale 50
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.terminal import LISTED, Rows, print_result


def plan(
    source: Annotated[Path, typer.Argument(metavar="RUN|MAP.yaml", show_default=False)],
    *,
    output: Annotated[Path | None, shared.output_option("--output", "-o", metavar="FILE.svg|FILE.dxf")] = None,
    scale: Annotated[float, shared.output_option("--scale", metavar="N", min=1.0)] = 100.0,
    force: shared.Force = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
) -> None:
    """Draw the straight walls of a map along the axes, with openings such as doors as gaps.

    Parameters
    ----------
    source
        Run directory, or map_server map (YAML).
    output
        The drawing (default RUN/plan.svg, or MAP-plan.svg).
    scale
        Scale of an SVG, 1:N (default 100).
    """
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.pipelines.plan import draw_plan
        usual = source / "plan.svg" if source.is_dir() else source.with_name(f"{source.stem}-plan.svg")
        document = draw_plan(source, output or usual, scale, report, force=force)
    print_result(document, _rows(document), json=json)


def _rows(document: dict[str, Any]) -> Rows:
    """Yield the rows of the table."""
    width_m, height_m = document["size_m"]
    verdict = document["verdict"]
    if verdict and verdict["word"] != "good":
        yield "map", f"{document['input']} is {verdict['word']}: {verdict['reason']}"
    yield "written", document["output"]
    yield "walls", f"{len(document['walls'])}, {document['wall_m']:.1f} m together"
    yield "size", f"{width_m:.2f} m x {height_m:.2f} m, map turned by {document['yaw_deg']:z.2f} deg"
    widths = [f"{each['length_m']:.2f} m" for each in document["openings"][:LISTED]]
    more = len(document["openings"]) - len(widths)
    yield "openings", (", ".join(widths) + (f" and {more} more" if more else "")) or "none"
