"""The manifest of a batch: a YAML file with logs, settings and gates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from msgspec import Meta, Struct, defstruct, field
from msgspec.structs import force_setattr

from mavnav.config.layers import Layer
from mavnav.config.loading import origin, read_model
from mavnav.config.models import Strict, setting
from mavnav.config.option_kinds import NUMBER, SWITCH, Option, pose_problem
from mavnav.config.options import OPTIONS
from mavnav.config.yaml_layers import read_yaml
from mavnav.errors import ConfigError, UsageError
from mavnav.metrics.gates import full_name
from mavnav.outputs.documents.addresses import is_address

Origins = Mapping[tuple[str, str | int], str]
"""File and line of each gate, accepted code and tolerance of a manifest, by ``gates``, ``accept`` and
``tolerances`` and its value (a tolerance: its full name).
"""
GATE_EXAMPLE: Final = "write for example wall_thickness.p95_mm<=150, or baseline"


Size = Annotated[float, Meta(ge=-1e9, le=1e9)]
_EMPTY: Final[Any] = field(default_factory=dict)


def _list(entry: Struct, *names: str) -> None:
    """Make lists of the fields that are written as their only item."""
    for name in names:
        value = getattr(entry, name)
        force_setattr(entry, name, value if isinstance(value, tuple) else (value,))


class _Logs(Strict, frozen=True):
    log: Annotated[Texts, setting("path, pattern, folder or address; or a list of them")]


def _field(name: str, option: Option) -> tuple[str, Any, object]:
    if option.kind is SWITCH:
        return name, Annotated[bool, setting(option.help)], False
    stored = Annotated[float, Meta(ge=0, le=1e9)] if option.kind is NUMBER else option.kind.stored
    return name, Annotated[stored | None, setting(option.help)], None


_FIELDS: Final = [_field(name, option) for name, option in OPTIONS.items() if option.manifest]

if TYPE_CHECKING:
    _Options = _Logs
else:
    _Options = defstruct("_Options", _FIELDS, bases=(_Logs,), module=__name__, frozen=True)


class LogEntry(_Options, frozen=True):
    """Logs with the same options, and gates for them in addition to those of the batch."""

    gates: Annotated[Texts, setting("bounds such as wall_thickness.p95_mm<=150")] = ()
    accept: Annotated[Accepted, setting("what counts as done: exit codes, such as 3, and the worst verdict")] = ()
    name: Annotated[str, setting("name of a single log, for --only and on the page")] = ""
    sha256: (
        Annotated[str, Meta(pattern="^[0-9a-f]{64}$"), setting("of the file at an address: fetched once")] | None
    ) = None
    size_bytes: Annotated[int, setting("size of that file", ge=1, le=10**13)] | None = None
    licence: Annotated[str, setting("licence of the log, shown on the page")] = ""
    peers: Annotated[dict[str, dict[str, Size]], setting("program: its numbers of run.json, shown beside")] = _EMPTY

    def __post_init__(self) -> None:
        """Make lists of single items; raise ValueError if pose of the laser, name or digest cannot be meant."""
        _list(self, "log", "gates", "accept")
        if not self.log or "" in self.log:
            raise ValueError("log: should name a log")
        if (self.name or self.sha256) and (len(self.log) != 1 or (not is_address(self.log[0]) and self.sha256)):
            raise ValueError("log: should be a single log to have a name or sha256, the latter one at an address")
        if (self.sha256 is None) != (self.size_bytes is None):
            raise ValueError("log: should have both sha256 and size_bytes, or neither")
        pose = self.values["extrinsic"]
        if pose and (problem := pose_problem(*pose)):
            raise ValueError(f"extrinsic: {problem}")

    @property
    def values(self) -> dict[str, Any]:
        """The options by their names."""
        return {name: getattr(self, name) for name, *_ in _FIELDS}


if TYPE_CHECKING:
    Texts = tuple[str, ...]
    Accepted = tuple[int | str, ...]
    Entries = tuple[LogEntry, ...]
else:
    Texts = tuple[str, ...] | str
    Accepted = tuple[int | str, ...] | int | str
    Entries = tuple[LogEntry | str, ...]
"""Lists, which may be written as their only item, and entries of logs, which may be the log alone."""


class Manifest(Strict, frozen=True):
    """Logs and settings, which are combined. Relative paths start at the manifest's folder."""

    logs: Annotated[Entries, setting("paths, or sections with log")] = ()
    runs: Annotated[tuple[dict[str, Any], ...], setting("keys of a configuration, with name and config (a file)")] = ()
    gates: Annotated[
        Texts,
        setting("bounds for every run; baseline: no run is worse than in it; identical: repeats have equal bytes"),
    ] = ()
    accept: Annotated[
        Accepted, setting("what counts as done: exit codes, and the worst verdict (default suspect)")
    ] = ()
    baseline: Annotated[str | None, setting("an earlier batch: its directory, batch.json, or a baseline file")] = None
    tolerances: Annotated[dict[str, Size | str], setting("number: tolerance, as 5, 5% or 5%,high")] = _EMPTY
    output: Annotated[str | None, setting("directory")] = None
    report: Annotated[bool, setting("write a report of every run")] = False
    jobs: Annotated[int, setting("runs at a time", ge=1)] | None = None
    timeout_s: Annotated[float, setting("a run that takes longer is stopped", gt=0, le=1e9)] | None = None
    memory_mb: Annotated[int, setting("memory limit of a run", ge=1, le=10**9)] | None = None
    repeat: Annotated[int, setting("how often every run is made", ge=1, le=100)] = 1
    tries: Annotated[int, setting("attempts for a run whose process was killed", ge=1)] = 3

    def __post_init__(self) -> None:
        """Make lists of single items, and entries of logs that are only named; raise ValueError for an empty name."""
        _list(self, "gates", "accept")
        if not all(self.logs):
            raise ValueError("logs: should name each log")
        force_setattr(self, "logs", tuple(LogEntry(log=(e,)) if isinstance(e, str) else e for e in self.logs))


def read_manifest(path: Path) -> tuple[Manifest, Layer]:
    """Return a manifest, and the layer with the line of each of its values; raises ConfigError with the line."""
    layer = read_yaml(path, "the YAML file of a manifest")
    return read_model(Manifest, layer, str(path)), layer


def origins_of(manifest: Manifest, layer: Layer) -> Origins:
    """Return where the gates, accepted codes and tolerances are in a manifest; of several places the first one."""
    origins: dict[tuple[str, str | int], str] = {}
    for name in manifest.tolerances:
        origins["tolerances", full_name(name)] = origin(layer, ("tolerances", name))
    for key, part in (((), manifest), *((("logs", str(number)), log) for number, log in enumerate(manifest.logs))):
        for name in ("gates", "accept"):
            for number, value in enumerate(getattr(part, name)):
                given = value.strip() if isinstance(value, str) else value
                origins.setdefault((name, given), origin(layer, (*key, name, str(number))))
    return origins


@contextmanager
def errors_at(where: str | None) -> Iterator[None]:
    """Turn a UsageError into a ConfigError that begins with file and line, if they are known."""
    try:
        yield
    except UsageError as error:
        if where is None:
            raise
        raise ConfigError(f"{where}: {error}") from error
