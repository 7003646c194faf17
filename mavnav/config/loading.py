"""Configuration from files, presets, ``--set`` and options; every error names its line and the nearest known key.

Later layers take precedence: defaults, the method's preset in ``configs/``, the file, ``--set``, command line options.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import fields as fields_of
from dataclasses import is_dataclass
from functools import cache, reduce
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_type_hints

from mavnav.config.layers import Layer
from mavnav.config.models import Config
from mavnav.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

    from mavnav.config.layers import Key

Model = TypeVar("Model")

HELP = {"Config": "mavnav config show", "Scenario": "mavnav simulate --schema", "Manifest": "mavnav batch --schema"}
"""Name of a model -> the command that shows its keys."""

OPTIONS = {"planner.technique": "--planner"}
"""Key -> option, for options that are not named like the last part of their key."""


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
"""Types of the error for an unknown key, in a model and in a dataclass."""


@cache
def presets_folder() -> Path:
    """Return the path of ``configs/``: in the installed package, or next to the package in a checkout."""
    package = Path(__file__).parents[1]
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def presets() -> list[str]:
    """Return the names of the presets: the files without walls in ``configs/``."""
    return _config_names(scenarios=False)


def scenarios() -> list[str]:
    """Return the names of the scenarios: the files with walls in ``configs/``."""
    return _config_names(scenarios=True)


@cache
def _config_names(*, scenarios: bool) -> list[str]:
    texts = {path.stem: path.read_text("utf-8") for path in presets_folder().glob("*.yaml")}
    return [name for name, text in sorted(texts.items()) if bool(re.search(r"(?m)^walls:", text)) == scenarios]


def file_layer(file: str | Path | None) -> Layer:
    """Read a file, or, if no such file exists, the preset of that name."""
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
        Values of command line options by the name of the field; None for an option that was not given.
    values
        Values of a manifest for this run, which override the file and are overridden by the rest.

    Raises
    ------
    ConfigError
        A value is wrong. The message is one line: file and line, dotted key, problem, nearest known name.
    """
    top = overlaid((values or Layer()).over(file_layer(file)), sets, overrides or {})
    if top.values.items() <= {("method",): Config().method}.items():
        return Config()  # equals the preset of the default method
    return validated(Config, top.over(method_layer(top.values.get(("method",)))))


def overlaid(
    layer: Layer, sets: Iterable[str], overrides: Mapping[str, object], short: tuple[Key, str] | None = None
) -> Layer:
    """Merge ``--set`` and then the command line options over a layer.

    ``short`` is a section that has a short form, and the key within it that the short form gives.
    """
    layers = [layer, *map(_set_layer, sets), _option_layer(overrides)]
    if short:
        layers = [each.spelled_out(*short) for each in layers]
    return reduce(lambda below, above: above.over(below), layers)


def method_layer(method: object) -> Layer:
    """Return the preset of a method, None for the default method; an empty layer if there is no such preset."""
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
    """Return the JSON Schema of the input of a model."""
    return _adapter(model).json_schema()


def validated(model: type[Model], layer: Layer, name: str = "configuration") -> Model:
    """Build a model from the values of a layer; ``name`` is its name in errors without a line. Raises ConfigError."""
    from pydantic import ValidationError  # noqa: PLC0415  it takes 0.1 s to load

    try:
        made: Model = _adapter(model).validate_python(layer.tree())  # type: ignore[arg-type]
    except ValidationError as error:
        details = sorted(error.errors(include_url=False), key=lambda d: d["type"] not in _UNKNOWN)
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise ConfigError(_error_message(model, details[0], layer, name) + more) from error
    except ConfigError as error:
        grid = next((origin for key, origin in layer.origins.items() if key[-1] == "grid"), "grid")
        raise ConfigError(f"{grid}: {error}") from error
    for key, value in _taken_for_numbers(layer.tree(), made):
        wrong: Any = {"type": "float_type", "loc": key, "input": value, "msg": ""}
        raise ConfigError(_error_message(model, wrong, layer, name))
    return made


