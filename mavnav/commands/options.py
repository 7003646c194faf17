"""Options that several commands share, one set a topic; help shows each set in a panel of its own."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

INPUT, SEARCH, OUTPUT, CHECKS, RESOURCES = "Input", "Search", "Output", "Checks", "Resources"
"""Panels of the help."""

_input, _search, _output = (partial(typer.Option, rich_help_panel=panel) for panel in (INPUT, SEARCH, OUTPUT))
given = partial(typer.Option, show_default=False)
"""An option without a default of its own."""

LogFile = Annotated[
    Path, typer.Argument(metavar="LOG", help="MCAP file, ROS 1 bag, ROS 2 bag folder or .db3.", show_default=False)
]

Topic = Annotated[str | None, _input(help="Scan topic, if the log has several.", show_default=False)]
Start = Annotated[
    float | None,
    _input(metavar="SECONDS", help="Skip the log before this time after the first scan.", show_default=False),
]
End = Annotated[
    float | None, _input(metavar="SECONDS", help="Stop at this time after the first scan.", show_default=False)
]
Extrinsic = Annotated[
    str | None,
    _input(metavar="X,Y,YAW", help="Pose of the laser on its base (m, m, rad); overrides tf.", show_default=False),
]
Odom = Annotated[
    str | None,
    _input(
        metavar="auto|TOPIC|off", help="Odometry used as motion prior (robust only; default auto).", show_default=False
    ),
]
Strict = Annotated[bool, _input("--strict", help="Drop scans whose checksum does not match.")]

Method = Annotated[
    str | None, _search(metavar="robust|paper", help="SLAM method (default robust).", show_default=False)
]
Methods = Annotated[
    list[str] | None,
    _search("--method", metavar="robust|paper", help="SLAM method (default robust); repeatable.", show_default=False),
]
Grid = Annotated[
    str | None, _search(metavar="NxM", help="Points of the search grid in x and y (default 10x10).", show_default=False)
]
Azimuth = Annotated[
    int | None, _search(metavar="N", help="Yaw samples of the search (default 20).", show_default=False)
]
Online = Annotated[bool, _search("--online", help="Causal mode: no loop closure, no final pass.")]
ConfigFile = Annotated[
    str | None, _search(metavar="FILE", help="Configuration: a YAML file, or the name of a preset.", show_default=False)
]
Sets = Annotated[
    list[str] | None,
    _search("--set", metavar="KEY=VALUE", help="Override one configuration value; repeatable.", show_default=False),
]

Report = Annotated[bool, _output("--report", help="Also write the run as one page, report.html.")]
Force = Annotated[bool, _output("--force", help="Overwrite the output if it exists.")]
RunAgain = Annotated[bool, _output("--force", help="Run again what is already in the cache.")]
Json = Annotated[bool, _output("--json", help="Print one JSON document on stdout and nothing else.")]
Quiet = Annotated[bool, _output("--quiet", "-q", help="Show no progress.")]
Jobs = Annotated[
    int | None,
    given("--jobs", "-j", min=1, metavar="N", help="Parallel runs (default one a core).", rich_help_panel=RESOURCES),
]
