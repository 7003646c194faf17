"""The jobs of a batch, which run in worker processes."""

from __future__ import annotations

from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import asdict, replace

from mavnav.batch.remote import download
from mavnav.config.options import absolute_options
from mavnav.errors import MavnavError
from mavnav.outputs.documents.addresses import public_address
from mavnav.pipelines.replay import replay_log

if TYPE_CHECKING:
    from mavnav.pipelines.replay import ReplayRequest
    from mavnav.profiling import Progress


def replay_local(request: ReplayRequest, report: Progress) -> None:
    """Replay one log into its run directory; the kernels are compiled already, and nothing is returned."""
    replay_log(request, report, compile_s=0.0)


def replay_remote(request: ReplayRequest, report: Progress) -> None:
    """Download a log and replay it; errors contain its address instead of its path."""
    report("fetching", 0, None)
    address = str(request.address)
    name = public_address(address)
    paths = {name: value for name, value in asdict(request).items() if isinstance(value, Path) and name != "log"}
    absolute: dict[str, Any] = {"options": absolute_options(request.options)}
    absolute |= {name: path.absolute() for name, path in paths.items()}
    with download(address) as folder, chdir(folder):
        try:
            replay_local(replace(request, **absolute), report)
        except MavnavError as error:
            error.args = (str(error).replace(str(request.log), name),)
            raise
