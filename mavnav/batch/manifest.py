"""The manifest of a batch: a YAML file with logs, settings and gates."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Final

from pydantic import AfterValidator, BeforeValidator, Field

from mavnav.config.given_pose import pose_problem
from mavnav.config.loading import origin, validated
from mavnav.config.strict import Strict
from mavnav.config.yaml_layers import read_yaml
from mavnav.errors import ConfigError, UsageError
from mavnav.metrics.gates import full_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from mavnav.config.layers import Layer

    Origins = Mapping[tuple[str, str | int], str]
    """File and line of each gate, accepted code and tolerance of a manifest, by ``gates``, ``accept`` and
    ``tolerances`` and its value (a tolerance: its full name).
    """

GATE_EXAMPLE: Final = "write for example wall_thickness.spread.p95_mm<=150, or baseline"


def _listed(value: object) -> object:
    return value if isinstance(value, list | tuple) else [value]


def _entry(value: object) -> object:
    return {"log": value} if isinstance(value, str) else value


def _sound(pose: tuple[float, float, float]) -> tuple[float, float, float]:
    if problem := pose_problem(*pose):
        raise ValueError(problem)
    return pose


Texts = Annotated[tuple[str, ...], BeforeValidator(_listed)]
Codes = Annotated[tuple[int, ...], BeforeValidator(_listed)]


class Entry(Strict):
    """Logs with the same options for reading, and gates for them in addition to those of the batch."""

    log: Texts = Field(description="path, pattern, folder or address; or a list of them")
    topic: str | None = Field(None, description="scan topic, if there are several")
    start_s: float | None = Field(None, ge=0, description="start this many seconds after the first scan")
    end_s: float | None = Field(None, ge=0, description="end this many seconds after the first scan")
    extrinsic: Annotated[tuple[float, float, float], AfterValidator(_sound)] | None = Field(
        None, description="laser on its base: x and y in m, yaw in rad"
    )
    strict: bool = Field(False, description="leave out scans from parts of the log whose checksum does not match")
    truth: str | None = Field(
        None, description="true trajectory: a TUM file, auto, or topic:NAME of the log, as of mavnav replay --truth"
    )
    truth_map: str | None = Field(None, description="true map, as of --truth-map")
    relations: str | None = Field(None, description="true relative poses, as of --relations")
    gates: Texts = Field((), description="bounds such as wall_thickness.spread.p95_mm<=150")
    accept: Codes = Field((), description="exit codes that count as done, such as 3 for a log known to be damaged")


class Manifest(Strict):
    """Logs and settings, which are combined. Relative paths start at the manifest's folder."""

    logs: tuple[Annotated[Entry, BeforeValidator(_entry)], ...] = Field((), description="paths, or sections with log")
    runs: tuple[dict[str, Any], ...] = Field(
        (), description="settings, every log with each: the keys of a configuration, with name and config (a file)"
    )
    gates: Texts = Field((), description="bounds for every run; the word baseline: no run may be worse than in it")
    accept: Codes = Field((), description="exit codes that count as done")
    baseline: str | None = Field(None, description="an earlier batch: its directory, batch.json, or a baseline file")
    tolerances: dict[str, float | str] = Field(
        {}, description="number of run.json: its tolerance, such as 5, 5% or 5%,high"
    )
    output: str | None = Field(None, description="directory")
    report: bool = Field(False, description="write a report of every run")
    jobs: int | None = Field(None, ge=1, description="runs at a time")
    timeout_s: float | None = Field(None, gt=0, description="a run that takes longer is stopped")
    memory_mb: int | None = Field(None, ge=1, le=10**9, description="memory limit of a run")
    tries: int = Field(3, ge=1, description="maximum number of attempts for a run whose process was killed")


def read_manifest(path: Path) -> tuple[Manifest, Layer]:
    """Return a manifest, and the layer with the line of each of its values; raises ConfigError with the line."""
    layer = read_yaml(path, "the YAML file of a manifest")
    return validated(Manifest, layer, str(path)), layer


def origins_of(manifest: Manifest, layer: Layer) -> Origins:
    """Return where the gates, accepted codes and tolerances are in a manifest; of several places the first one."""
    found: dict[tuple[str, str | int], str] = {}
    for name in manifest.tolerances:
        found["tolerances", full_name(name)] = origin(layer, ("tolerances", name))
    for key, part in (((), manifest), *((("logs", str(number)), log) for number, log in enumerate(manifest.logs))):
        for name in ("gates", "accept"):
            for number, value in enumerate(getattr(part, name)):
                given = value.strip() if isinstance(value, str) else value
                found.setdefault((name, given), origin(layer, (*key, name, str(number))))
    return found


@contextmanager
def located(where: str | None) -> Iterator[None]:
    """Turn a UsageError into a ConfigError that begins with file and line, if they are known."""
    try:
        yield
    except UsageError as error:
        if where is None:
            raise
        raise ConfigError(f"{where}: {error}") from error
