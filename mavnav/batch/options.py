"""The request of a batch from its command line and its manifest; the command line takes precedence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from msgspec import Struct, field
from msgspec.structs import replace

from mavnav.batch import request
from mavnav.batch.baseline import Tolerance, parse_tolerance, read_baseline, tolerances
from mavnav.batch.cases import BASELINE_GATE
from mavnav.batch.document import BATCH_FILE, IDENTICAL_GATE
from mavnav.batch.manifest import GATE_EXAMPLE, LogEntry, Manifest, Origins, errors_at, origins_of, read_manifest
from mavnav.batch.remote import Pin
from mavnav.config.layers import Layer
from mavnav.config.options import ReplayOptions, given_options, restore_options, settings_of
from mavnav.errors import UsageError
from mavnav.jobs.dask import LOCAL
from mavnav.jobs.pool import usable_cores
from mavnav.metrics.gates import Gate, full_name, parse_gate, read_accept
from mavnav.outputs.documents.addresses import is_address, public_address
from mavnav.outputs.documents.provenance import Typed
from mavnav.pipelines.trajectory_source import read_program

MANIFEST_SUFFIXES = (".yaml", ".yml")
SETS = Path(__file__).parent / "sets"
"""Folder of the manifests that are part of the package, known by their names."""


class BatchOptions(Struct, frozen=True):
    """The command line; an option that was not given is None or empty.

    ``words`` is the whole command line as typed. ``sources`` are a manifest and logs, ``options`` those of all
    replays. ``files`` are additional files to write by their options. Each of the ``programs`` runs on every log.
    """

    words: Sequence[str] = ()
    sources: Sequence[str] = ()
    methods: Sequence[str] = ()
    grids: Sequence[str] = ()
    azimuths: Sequence[int] = ()
    config: str | None = None
    sets: Sequence[str] = ()
    options: ReplayOptions[Path] = field(default_factory=ReplayOptions[Path])
    gates: Sequence[str] = ()
    accept: Sequence[int | str] = ()
    baseline: Path | None = None
    tolerances: Sequence[str] = ()
    directory: Path | None = None
    jobs: int | None = None
    timeout_s: float | None = None
    memory_mb: int | None = None
    tries: int | None = None
    scheduler: str | None = None
    part: str | None = None
    force: bool = False
    report: bool = False
    update_baseline: bool = False
    files: Mapping[str, Path] = field(default_factory=dict)
    copies: Path | None = None
    only: Sequence[str] = ()
    repeat: int | None = None
    programs: Sequence[str] = ()
    program_s: float = 3600.0


def request_of(options: BatchOptions) -> request.BatchRequest:
    """Read the manifest, if one is given, and return the request.

    Raises ConfigError for an invalid manifest, and UsageError for other invalid input.
    """
    path = _manifest_path(options.sources)
    manifest, layer = read_manifest(path) if path else (Manifest(), Layer())
    base = path.parent if path else Path()
    baseline = options.baseline or (base / manifest.baseline if manifest.baseline else None)
    new_baseline = baseline if options.update_baseline else None
    origins, usual = origins_of(manifest, layer), Path("runs") / (f"batch-{path.stem}" if path else "batch")
    return request.BatchRequest(
        entries=_entries(options, manifest, base),
        settings=tuple(_settings(options, manifest, layer, base)),
        base=base,
        directory=options.directory or (base / manifest.output if manifest.output else usual),
        limits=_limits(options, manifest),
        rules=_rules(options, manifest, origins, baseline),
        part=None if options.part is None else request.BatchPart.parse(options.part),
        force=options.force,
        report=options.report or manifest.report,
        new_baseline=new_baseline,
        typed=Typed(tuple(options.words), options.config, tuple(options.sets)),
        files=dict(options.files) | ({"--baseline": new_baseline} if new_baseline else {}),
        inputs=tuple(_inputs(options, manifest, path, None if new_baseline else baseline)),
        origins=origins,
        copies=options.copies,
        only=tuple(options.only),
        repeat=options.repeat or manifest.repeat,
    )


def _inputs(options: BatchOptions, manifest: Manifest, path: Path | None, baseline: Path | None) -> Iterator[Path]:
    """Yield the files that are read besides logs and their references."""
    configs = [run["config"] for run in manifest.runs if isinstance(run.get("config"), str)]
    yield from map(Path, filter(None, [options.config]))
    if path:
        yield from (path, *(path.parent / config for config in configs))
    if baseline:
        yield baseline / BATCH_FILE if baseline.is_dir() else baseline


def _manifest_path(sources: Sequence[str]) -> Path | None:
    manifests = [source for source in sources if _is_manifest(source)]
    if len(manifests) > 1:
        raise UsageError(f"{len(manifests)} manifests; name one, and logs besides")
    own = SETS / f"{manifests[0]}.yaml" if manifests else None
    return own if own is None or own.is_file() else Path(manifests[0])


def _is_manifest(source: str) -> bool:
    """Return whether a source is a manifest: a YAML file, or the name of one of the package, unless it is a path."""
    own = source.isidentifier() and (SETS / f"{source}.yaml").is_file()
    return source.endswith(MANIFEST_SUFFIXES) or (own and not Path(source).exists())


def _entries(options: BatchOptions, manifest: Manifest, base: Path) -> tuple[request.BatchLogs, ...]:
    """Return the entries of the manifest and of the command line, whose paths start at the current folder."""
    names = [name for entry in manifest.logs for name in _names(entry)]
    if unknown := [name for name in options.only if name not in names]:
        known = ", ".join(names) or "none"
        raise UsageError(f"--only {unknown[0]}: no log of the manifest has this name; known are {known}")
    logs = [source for source in options.sources if not _is_manifest(source)]
    absolute = [log if is_address(log) or not base.parts else str(Path(log).absolute()) for log in logs]
    chosen = [each for each in manifest.logs if not options.only or not {*options.only}.isdisjoint(_names(each))]
    entries = [_entry(entry, base) for entry in chosen]
    entries += [request.BatchLogs(tuple(absolute))] if absolute else []
    return tuple(replace(entry, options=given_options({**entry.options, **options.options})) for entry in entries)


def _names(entry: LogEntry) -> tuple[str, ...]:
    """Return what an entry is called: its name, or else its paths, patterns and addresses."""
    return (entry.name,) if entry.name else tuple(map(public_address, entry.log))


def _entry(entry: LogEntry, base: Path) -> request.BatchLogs:
    options = restore_options(entry.values, lambda text: base / text)
    pin = Pin(entry.sha256, entry.size_bytes) if entry.sha256 and entry.size_bytes else None
    return request.BatchLogs(entry.log, options, entry.gates, entry.accept, entry.name, pin, entry.licence, entry.peers)


def _settings(options: BatchOptions, manifest: Manifest, layer: Layer, base: Path) -> list[request.Setting]:
    """Return the settings of mavnav, then the programs; their maps are drawn with the first of its configurations."""
    overrides = settings_of(options.options)
    if manifest.runs and not (options.methods or options.grids or options.azimuths or options.config):
        own = request.listed_settings(manifest.runs, layer, base, options.sets, overrides)
    else:
        own = request.crossed_settings(
            options.config, options.sets, options.methods, options.grids, options.azimuths, overrides
        )
    programs = [read_program(text).with_absolute_paths() for text in options.programs]
    return request.unique([*own, *(request.Setting(each.name, own[0].config, program=each) for each in programs)])


def _limits(options: BatchOptions, manifest: Manifest) -> request.RunLimits:
    if options.memory_mb and options.scheduler not in {None, LOCAL}:
        raise UsageError("--memory-mb is not for workers that run already; start them with dask worker --memory-limit")
    return request.RunLimits(
        workers=options.jobs or manifest.jobs or usable_cores(),
        timeout_s=options.timeout_s or manifest.timeout_s,
        memory_mb=options.memory_mb or manifest.memory_mb,
        tries=options.tries or manifest.tries,
        scheduler=options.scheduler,
        program_s=options.program_s,
    )


def _rules(options: BatchOptions, manifest: Manifest, origins: Origins, path: Path | None) -> request.Rules:
    texts = [*manifest.gates, *options.gates]
    gated = BASELINE_GATE in texts
    for entry in manifest.logs:  # before any log is read
        list(_gates(entry.gates, origins))
        list(_accept(entry.accept, origins))
    needed = gated or options.update_baseline or any(BASELINE_GATE in entry.gates for entry in manifest.logs)
    if path is None and needed:
        raise UsageError("no baseline; name one with --baseline, an earlier batch or a file")
    if IDENTICAL_GATE in texts and (options.repeat or manifest.repeat) < 2:
        raise UsageError("gate identical compares repeated runs; add --repeat 2")
    if options.update_baseline and path and path.is_dir():
        raise UsageError(f"{path} is a directory; name a file for --update-baseline to write")
    if options.update_baseline and path and path.name == BATCH_FILE:
        raise UsageError(f"{path} would be lost; name another file for --update-baseline to write")
    if options.update_baseline and (options.part or options.only):
        raise UsageError("--update-baseline is for all runs of a batch, --part and --only for some; give one of them")
    fresh = options.update_baseline and path is not None and not path.exists()
    return request.Rules(
        gates=tuple(_gates([text for text in texts if text != IDENTICAL_GATE], origins)),
        accept=frozenset(_accept([*manifest.accept, *options.accept], origins)),
        baseline=None if path is None or fresh else read_baseline(path),
        watched=tolerances([*_parse(manifest.tolerances, origins), *(_tolerance(text) for text in options.tolerances)]),
        baseline_gate=gated and not options.update_baseline,
        identical_gate=IDENTICAL_GATE in texts,
    )


def _gates(texts: Sequence[str], origins: Origins) -> Iterator[Gate]:
    for text in texts:
        where = origins.get(("gates", text.strip()))
        with errors_at(where):
            if text != BASELINE_GATE:
                yield parse_gate(text) if where is None else parse_gate(text, "gate", GATE_EXAMPLE)


def _accept(given: Sequence[int | str], origins: Origins) -> Iterator[int | str]:
    for each in given:
        where = origins.get(("accept", each))
        with errors_at(where):
            yield read_accept(each, "--accept" if where is None else "accept:")


def _parse(named: Mapping[str, float | str], origins: Origins) -> Iterator[Tolerance]:
    for name, text in named.items():
        with errors_at(origins[("tolerances", full_name(name))]):
            tolerance = parse_tolerance(name, str(text))
        yield tolerance


def _tolerance(text: str) -> Tolerance:
    name, equals, size = text.partition("=")
    if not equals or not name.strip():
        raise UsageError(f"--tolerance {text!r} is not NAME=X; write for example --tolerance timing.cpu_s=50%")
    return parse_tolerance(name.strip(), size)
