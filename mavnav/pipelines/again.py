"""Repeating a run: from its run.json back to what it was made with."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from msgspec import Struct, ValidationError, convert

from mavnav.config.layers import Layer, by_dotted_key
from mavnav.config.loading import key_now, load_config, read_model, to_scalar
from mavnav.config.models import Config
from mavnav.config.named_files import read_json, what_is_wrong
from mavnav.config.options import ReplayOptions, restore_options, words_of
from mavnav.errors import ConfigError, UsageError
from mavnav.logs import content_sha256
from mavnav.outputs.directory import RUN_FILE
from mavnav.outputs.documents.addresses import is_address
from mavnav.outputs.documents.provenance import Typed
from mavnav.outputs.documents.run_json import Provenance
from mavnav.outputs.writers import REPORT_FILE
from mavnav.version import __version__, installed_version


class EarlierRun(Struct, frozen=True):
    """A run to be repeated: its directory, which is only read, and its run.json."""

    directory: Path
    document: dict[str, Any]

    def path(self, text: str) -> Path:
        """Return a path that counted from the working directory of the run."""
        folder = self.document["provenance"]["folder"]
        return Path(text) if folder in {None, str(Path.cwd())} else Path(folder) / text

    def differences(self) -> list[str]:
        """Return what may keep the repetition from being the same, a line each."""
        made, now = _versions(self.document), {"mavnav": __version__, "Python": platform.python_version()}
        now |= {name: installed_version(name) for name in made if name not in now}
        changed = [f"{name} {then} then, {now[name]} now" for name, then in made.items() if now[name] != then]
        lines = [f"other versions than in {self.directory}, results may differ: {', '.join(changed)}"] * bool(changed)
        if self.document["partial"]:
            lines.append(f"{self.directory} was stopped before the log ended; this run goes on to its end")
        return lines

    def outcome(self, document: dict[str, Any]) -> str:
        """Return in a line whether the files of a repetition, by its run.json, are the same bytes."""
        made, now = self.document["outputs"], document["outputs"]
        both, file = made.keys() & now.keys(), self.directory / RUN_FILE
        changed = sorted(name for name in both if made[name] != now[name])
        if changed:
            return f"{len(changed)} of {len(both)} files differ from those that {file} lists: {', '.join(changed)}"
        return f"all {len(both)} files are the same as {file} lists"


def _versions(document: dict[str, Any]) -> dict[str, str]:
    return {"mavnav": document["mavnav_version"], "Python": document["python"], **document["libraries"]}


def earlier_run(directory: Path, *, simulated: bool) -> EarlierRun:
    """Read a run directory; raises UsageError for what is none, or of the other command."""
    try:
        document = read_json(directory / RUN_FILE)
        kind = _check_document(document)
    except OSError as error:
        raise UsageError(f"{directory} holds no run ({RUN_FILE}: {error.strerror}); name a run directory") from error
    except (ValueError, ValidationError, LookupError, TypeError, AttributeError) as error:
        reason = what_is_wrong(error, "does not record how the run was made; an earlier version may have written it")
        advice = "repeat it by its configuration, with --config"
        raise UsageError(f"{directory / RUN_FILE} {reason}; {advice}") from error
    if edits := document["provenance"].get("edits"):
        raise UsageError(f"{directory} is of another command; write {edits[-1]} -o NEW")
    if "external" in document:
        raise UsageError(f"{directory} is of another command; write {document['provenance']['again']}")
    if (kind == "scenario") != simulated:
        other = "replay" if simulated else "simulate"
        raise UsageError(f"{directory} is of another command; write mavnav {other} --again {directory}")
    return EarlierRun(directory, document)


def _check_document(document: dict[str, Any]) -> str:
    """Return the format of the log.

    Raises ValueError, ValidationError, LookupError or TypeError where something that is needed here is missing.
    Configuration and scenario are checked where they are used.
    """
    needed = (document["input"], document["config"], document["outputs"], _versions(document))
    if not all(isinstance(section, dict) for section in needed):
        raise TypeError
    convert(document["provenance"], Provenance)
    values = [document["input"][name] for name in ("format", "path", "sha256", "size_bytes")]
    kind, *_ = convert((*values, document["partial"]), tuple[str, str, str, int, bool])
    return kind


def replay_again(run: EarlierRun, log: Path | None, more: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Return the fields of the request that repeats a replay; ``log`` and ``more`` are its files, if it has moved.

    Raises UsageError where the log is gone or has another content, ConfigError where this version has other keys.
    """
    more = more if log else tuple(map(run.path, run.document["input"].get("parts", ())))
    return {
        "options": restore_options(run.document["provenance"]["options"], run.path),
        "log": _same_log(run, log, more),
        "more": more,
        "config": load_config(values=_layer(run.document["config"], run.directory / RUN_FILE)),
        "report": (run.directory / REPORT_FILE).is_file(),
    }


