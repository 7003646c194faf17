"""Configuration from files, presets, ``--set`` and options; every error names its line and the nearest known key.

Later layers win: defaults, the method's preset in ``configs/``, the file, ``--set``, options of their own.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import fields as fields_of
from dataclasses import is_dataclass
from functools import cache
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_type_hints

from mavnav.config.layers import Layer
from mavnav.config.models import Config
from mavnav.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

    from mavnav.config.layers import Key

Model = TypeVar("Model")

HELP = {"Config": "mavnav config show", "Scenario": "mavnav simulate --schema", "Manifest": "mavnav batch --schema"}
"""Model -> the command that shows its keys."""

OPTIONS = {"planner.technique": "--planner"}
"""Options that are not named like the last part of their key."""


_NUMBER, _SECTION = "should be a number", "should be a section of 'key: value' lines"
_PROBLEMS = {
    "float_parsing": _NUMBER,
    "float_type": _NUMBER,
    "finite_number": "should be a finite number",
    "int_parsing": "should be a whole number",
    "int_type": "should be a whole number",
    "int_from_float": "should be a whole number",
    "bool_parsing": "should be true or false",
    "bool_type": "should be true or false",
    "string_type": "should be a word",
    "model_type": _SECTION,
    "model_attributes_type": _SECTION,
    "dataclass_type": _SECTION,
    "dict_type": _SECTION,
    "tuple_type": "should be a list",
    "list_type": "should be a list",
    "too_long": "should have at most {max_length} items, not {actual_length}",
    "too_short": "should have at least {min_length} items, not {actual_length}",
    "literal_error": "should be {expected}",
    "enum": "should be {expected}",
}
"""Type of a rejected value -> what it should be."""

_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
"""Types of an unknown key, of a model and of a dataclass."""


@cache
def presets_folder() -> Path:
    """Return ``configs/``: in the installed package, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def presets() -> list[str]:
    """Return the names of the presets: what has no walls in ``configs/``."""
    return _shipped(scenarios=False)


def scenarios() -> list[str]:
    """Return the names of the scenarios: what has walls in ``configs/``."""
    return _shipped(scenarios=True)


@cache
def _shipped(*, scenarios: bool) -> list[str]:
    texts = {path.stem: path.read_text("utf-8") for path in presets_folder().glob("*.yaml")}
    return [name for name, text in sorted(texts.items()) if bool(re.search(r"(?m)^walls:", text)) == scenarios]


def file_layer(file: str | Path | None) -> Layer:
    """Read a file, or the preset of that name where no such file lies in the current folder."""
    if file is None:
        return Layer()
    path = Path(file)
    if not path.exists() and str(file) in presets():
        path = presets_folder() / f"{file}.yaml"
    if not path.exists():
        raise ConfigError(f"{path}: no such file; name a YAML file, or a preset: {', '.join(presets())}")
    from mavnav.config.yaml_layers import read_yaml  # noqa: PLC0415  yaml takes 10 ms to load

    return read_yaml(path)


def load_config(
    file: str | Path | None = None,
    sets: Iterable[str] = (),
    overrides: Mapping[str, object] | None = None,
    values: Layer | None = None,
) -> Config:
    """Load the effective configuration.

    Parameters
    ----------
    file
        Path of a YAML file, or the name of a preset.
    sets
        ``key=value`` with dotted keys, values read as YAML.
    overrides
        Values of command line options by the name of the field; what is None was not given.
    values
        Values of a manifest for this run; above the file, below the rest.

    Raises
    ------
    ConfigError
        One line: file and line, dotted key, what is wrong, the nearest known name.
    """
    top = overlaid((values or Layer()).over(file_layer(file)), sets, overrides or {})
    if top.values.items() <= {("method",): Config().method}.items():
        return Config()  # as the preset of its method says
    return validated(Config, top.over(method_layer(top.values.get(("method",)))))


def overlaid(layer: Layer, sets: Iterable[str], overrides: Mapping[str, object]) -> Layer:
    """Lay ``--set`` and then the command line's own options over a layer."""
    for above in (*map(_set_layer, sets), _option_layer(overrides)):
        layer = above.over(layer)
    return layer


def method_layer(method: object) -> Layer:
    """Return the preset of a method (None: of the default one), nothing where there is no such preset."""
    name = method or Config().method
    return file_layer(presets_folder() / f"{name}.yaml") if name in presets() else Layer()


def _set_layer(assignment: str) -> Layer:
    dotted, equals, text = assignment.partition("=")
    if not equals or not dotted.strip():
        raise ConfigError(f"--set {assignment!r} is not key=value; write for example --set robust.cell_mm=25")
    from mavnav.config.yaml_layers import layer_of  # noqa: PLC0415  yaml takes 10 ms to load

    key = tuple(dotted.strip().split("."))
    value = layer_of(f"value: {text}", f"--set {assignment}").values
    if list(value) != [("value",)]:
        raise ConfigError(f"--set {assignment!r} sets more than one value; write for example --set robust.cell_mm=25")
    return Layer({key: value["value",]}, {key: f"--set {assignment}"})


def _option_layer(overrides: Mapping[str, object]) -> Layer:
    given = {name: tuple(name.split(".")) for name, value in overrides.items() if value is not None}
    return Layer(
        {key: overrides[name] for name, key in given.items()},
        {key: OPTIONS.get(name, f"--{key[-1].replace('_', '-')}") for name, key in given.items()},
    )


