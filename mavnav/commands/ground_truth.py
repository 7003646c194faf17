"""``--truth``, ``--truth-map``, ``--relations``: what a command compares its outcome with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from mavnav.commands.options import CHECKS, given

Truth = Annotated[
    Path | None,
    given("--truth", metavar="FILE.tum", help="Ground-truth laser trajectory: ATE and RPE.", rich_help_panel=CHECKS),
]
TruthMap = Annotated[
    Path | None,
    given(
        "--truth-map",
        metavar="FILE.yaml",
        help="Ground-truth map: a scenario, or a map_server map.",
        rich_help_panel=CHECKS,
    ),
]
RelationsFile = Annotated[
    Path | None,
    given(
        "--relations",
        metavar="FILE",
        help="Ground-truth relations, one 't1 t2 x y z roll pitch yaw' a line.",
        rich_help_panel=CHECKS,
    ),
]
