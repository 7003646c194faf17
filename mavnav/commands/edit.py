"""``mavnav edit RUN|MAP.yaml``: a map cropped and cleaned, as a new one.

Examples
--------
mavnav edit runs/drive --keep-largest
mavnav edit runs/drive --erase 1.2,0.5,2,1.5 --erase 4,-1,4.6,-0.2 --crop -3,-2,12,9 -o runs/clean
mavnav edit toolbox/map.yaml --unknown 12,-4,20,3 -o clean.yaml
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.terminal import Rows, print_result

_CORNERS = "X0,Y0,X1,Y1"


def edit(
    path: Annotated[Path, typer.Argument(metavar="RUN|MAP.yaml", show_default=False)],
    *,
    erase: Annotated[list[str] | None, shared.search_option("--erase", metavar=_CORNERS)] = None,
    unknown: Annotated[list[str] | None, shared.search_option("--unknown", metavar=_CORNERS)] = None,
    crop: Annotated[str | None, shared.search_option("--crop", metavar=_CORNERS)] = None,
    keep_largest: Annotated[bool, shared.search_option("--keep-largest")] = False,
    output: Annotated[Path | None, shared.output_option("--output", "-o", metavar="DIR|FILE.yaml")] = None,
    force: shared.Force = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
) -> None:
    """Edit a map, rectangles in m of the map frame: erase, then unknown, crop, keep the largest area.

    Parameters
    ----------
    path
        Run directory, or map_server map (YAML).
    erase
        Make occupied cells of a rectangle free. Repeatable.
    unknown
        Make a rectangle unknown. Repeatable.
    crop
        Keep this rectangle only.
    keep_largest
        Keep the largest free area and the walls that touch it.
    output
        Where to write (default beside it, NAME-edited).
    """
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.pipelines.edit import EditRequest, edit_map, read_edits
        edits = read_edits(erase or (), unknown or (), crop, keep_largest=keep_largest)
        named = path.absolute()
        target = output or named.with_name(f"{named.name}-edited" if path.is_dir() else f"{named.stem}-edited.yaml")
        document = edit_map(EditRequest(path, edits, target, force), report)
    print_result(document, _rows(document), json=json)


def _rows(document: dict[str, Any]) -> Rows:
    """Yield the rows of the table."""
    width_m, height_m = document["map"]["size_m"]
    x_m, y_m = document["map"]["origin_xy_m"]
    yield "written", document["output"]
    for name in ("occupied", "known"):
        before, after = (document["cells"][when][name] for when in ("before", "after"))
        yield name, f"{after} cells, {before} before"
    yield "size", f"{width_m:.1f} m x {height_m:.1f} m from {x_m:z.2f}, {y_m:z.2f} m"