def _taken_for_numbers(given: object, made: object, key: Key = ()) -> Iterator[tuple[Key, object]]:
    """Yield the words and truth values that pydantic has taken for numbers, such as ``1_0`` and ``true``."""
    if isinstance(given, dict):
        for name, value in given.items():
            inner = made.get(name) if isinstance(made, dict) else getattr(made, name, None)
            yield from _taken_for_numbers(value, inner, (*key, name))
    elif isinstance(given, list) and isinstance(made, tuple) and len(given) == len(made):
        for number, (value, inner) in enumerate(zip(given, made, strict=True)):
            yield from _taken_for_numbers(value, inner, (*key, str(number)))
    elif isinstance(given, str | bool) and isinstance(made, int | float) and not isinstance(made, bool):
        yield key, given


def origin(layer: Layer, key: Key, name: str = "configuration") -> str:
    """Return the origin of a key, or else of the section that contains it, or of a key below it; else ``name``."""
    around = (layer.origins[key[:n]] for n in range(len(key), 0, -1) if key[:n] in layer.origins)
    within = (where for inner, where in layer.origins.items() if inner[: len(key)] == key)
    return next(around, next(within, name))


def _error_message(model: type, details: ErrorDetails, layer: Layer, name: str) -> str:
    key = tuple(str(part) for part in details["loc"])
    where, dotted, known = origin(layer, key, name), ".".join(key), dict(fields(model))
    help_ = HELP[model.__name__]
    named = tuple(part for part in key if not part.isdecimal())
    hint = known.get(named) or f"see '{help_}'"
    if details["type"] in _UNKNOWN:
        advice = _nearest(named or key, list(known), key) or f"see '{help_}' for the known keys"
        return f"{where}: unknown key {dotted}; {advice}"
    if details["type"] == "missing":
        return f"{where}: {dotted} is missing; give the {hint}"
    return f"{where}: {dotted} is {_truncated(details['input'])}, it {_problem(details)}; {hint}"


def _problem(details: ErrorDetails) -> str:
    """Return the text of what a value should be."""
    template = _PROBLEMS.get(details["type"])
    if template is not None:
        return template.format_map(details.get("ctx", {}))
    return details["msg"].removeprefix("Input ").removeprefix("Value error, ")


def _truncated(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _nearest(key: Key, keys: list[Key], given: Key) -> str:
    """Return a hint at the nearest known key anywhere in the configuration; empty if none is similar.

    It has the indices of ``given``, which is ``key`` with them.
    """
    known = [".".join(path) for path in keys]
    by_last_name = {path[-1]: ".".join(path) for path in keys}
    proposal = [by_last_name[key[-1]]] if key[-1] in by_last_name else []
    proposal = proposal or difflib.get_close_matches(".".join(key), known, n=1)
    proposal = proposal or [by_last_name[name] for name in difflib.get_close_matches(key[-1], by_last_name, n=1)]
    return f"did you mean {_indexed(proposal[0].split('.'), given)}?" if proposal else ""


def _indexed(parts: list[str], given: Key) -> str:
    """Write a key with the indices that ``given`` has in the part that both share."""
    found, rest = [], list(given)
    for part in parts:
        found.append(part)
        rest = rest[1:] if rest and rest[0] == part else []
        while rest and rest[0].isdecimal():
            found.append(rest.pop(0))
    return ".".join(found)


def fields(model: type = Config, above: Key = ()) -> list[tuple[Key, str]]:
    """Return every key of a model with its description, in order; items of a list have the key of the list."""
    found: list[tuple[Key, str]] = []
    for name, annotation, description in _described(model):
        found.append(((*above, name), description))
        for kind in _models(annotation):
            found += fields(kind, (*above, name))
    return found


def _described(model: Any) -> list[tuple[str, object, str]]:  # noqa: ANN401  a dataclass or a pydantic model
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
    """Return a configuration as YAML with the description of every field as comment; ``load_config`` can read it."""
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
