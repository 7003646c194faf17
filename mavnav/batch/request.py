"""The request of a batch or a comparison: logs, limits, gates and settings, named alike in every batch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, product, zip_longest
from pathlib import Path
from typing import Any, Final, get_args

from msgspec import Struct, field

from mavnav.batch.baseline import Baseline, Tolerance
from mavnav.batch.manifest import Origins
from mavnav.batch.remote import Pin
from mavnav.config.layers import Key, Layer, leaves
from mavnav.config.loading import load_config
from mavnav.config.models import Config, MethodName
from mavnav.config.options import ReplayOptions
from mavnav.errors import ConfigError, UsageError
from mavnav.metrics.gates import Gate
from mavnav.outputs.documents.provenance import Typed
from mavnav.pipelines.trajectory_source import Program

METHODS: Final = frozenset(get_args(MethodName))
"""Methods, and the sections of their values."""

SEARCH: Final = {("grid",), ("azimuth",)}
"""Keys by which the runs of a comparison are named anyhow, besides the method."""


class Setting(Struct, frozen=True):
    """A configuration and its name; ``differs`` is in what it differs from others, besides method and search grid.

    A ``program`` finds the poses in place of mavnav.
    """

    name: str
    config: Config
    differs: str = ""
    program: Program | None = None


def crossed_settings(
    file: str | None,
    sets: Sequence[str],
    methods: Sequence[str],
    grids: Sequence[str],
    azimuths: Sequence[int],
    options: Mapping[str, object],
) -> list[Setting]:
    """Return a setting for every method, grid, and value of ``sets``; without methods or grids, those configured.

    ``azimuths`` (yaw samples) are none, one for all grids, or one per grid; raises UsageError for another number, and
    ConfigError for invalid values.
    """
    searches = zip_longest(grids, yaw_samples(grids, azimuths))
    named = ({"method": m, "grid": g, "azimuth": a} for m, (g, a) in product(methods or (None,), searches))
    given = ({name: value for name, value in search.items() if value is not None} for search in named)
    each = swept(sets)
    return named_settings(load_config(file, chosen, {**options, **search}) for search in given for chosen in each)


def swept(sets: Sequence[str]) -> list[list[str]]:
    """Return all combinations of settings, of which any may have several values: ``KEY=A,B``, or a text for each."""
    values: dict[str, list[str]] = {}
    for text in sets:
        key, equals, value = text.partition("=")
        several = value.strip().removeprefix("[").removesuffix("]").split(",") if equals and "{" not in value else []
        values.setdefault(key.strip(), []).extend([f"{key}={each.strip()}" for each in several] or [text])
    return [list(chosen) for chosen in product(*(dict.fromkeys(each) for each in values.values()))]


def yaw_samples(grids: Sequence[object], azimuths: Sequence[int]) -> list[int | None]:
    """Return the yaw samples of each grid, or a single value if there is no grid; None if they are not given.

    ``azimuths`` are none, one for all grids, or one per grid; raises UsageError for another number.
    """
    if len(azimuths) not in {0, 1, len(grids)}:
        given = f"{len(azimuths)} values of --azimuth for {len(grids)} grids"
        raise UsageError(f"{given}; give none, one for all, or one for each")
    return list(azimuths) if len(azimuths) > 1 else [azimuths[0] if azimuths else None] * max(len(grids), 1)


def named_settings(configs: Iterable[Config]) -> list[Setting]:
    """Return configurations with their names and what differs, without duplicates.

    Raises ConfigError where they differ in what their method does not use.
    """
    several = list(configs)
    changed = differences(several)
    for config, differs in zip(several, changed, strict=True):
        for key in config.without_effect(differs):
            if (method := key.partition(".")[0]) in METHODS:
                advice = f"leave it out, or choose --method {method}"
                raise ConfigError(f"{key} has no effect with the method {config.method}; {advice}")
    texts = (" ".join(f"{key}={format_value(value)}" for key, value in differs.items()) for differs in changed)
    return unique(Setting(setting_name(config), config, text) for config, text in zip(several, texts, strict=True))


def differences(configs: Sequence[Config]) -> list[dict[str, object]]:
    """Return for each configuration its values that differ between those of its method, besides the search grid.

    They are by dotted key.
    """
    values = [leaves(config.document()) for config in configs]
    changed: dict[str, set[Key]] = {}
    for one, other in combinations(values, 2):
        if one["method",] == other["method",]:
            changed.setdefault(str(one["method",]), set()).update(k for k in one.keys() - SEARCH if one[k] != other[k])
    return [{".".join(key): each[key] for key in sorted(changed.get(str(each["method",]), ()))} for each in values]


def listed_settings(
    runs: Sequence[Mapping[str, Any]], layer: Layer, base: Path, sets: Sequence[str], options: Mapping[str, object]
) -> list[Setting]:
    """Return the settings of a manifest's ``runs``; ``sets`` and ``options`` of the command line override them.

    A run has the keys of a configuration, and optionally ``name`` and ``config``, a preset or a file relative to
    ``base``. Raises ConfigError with the manifest's line.
    """
    settings = []
    for number, run in enumerate(runs):
        key = ("runs", str(number))
        own = {name: run.get(name) for name in ("name", "config")}
        for name, value in own.items():
            if value is not None and not (isinstance(value, str) and value):
                raise ConfigError(f"{layer.origins[*key, name]}: {name} is {value!r}; give it a word, or leave it out")
        file = own["config"]
        below = str(base / file) if file and (base / file).exists() else file
        values = leaves({name: value for name, value in run.items() if name not in own})
        origins = {path: layer.origins.get(key + path, f"runs.{number}") for path in values}
        config = load_config(below, sets, options, Layer(values, origins))
        settings.append(Setting(own["name"] or setting_name(config), config))
    return unique(settings)


def format_value(value: object) -> str:
    """Format a value as on the command line."""
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


def unique(settings: Iterable[Setting]) -> list[Setting]:
    """Return the settings without duplicates; raises ConfigError if two of them have the same name."""
    by_name: dict[str, Setting] = {}
    for setting in settings:
        kept = by_name.setdefault(setting.name, setting)
        if (kept.config, kept.program) != (setting.config, setting.program):
            raise ConfigError(f"two runs are named {setting.name!r}; give each a name of its own")
    return list(by_name.values())


def setting_name(config: Config) -> str:
    """Return the name of a configuration, such as ``robust 20/10x10``: yaw samples, grid, and non-default values."""
    default = load_config(None, (), {name: getattr(config, name) for name in ("method", "azimuth")})
    mine, theirs = leaves(config.document()), leaves(default.document())
    others = [
        f"{'.'.join(key)}={format_value(value)}"
        for key, value in mine.items()
        if value != theirs[key] and key[-1] != "grid" and key[0] not in METHODS - {config.method}
    ]
    return " ".join([config.method, f"{config.azimuth}/{config.grid}", *others])


class RunLimits(Struct, frozen=True):
    """Number of runs at a time, their time and memory limits, and the number of attempts if a run's process dies.

    ``scheduler`` is a Dask cluster to run on, None for this machine. Other programs end after ``program_s``.
    """

    workers: int = 1
    timeout_s: float | None = None
    memory_mb: int | None = None
    tries: int = 3
    scheduler: str | None = None
    program_s: float = 3600.0


class Rules(Struct, frozen=True):
    """Gates of every run, in addition to those of its log.

    ``accept`` are exit codes and verdicts that count as done; ``watched`` are the tolerances of the metrics compared
    with ``baseline``. With ``baseline_gate``, nothing may be worse than in the baseline; with ``identical_gate``, runs
    that are repeated must have the same bytes.
    """

    gates: tuple[Gate, ...] = ()
    accept: frozenset[int | str] = frozenset()
    baseline: Baseline | None = None
    watched: tuple[Tolerance, ...] = ()
    baseline_gate: bool = False
    identical_gate: bool = False


class BatchPart(Struct, frozen=True):
    """One of several equal parts of a batch, counted from 1, for machines that share a directory."""

    number: int
    of: int

    def __post_init__(self) -> None:
        """Raise UsageError unless ``number`` is from 1 to ``of``."""
        if not 1 <= self.number <= self.of:
            example = f"parts count from 1, for example 1/{max(self.of, 2)}"
            raise UsageError(f"part {self.number}/{self.of} is none; {example}")

    @classmethod
    def parse(cls, text: str) -> BatchPart:
        """Read ``1/4``; raises UsageError."""
        number, slash, of = text.partition("/")
        if not (slash and number.isdecimal() and of.isdecimal()):
            raise UsageError(f"--part {text!r} is not I/N; write for example --part 1/4")
        return cls(int(number), int(of))


class BatchLogs(Struct, frozen=True):
    """Logs with the same options, and gates and what is accepted of them, in addition to those of the batch.

    A single log at an address may have a ``name``, and a ``pin``: it is fetched once, and checked. ``licence`` is its
    own, ``peers`` are the numbers of run.json that other programs reached on it.
    """

    log: tuple[str, ...]
    options: ReplayOptions[Path] = field(default_factory=ReplayOptions[Path])
    gates: tuple[str, ...] = ()
    accept: tuple[int | str, ...] = ()
    name: str = ""
    pin: Pin | None = None
    licence: str = ""
    peers: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


class BatchRequest(Struct, frozen=True):
    """Logs, settings, output directory, limits and gates of a batch or a comparison.

    Relative logs of ``entries`` start at ``base``; with ``patterns`` they may be patterns and folders, else they are
    single logs. ``force`` repeats finished runs; ``report`` writes a report of every run. The metrics are written to
    the file ``new_baseline`` for later batches. ``typed`` is the command line. ``files`` are the files that are written
    outside of ``directory`` by their options, ``inputs`` those that are read besides logs and references.
    ``origins`` are the lines of a manifest. Pinned logs are looked for in the folder ``copies`` first. With ``only``,
    the entries are some of a manifest. Every run is made ``repeat`` times.
    """

    entries: tuple[BatchLogs, ...]
    settings: tuple[Setting, ...]
    base: Path
    directory: Path
    limits: RunLimits = RunLimits()
    rules: Rules = Rules()
    part: BatchPart | None = None
    force: bool = False
    report: bool = False
    new_baseline: Path | None = None
    patterns: bool = True
    typed: Typed = field(default_factory=Typed)
    files: Mapping[str, Path] = field(default_factory=dict)
    inputs: tuple[Path, ...] = ()
    origins: Origins = field(default_factory=dict)
    copies: Path | None = None
    only: tuple[str, ...] = ()
    repeat: int = 1
