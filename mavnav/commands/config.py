"""``mavnav config``: see the effective configuration, and the schema for editors.

Examples
--------
mavnav config show paper
mavnav config show --set robust.cell_mm=25 > my.yaml
mavnav config schema run
"""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from mavnav.commands import completion, shared
from mavnav.commands.terminal import emit, emit_json
from mavnav.commands.values import CommandGroup, PlainCommand

app = typer.Typer(cls=CommandGroup, help="Show the configuration, its presets and its schema.")


@app.command(cls=PlainCommand)
def show(
    config: Annotated[
        str | None, typer.Argument(metavar="FILE", show_default=False, autocompletion=completion.presets)
    ] = None,
    sets: shared.Sets = None,
    method: Annotated[str | None, shared.replay_option("method")] = None,
) -> None:
    """Print the effective configuration as YAML with comments; it can be given to --config.

    Parameters
    ----------
    config
        YAML file, or the name of a preset.
    """
    from mavnav.config.loading import load_config, to_yaml

    emit(to_yaml(load_config(config, sets or [], {"method": method})).rstrip())


@app.command(cls=PlainCommand)
def schema(document: Annotated[Literal["config", "run"], typer.Argument(metavar="config|run")] = "config") -> None:
    """Print the JSON Schema of configuration files, for editors that check while you type, or of run.json.

    Parameters
    ----------
    document
        Of configuration files, or of run.json.
    """
    from mavnav.config.loading import schema_of
    from mavnav.config.models import Config
    from mavnav.outputs.documents.schema import run_schema

    emit_json(run_schema() if document == "run" else schema_of(Config))
