"""Configuration from files, presets, ``--set`` and options; every error names its line and the nearest known key.

Later layers take precedence: defaults, the method's preset in ``configs/``, the file, ``--set``, command line options.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, reduce
from inspect import cleandoc
from itertools import combinations
from json import dumps
from pathlib import Path
from typing import Any, TypeVar, get_args

from msgspec import Meta, Struct, ValidationError, convert
from msgspec.json import schema
from msgspec.structs import fields as fields_of

from mavnav.config.layers import Key, Layer
from mavnav.config.models import Config, MethodName, PaperExpert, RobustExpert
from mavnav.errors import ConfigError, brief, missing
from mavnav.units import MM

Overrides = Mapping[str, object] | None
"""Values of command line options by the name of the field; None for an option that was not given."""

Model = TypeVar("Model", bound=Struct)
Part = TypeVar("Part")

HELP = {"Config": "mavnav config show", "Scenario": "mavnav simulate --schema", "Manifest": "mavnav batch --schema"}
"""Name of a model -> the command that shows its keys."""

RESOLUTION = "resolution_m"
"""Short for the cell size of whatever method is used, in m."""

OPTIONS = {"technique": "--planner", RESOLUTION: "--resolution"}
"""Last part of a key -> its option, for options that are not named like it."""

_KINDS = {
    "float": "a number",
    "int": "a whole number",
    "bool": "true or false",
    "str": "a word",
    "object": "a section of 'key: value' lines",
    "array": "a list",
}
"""Type in an error of msgspec -> what it is in a file."""

_BOUNDS = {">=": "greater than or equal to", "<=": "less than or equal to", ">": "greater than", "<": "less than"}


@cache
def package_folder(folder: str) -> Path:
    """Return the path of ``configs`` or ``docs``: in the installed package, or next to the package in a checkout."""
    package = Path(__file__).parents[1]
    installed = package / folder
    return installed if installed.is_dir() else package.parent / folder


@cache
def scenarios() -> list[str]:
    """Return the names of the scenarios: the files with walls in ``configs/``."""
    texts = {path.stem: path.read_text("utf-8") for path in package_folder("configs").glob("*.yaml")}
    return sorted(name for name, text in texts.items() if re.search(r"(?m)^walls:", text))


@cache
def presets() -> list[str]:
    """Return the names of the presets: the files without walls in ``configs/``."""
    return sorted({path.stem for path in package_folder("configs").glob("*.yaml")} - {*scenarios()})


def file_layer(file: str | Path | None) -> Layer:
    """Read a file, or, if no such file exists, the preset of that name."""
    if file is None:
        return Layer()
    path = Path(file)
    if not path.exists() and str(file) in presets():
        path = package_folder("configs") / f"{file}.yaml"
    if not path.exists():
        raise ConfigError(missing(path, f"name a YAML file, or a preset: {', '.join(presets())}"))
    from mavnav.config.yaml_layers import read_yaml  # noqa: PLC0415  yaml takes 10 ms to load

    return read_yaml(path)


def load_config(
    file: str | Path | None = None, sets: Iterable[str] = (), overrides: Overrides = None, values: Layer | None = None
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
    top = overlay((values or Layer()).over(file_layer(file)), sets, overrides)
    return read_model(Config, top.over(method_layer(top.values.get(("method",)))))


def overlay(layer: Layer, sets: Iterable[str], overrides: Overrides, short: tuple[Key, str] | None = None) -> Layer:
    """Merge ``--set`` and then the command line options over a layer.

    ``short`` is a section that has a short form, and the key within it that the short form gives.
    """
    given = [_set_layer(text) for text in sets]
    for one, other in combinations(given, 2):
        if one.values.keys() & other.values.keys():
            key = ".".join(*one.values)
            raise ConfigError(
                f"--set {key} is given twice; leave one out, or compare both: compare LOG --set {key}=A,B"
            )
    layers = [layer, *given, _option_layer(overrides)]
    if short:
        layers = [each.spelled_out(*short) for each in layers]
    methods = reduce(_over, layers).values
    return reduce(_over, [_with_cells(each, methods) for each in layers])


def _over(below: Layer, above: Layer) -> Layer:
    return above.over(below)


def _with_cells(layer: Layer, methods: Mapping[Key, object]) -> Layer:
    """Return a layer with `RESOLUTION` as the cell size, in mm, of the method beside it among all values."""
    short = next((key for key in layer.values if key[-1] == RESOLUTION), None)
    if short is None:
        return layer
    method, given = methods.get((*short[:-1], "method")), layer.values[short]
    cell = (*short[:-1], str(method) if method in get_args(MethodName) else Config().method, "cell_mm")
    value = round(given / MM, 6) if isinstance(given, float | int) else given
    rest = {key: other for key, other in layer.values.items() if key != short}
    return Layer({cell: value}, {cell: layer.origins.get(short, RESOLUTION)}).over(Layer(rest, layer.origins))


def method_layer(method: object) -> Layer:
    """Return the preset of a method; an empty layer without one, and for the default, whose preset is the defaults."""
    known = method not in (None, Config().method) and method in presets()
    return file_layer(package_folder("configs") / f"{method}.yaml") if known else Layer()


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


def _option_layer(overrides: Overrides) -> Layer:
    values = {tuple(name.split(".")): value for name, value in (overrides or {}).items() if value is not None}
    return Layer(values, {key: OPTIONS.get(key[-1], f"--{key[-1].replace('_', '-')}") for key in values})


def key_now(key: Key) -> Key:
    """Return what a key of version 0.2.0 is now: those that only experts change have moved."""
    experts = {"paper": PaperExpert, "robust": RobustExpert}.get(key[-2]) if len(key) > 1 else None
    return (*key[:-1], "expert", key[-1]) if experts and key[-1] in experts.__struct_fields__ else key


def schema_of(model: type[Struct]) -> dict[str, Any]:
    """Return the JSON Schema of the input of a model."""
    definitions = schema(model)["$defs"]
    for definition in definitions.values():
        definition["description"] = cleandoc(definition["description"])
    return {**definitions.pop(model.__name__), "$defs": definitions}


def read_model(model: type[Model], layer: Layer, name: str = "configuration") -> Model:
    """Build a model from the values of a layer; ``name`` is its name in errors without a line. Raises ConfigError."""
    try:
        return convert(layer.tree(), model)
    except ValidationError as error:
        raise ConfigError(_error_message(model, str(error), layer, name)) from error
    except UnicodeEncodeError as error:  # half of a surrogate pair, where a word of a list is expected
        key = next((key for key, value in layer.values.items() if value == error.object), ())
        raise ConfigError(f"{origin(layer, key, name)}: {error.object!r} is no text; write plain characters") from error


def origin(layer: Layer, key: Key, name: str = "configuration") -> str:
    """Return the origin of a key, or else of the section that contains it, or of a key below it; else ``name``."""
    around = (layer.origins[key[:n]] for n in range(len(key), 0, -1) if key[:n] in layer.origins)
    within = (where for inner, where in layer.origins.items() if inner[: len(key)] == key)
    return next(around, next(within, name))


def _error_message(model: type[Struct], error: str, layer: Layer, name: str) -> str:
    """Say in a line what msgspec, or a ``__post_init__``, has found wrong: ``problem - at `$.walls[1].box` ``."""
    problem, _, path = error.partition(" - at `$")
    key = tuple(re.findall(r"\w+", path))
    named, kinds = re.fullmatch("Object (.*) field `(.*)`|([a-z_0-9]+): (.*)", problem), dict(_annotations(model))
    if named:
        key, problem = (*key, named[2] or named[3]), named[4] or named[1]
    names, help_ = tuple(part for part in key if not part.isdecimal()), HELP[model.__name__]
    where, dotted = origin(layer, key, name), ".".join(key)
    hint = _description(kinds.get(names)) or f"see '{help_}'"
    if problem == "contains unknown" and (now := key_now(key)) != key:
        return f"{where}: {dotted} is {'.'.join(now)} now; write that"
    if problem == "contains unknown":
        *sections, last = dotted.split(".")
        if (*sections, last) in kinds and "." in key[-1]:
            return f"{where}: {dotted} is a key in a section; write {last} below {'.'.join(sections)}, indented"
        advice = _nearest(names or key, list(kinds), key) or f"see '{help_}' for the known keys"
        return f"{where}: unknown key {dotted}; {advice}"
    if problem == "missing required":
        return f"{where}: {dotted} is missing; give the {hint}"
    value = reduce(lambda node, part: node[part if isinstance(node, dict) else int(part)], key, layer.tree())
    return f"{where}: {dotted} is {brief(value)}, it {_problem(problem, kinds.get(names))}; {hint}"


def _problem(text: str, annotation: object) -> str:
    """Translate a problem of a value in msgspec's words into what the value should be."""
    if text.startswith("Invalid enum value"):
        *others, last = map(repr, _parts(annotation, str))
        return f"should be {', '.join(others)} or {last}"
    if pattern := re.fullmatch("Expected `str` matching regex '(.*)'", text):
        return f"should fit {pattern[1]}"
    expected = re.fullmatch(r"Expected `(.*?)`(?: ([<>]=?) (\S+)| of length (.*?))?(?:, got .*)?", text)
    if expected is None:
        return text
    kinds, comparison, bound, length = expected.groups()
    if comparison:
        return f"should be {_BOUNDS[comparison]} {bound.removesuffix('.0')}"
    if length:
        number = length.replace(">=", "at least").replace("<=", "at most")
        return f"should have {number} {'item' if number.split()[-1] == '1' else 'items'}"
    return f"should be {' or '.join(_KINDS.get(kind, kind) for kind in kinds.split(' | '))}"


