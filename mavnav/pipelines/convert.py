"""What is converted of a log: the document of ``mavnav convert``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import asdict

from mavnav.errors import ExitCode
from mavnav.logs.writing.convert import convert_log
from mavnav.pipelines.augment import messages_of_run

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SCHEMA_VERSION: Final = 1


def convert_to(
    log: Path, target: Path, run: Path | None, *, strict: bool, force: bool, progress: Callable[..., None]
) -> dict[str, Any]:
    """Convert a log to an indexed MCAP and return the document; with a ``run``, its result is added to the log.

    Raises what `convert_log` does, and `messages_of_run`.
    """
    added = messages_of_run(run, log) if run else ()
    done = convert_log(log, target, strict=strict, force=force, progress=progress, added=added)
    return {
        "schema_version": SCHEMA_VERSION,
        "input": {"path": str(log)},
        "output": {"path": str(target), "size_bytes": target.stat().st_size},
        "topics": [asdict(topic) for topic in done.topics],
        "messages": done.messages,
        "left_out": done.left_out,
        "damage": [asdict(damage) for damage in done.damage],
        "warnings": list(done.warnings),
        "exit_code": int(ExitCode.DAMAGED_INPUT if done.damage else ExitCode.DONE),
    }
