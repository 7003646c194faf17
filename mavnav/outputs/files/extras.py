"""What result.mcap holds besides messages: a metadata record, and the files that describe the run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mavnav.logs.writing.mcap_writer import Attachment, Extras
from mavnav.outputs.files.document import plain, plain_json, run_document, to_json
from mavnav.outputs.files.gridmap import pgm_rows, yaml_text
from mavnav.version import __version__

if TYPE_CHECKING:
    from mavnav.outputs.run import RunResult

MOST_CELLS: Final = 2_000_000
"""The picture of a larger map is not attached: ``/map`` has it, compressed."""

_CHANGING: Final = ("timing", "provenance", "outputs", "python", "libraries")
"""Sections of run.json that differ from run to run or between machines, or describe the files beside it."""


def extras(run: RunResult) -> Extras:
    """Return the metadata record ``mavnav``, and run.json, configuration and map files as attachments.

    Of run.json the sections are left out that differ from run to run, and the path of the log, or the whole file of a
    scenario: equal runs have equal bytes.
    """
    document: dict[str, Any] = plain(run_document(run, {}))
    document = {name: section for name, section in document.items() if name not in _CHANGING}
    del document["input"]["path"]
    for key in ("sha256", "size_bytes") if run.mission else ():
        del document["input"][key]
    texts = {
        "run.json": ("application/json", plain_json(document)),
        "config.json": ("application/json", to_json(run.config)),
        "map.yaml": ("application/yaml", yaml_text(run)),
    }
    files = [Attachment(name, kind, text.encode()) for name, (kind, text) in texts.items()]
    if run.known.hits.size <= MOST_CELLS:
        files.append(Attachment("map.pgm", "image/x-portable-graymap", b"".join(pgm_rows(run))))
    return Extras(run.log.first_ns, {"mavnav": _metadata(run)}, tuple(files))


def _metadata(run: RunResult) -> dict[str, str]:
    """Return what identifies a run; of a mission its recording has no name."""
    name = run.log.path.name.encode(errors="backslashreplace").decode()  # names of files need not be UTF-8
    log = {} if run.mission else {"log": name, "log_sha256": run.log.sha256}
    return {
        "version": __version__,
        **log,
        "topic": run.log.topic,
        "method": run.config.method,
        "grid": str(run.config.grid),
        "azimuth": str(run.config.azimuth),
        "tracked_share": f"{run.slam.tracked_share:.6f}",
        "exit_code": str(int(run.exit_code)),
    }