def _nearest(key: Key, keys: list[Key], given: Key) -> str:
    """Return a hint at the nearest known key anywhere in the configuration; empty if none is similar.

    It has the indices of ``given``, which is ``key`` with them, and is no section that the key is in.
    """
    keys = [path for path in keys if path != key[: len(path)]]
    known = [".".join(path) for path in keys]
    by_last_name = {path[-1]: ".".join(path) for path in keys}
    proposal = [by_last_name[key[-1]]] if key[-1] in by_last_name else []
    proposal = proposal or difflib.get_close_matches(".".join(key), known, n=1, cutoff=0.8)
    alike = difflib.get_close_matches(key[-1], by_last_name, n=1, cutoff=0.75)
    proposal = proposal or [by_last_name[name] for name in alike]
    return f"did you mean {_add_indices(proposal[0].split('.'), given)}?" if proposal else ""


def _add_indices(parts: list[str], given: Key) -> str:
    """Write a key with the indices that ``given`` has in the part that both share."""
    indexed, rest = [], list(given)
    for part in parts:
        indexed.append(part)
        rest = rest[1:] if rest and rest[0] == part else []
        while rest and rest[0].isdecimal():
            indexed.append(rest.pop(0))
    return ".".join(indexed)


def fields(model: type[Struct] = Config) -> list[tuple[Key, str]]:
    """Return every key of a model with its description, in order; items of a list have the key of the list."""
    return [(key, _description(annotation)) for key, annotation in _annotations(model)]


