"""Options of the poses of other programs, which ``score`` and ``compare`` take."""

from __future__ import annotations

from typing import Annotated

from mavnav.commands.shared import input_option, resource_option

Trajectories = Annotated[
    list[str] | None,
    input_option(
        "--trajectory",
        metavar="[NAME=]SOURCE",
        help="FILE[,FRAME] (TUM, CSV, EuRoC, or a run), topic:/T or tf:MAP,FRAME; @first, @middle or @last: beam "
        "at whose time a pose holds (default: that of the scan as recorded). Repeatable.",
    ),
]
Programs = Annotated[
    list[str] | None,
    input_option(
        "--external",
        metavar="NAME=COMMAND",
        help="Run a program that reads the log, {log}, and writes a trajectory, {out}. Repeatable.",
    ),
]
ProgramLimit = Annotated[
    float, resource_option("--time-limit", min=0.0, metavar="SECONDS", help="Longest time of a program.")
]
