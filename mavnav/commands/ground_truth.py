"""``--truth``, ``--truth-map``, ``--relations``: what a command compares its outcome with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Truth = Annotated[
    Path | None,
    typer.Option("--truth", metavar="FILE.tum", help="True trajectory of the laser: ATE and RPE.", show_default=False),
]
TruthMap = Annotated[
    Path | None,
    typer.Option(
        "--truth-map", metavar="FILE.yaml", help="True map: a scenario, or a map_server map.", show_default=False
    ),
]
RelationsFile = Annotated[
    Path | None,
    typer.Option(
        "--relations", metavar="FILE", help="True motions, t1 t2 x y z roll pitch yaw a line.", show_default=False
    ),
]