def _annotations(model: type[Struct], above: Key = ()) -> Iterator[tuple[Key, object]]:
    """Yield every key of a model with its annotation."""
    for each in fields_of(model):
        key = (*above, each.name)
        yield key, each.type
        for section in _parts(each.type, type):
            if issubclass(section, Struct):
                yield from _annotations(section, key)


def _description(annotation: object) -> str:
    return next((meta.description for meta in _parts(annotation, Meta) if meta.description), "")


def _parts(annotation: object, kind: type[Part]) -> list[Part]:
    """Return the types, or the words of a Literal, in an annotation such as ``A | None`` or ``tuple[A, ...]``."""
    if isinstance(annotation, kind):
        return [annotation]
    return [inner for part in get_args(annotation) for inner in _parts(part, kind)]


def to_yaml(config: Config) -> str:
    """Return a configuration as YAML with the description of every field as comment; ``load_config`` can read it."""
    document = config.document()
    unused = {name: document.pop(name) for name in get_args(MethodName) if name != config.method}
    return "".join(_yaml_lines(document | unused, (), dict(fields())))


def _yaml_lines(document: Mapping[str, Any], above: Key, descriptions: Mapping[Key, str]) -> list[str]:
    lines: list[str] = []
    indent = "  " * len(above)
    for name, value in document.items():
        key = (*above, name)
        comment = f"  # {descriptions[key]}" if descriptions.get(key) else ""
        if isinstance(value, dict):
            lines += [f"{indent}{name}:{comment}\n", *_yaml_lines(value, key, descriptions)]
        else:
            lines.append(f"{indent}{name}: {to_scalar(value)}{comment}\n")
    return lines


def to_scalar(value: object) -> str:
    """Write a value as YAML; a plain word without quotes, which a shell would need quotes for."""
    is_word = isinstance(value, str) and re.fullmatch(r"[A-Za-z/][\w/.-]*|\d+x\d+", value)
    return str(value) if is_word else dumps(value)
