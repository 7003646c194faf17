"""``--preview``: the map of a run directory as a few lines of text."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from mavnav.commands.terminal import can_print, printable
from mavnav.config.option_kinds import OUTPUT

if TYPE_CHECKING:
    from pathlib import Path

Preview = Annotated[
    bool, typer.Option("--preview", help="Print the map as text (on stderr with --json).", rich_help_panel=OUTPUT)
]


def show_preview(directory: Path, title: str = "", *, stderr: bool = False) -> None:
    """Print the map of a run directory, under a title if one is given."""
    from mavnav.outputs.files.gridmap import read_npz
    from mavnav.outputs.pictures.preview import preview

    stream: TextIO = sys.stderr if stderr else sys.stdout
    lines = preview(read_npz(directory / "hits.npz"), braille=can_print("\u28ff", stream))
    stream.write("\n".join(["", *([printable(title)] if title else []), *lines]) + "\n")
    stream.flush()