@cache
def _adapter(model: Any) -> TypeAdapter[Any]:  # noqa: ANN401  a class
    from pydantic import TypeAdapter  # noqa: PLC0415  it takes 0.1 s to load

    return TypeAdapter(model)


def schema_of(model: type) -> dict[str, Any]:
    """Return the JSON Schema of what is read into a model."""
    return _adapter(model).json_schema()


def validated(model: type[Model], layer: Layer, name: str = "configuration") -> Model:
    """Build a model of a layer's values; ``name`` is what errors without a line call it."""
    from pydantic import ValidationError  # noqa: PLC0415  it takes 0.1 s to load

    try:
        made: Model = _adapter(model).validate_python(layer.tree())  # type: ignore[arg-type]
    except ValidationError as error:
        details = sorted(error.errors(include_url=False), key=lambda d: d["type"] not in _UNKNOWN)
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise ConfigError(_complaint(model, details[0], layer, name) + more) from error
    except ConfigError as error:
        grid = next((origin for key, origin in layer.origins.items() if key[-1] == "grid"), "grid")
        raise ConfigError(f"{grid}: {error}") from error
    return made


def origin(layer: Layer, key: Key, name: str = "configuration") -> str:
    """Return where a key, or else what is around it, or in it, was written."""
    around = (layer.origins[key[:n]] for n in range(len(key), 0, -1) if key[:n] in layer.origins)
    within = (where for inner, where in layer.origins.items() if inner[: len(key)] == key)
    return next(around, next(within, name))


def _complaint(model: type, details: ErrorDetails, layer: Layer, name: str) -> str:
    key = tuple(str(part) for part in details["loc"])
    where, dotted, known = origin(layer, key, name), ".".join(key), dict(fields(model))
    help_ = HELP[model.__name__]
    named = tuple(part for part in key if not part.isdecimal())
    hint = known.get(named) or f"see '{help_}'"
    if details["type"] in _UNKNOWN:
        advice = _nearest(named or key, list(known)) or f"see '{help_}' for the known keys"
        return f"{where}: unknown key {dotted}; {advice}"
    if details["type"] == "missing":
        return f"{where}: {dotted} is missing; give the {hint}"
    return f"{where}: {dotted} is {_short(details['input'])}, it {_problem(details)}; {hint}"


def _problem(details: ErrorDetails) -> str:
    """Return what a value should be, in plain terms."""
    template = _PROBLEMS.get(details["type"])
    if template is not None:
        return template.format_map(details.get("ctx", {}))
    return details["msg"].removeprefix("Input ").removeprefix("Value error, ")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _nearest(key: Key, keys: list[Key]) -> str:
    """Propose the nearest known key, wherever in the configuration it stands; nothing where none is near."""
    known = [".".join(path) for path in keys]
    by_last_name = {path[-1]: ".".join(path) for path in keys}
    proposal = [by_last_name[key[-1]]] if key[-1] in by_last_name else []
    proposal = proposal or difflib.get_close_matches(".".join(key), known, n=1)
    proposal = proposal or [by_last_name[name] for name in difflib.get_close_matches(key[-1], by_last_name, n=1)]
    return f"did you mean {proposal[0]}?" if proposal else ""


def fields(model: type = Config, above: Key = ()) -> list[tuple[Key, str]]:
    """Return every key of a model with its description, in order; the items of a list share their list's key."""
    found: list[tuple[Key, str]] = []
    for name, annotation, description in _described(model):
        found.append(((*above, name), description))
        for kind in _models(annotation):
            found += fields(kind, (*above, name))
    return found


def _described(model: Any) -> list[tuple[str, object, str]]:  # noqa: ANN401  a dataclass, or pydantic's model
    """Return the name, annotation and description of every field."""
    if is_dataclass(model):
        kinds = get_type_hints(model)
        return [(f.name, kinds[f.name], f.metadata.get("description", "")) for f in fields_of(model)]
    return [(name, info.annotation, info.description or "") for name, info in model.model_fields.items()]


def _models(annotation: object) -> list[type]:
    """Return the models in an annotation such as ``A``, ``A | None`` or ``tuple[A, ...]``."""
    if isinstance(annotation, type) and (is_dataclass(annotation) or hasattr(annotation, "model_fields")):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def to_yaml(config: Config) -> str:
    """Write a configuration as YAML, with a comment from every field's description; ``load_config`` reads it back."""
    descriptions = dict(fields())
    return "".join(_yaml_lines(config.document(), (), descriptions))


def _yaml_lines(document: Mapping[str, Any], above: Key, descriptions: Mapping[Key, str]) -> list[str]:
    lines: list[str] = []
    indent = "  " * len(above)
    for name, value in document.items():
        key = (*above, name)
        comment = f"  # {descriptions[key]}" if descriptions.get(key) else ""
        if isinstance(value, dict):
            lines += [f"{indent}{name}:{comment}\n", *_yaml_lines(value, key, descriptions)]
        else:
            lines.append(f"{indent}{name}: {_scalar(value)}{comment}\n")
    return lines


def _scalar(value: object) -> str:
    if isinstance(value, str) and value and re.fullmatch(r"[A-Za-z/][\w/.-]*|\d+x\d+", value):
        return value
    return dumps(value)