def typed_again(run: EarlierRun, words: Sequence[str]) -> Typed:
    """Return what was typed: the words of now, with configuration and values of the run that is repeated."""
    options = run.document["provenance"]["options"] or {}
    return Typed(tuple(words), options.get("config"), tuple(options.get("sets", ())))


def simulation_again(run: EarlierRun) -> dict[str, Any]:
    """Return the fields of the request that repeats a mission: its effective scenario, whatever became of the file."""
    from mavnav.simulation.world.scenario import Scenario  # noqa: PLC0415  models take time to build

    file, source = run.directory / RUN_FILE, run.document["input"]
    return {
        "scenario": read_model(Scenario, _layer(run.document["scenario"], file), str(file)),
        "path": run.path(source["path"]),
        "content": (source["sha256"], source["size_bytes"]),
        "report": (run.directory / REPORT_FILE).is_file(),
    }


def run_layer(directory: str | Path) -> Layer:
    """Return the configuration of a run or merge, for a run that continues it; raises UsageError for what is none."""
    from mavnav.pipelines.sessions import run_to_continue  # noqa: PLC0415  few runs need it

    run = run_to_continue(Path(directory))
    return _layer(run.document["config"], run.directory)


def _layer(section: dict[str, Any], path: Path) -> Layer:
    """Return a section of the document in a file, a configuration or scenario, with the keys of now."""
    from mavnav.config.yaml_layers import layer_of  # noqa: PLC0415  yaml takes 10 ms to load

    return layer_of(json.dumps(section), str(path)).rename_keys(key_now)


def _same_log(run: EarlierRun, log: Path | None, more: tuple[Path, ...]) -> Path:
    """Return the log of a run; raises UsageError unless it is there with the same content."""
    was, sha256 = (run.document["input"][key] for key in ("path", "sha256"))
    again = f"write mavnav replay LOG --again {run.directory}"
    if log is None and is_address(was):
        raise UsageError(f"the log was fetched from {was}; fetch it and {again}")
    path = log or run.path(was)
    if not path.exists():
        raise UsageError(f"{path}: the log of the run is not there; {again} with its place now")
    if (digest := content_sha256(path, more)) != sha256:
        changed = f"{path} is not the log of {run.directory}, its SHA-256 was {sha256} and is {digest}"
        raise UsageError(f"{changed}; name the right one, or leave out --again")
    return path


def replay_words(logs: list[str], options: ReplayOptions[Path], config: Config) -> list[str]:
    """Return the words of a command line that repeats a replay from anywhere, without its configuration file.

    It lists all values that differ from the method's defaults, or from those of the run that is continued. A log at an
    address is a batch of one.
    """
    command = "batch" if is_address(logs[0]) else "replay"
    changed = changed_values(config, _base(options.get("continue_from"), config))
    sets = [f"--set={key}={to_scalar(value)}" for key, value in changed.items()]
    return ["mavnav", command, *logs, *words_of(options), *sets]


def _base(continued: Path | None, config: Config) -> Config:
    """Return the configuration that ``--set`` changes: the defaults of the method, or that of the continued run."""
    if continued:
        with suppress(ConfigError):  # of another version, whose keys this one does not have
            return load_config(values=run_layer(continued))
    return load_config(overrides={"method": config.method})


def changed_values(config: Config, base: Config) -> dict[str, Any]:
    """Return the method, and the values of a configuration by dotted keys that differ from those of another one."""
    default, own = by_dotted_key(base.document()), by_dotted_key(config.document())
    return {key: value for key, value in own.items() if key == "method" or value != default[key]}
