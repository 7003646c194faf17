"""Options that several commands share: which scans of a log, with what settings."""

from __future__ import annotations

from typing import Annotated

import typer

Online = Annotated[bool, typer.Option("--online", help="Leave out what looks back: loops, final pass.")]
Odom = Annotated[
    str | None,
    typer.Option(metavar="auto|TOPIC|off", help="Odometry as prediction (never with paper).", show_default=False),
]
Topic = Annotated[str | None, typer.Option(help="Scan topic, where there are several.", show_default=False)]
Start = Annotated[float | None, typer.Option(help="Begin so many seconds after the first scan.", show_default=False)]
End = Annotated[float | None, typer.Option(help="End so many seconds after the first scan.", show_default=False)]
Extrinsic = Annotated[
    str | None,
    typer.Option(metavar="X,Y,YAW", help="Laser on its base, m, m, rad; overrides tf.", show_default=False),
]
ConfigFile = Annotated[
    str | None, typer.Option(metavar="FILE", help="YAML file, or the name of a preset.", show_default=False)
]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One value of it.", show_default=False)
]
Strict = Annotated[bool, typer.Option("--strict", help="Leave out scans from where a checksum does not match.")]
RunAgain = Annotated[bool, typer.Option("--force", help="Run again what was run before.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")]
