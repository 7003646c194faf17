"""The jobs of a batch, as worker processes run them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav import replay

if TYPE_CHECKING:
    from mavnav.jobs import Report


def replay_there(request: replay.Request, report: Report) -> None:
    """Replay one log; what comes out is in the run directory, and nothing of it goes back to the parent."""
    replay.replay(request, report, compile_s=0.0)
