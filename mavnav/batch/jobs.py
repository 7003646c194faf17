"""The jobs of a batch, as worker processes run them."""

from __future__ import annotations

from contextlib import chdir
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavnav.batch.remote import fetched
from mavnav.errors import MavnavError
from mavnav.pipelines import replay

if TYPE_CHECKING:
    from mavnav.jobs import Report


def replay_there(request: replay.Request, report: Report) -> None:
    """Replay one log; what comes out is in the run directory, and nothing of it goes back to the parent."""
    replay.replay(request, report, compile_s=0.0)


def replay_fetched(request: replay.Request, report: Report) -> None:
    """Replay a log that is fetched first, and told of by its address."""
    report("fetching", 0, None)
    address = str(request.address)
    paths = {field.name: getattr(request, field.name) for field in fields(request) if field.name != "log"}
    absolute: dict[str, Any] = {name: path.absolute() for name, path in paths.items() if isinstance(path, Path)}
    with fetched(address) as folder, chdir(folder):
        try:
            replay_there(replace(request, **absolute), report)
        except MavnavError as error:
            error.args = (str(error).replace(str(request.log), address),)
            raise
