"""Reader of strict YAML into layers of configuration values.

Scalars have the types of YAML 1.2 (``off`` is a string, ``1e-3`` a number, ``010`` is ten); aliases, tags, duplicate
keys are errors.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from mavnav.config.layers import Key, Layer
from mavnav.errors import ConfigError

MAX_BYTES = 1_000_000
MAX_DEPTH = 20
MAX_PARTS = 40_000
"""Maximum number of keys, values and brackets: each takes some 50 us."""


class _Yaml12(yaml.SafeLoader):
    """The safe loader with the scalar types of YAML 1.2's core schema."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012  as in yaml


for _tag, _pattern, _first in (
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", "tTfF"),
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("int", r"^(?:[-+]?[0-9]+|0o[0-7]+)$", "-+0123456789"),
    ("float", r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$", "-+.0123456789"),
):
    _Yaml12.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(_pattern), list(_first))


def _integer(_loader: _Yaml12, node: yaml.ScalarNode) -> int:
    """Read an integer: octal if it begins with 0o, else decimal, also with leading zeros."""
    text = str(node.value)
    return int(text, 8) if text.startswith("0o") else int(text)


_Yaml12.add_constructor("tag:yaml.org,2002:int", _integer)

_SCALAR_TAGS = {f"tag:yaml.org,2002:{name}" for name in ("bool", "null", "int", "float", "str")}


CONFIGURATION = "a YAML file or a preset"
"""What is to be named instead of a file that is no configuration."""


def read_yaml(path: Path, wanted: str = CONFIGURATION) -> Layer:
    """Read one YAML file; ``wanted`` is what to name instead where it is none.

    Raises
    ------
    ConfigError
        The file cannot be read, is no YAML mapping, has aliases, tags or duplicate keys, or is too large or too deeply
        nested.
    """
    if path.exists() and not path.is_file():
        raise ConfigError(f"{path} is not a regular file; name {wanted}")
    try:
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path} cannot be read, {error.strerror}; name {wanted}") from error
    if len(text) > MAX_BYTES:
        raise ConfigError(f"{path} is larger than {MAX_BYTES} bytes; name {wanted}")
    return layer_of(text, str(path), wanted)


def layer_of(text: bytes | str, name: str, wanted: str = CONFIGURATION) -> Layer:
    """Read YAML text; ``name`` is its name in errors, ``wanted`` what to name instead where it is no YAML."""
    try:
        _refuse_aliases(text, name, wanted)
        root = yaml.compose(text, _Yaml12)
    except yaml.MarkedYAMLError as error:
        where = f"{name}:{_line(error.problem_mark)}"
        raise ConfigError(f"{where}: not valid YAML, {error.problem}; mend that line") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{name}: not YAML text; name {wanted}") from error
    layer = Layer()
    if isinstance(root, yaml.MappingNode):
        _collect(root, (), name, layer)
    elif root is not None:
        where = f"{name}:{_line(root.start_mark)}"
        raise ConfigError(f"{where}: the file is no mapping; write 'key: value' lines, or name {wanted}")
    return layer


def _refuse_aliases(text: bytes | str, name: str, wanted: str) -> None:
    """Raise ConfigError for aliases, deep nesting and too many values, before any object is built from the text."""
    depth = 0
    for number, event in enumerate(yaml.parse(text, _Yaml12)):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        line = _line(event.start_mark)
        if isinstance(event, yaml.AliasEvent):
            raise ConfigError(f"{name}:{line}: aliases are not read; write the value out")
        if number > MAX_PARTS:
            raise ConfigError(f"{name}:{line}: more than {MAX_PARTS} keys and values; name {wanted}")
        if depth > MAX_DEPTH:
            raise ConfigError(f"{name}:{line}: nested deeper than {MAX_DEPTH} levels; name {wanted}")


def _line(mark: Any) -> int:  # noqa: ANN401  yaml has two types of marks
    return mark.line + 1 if mark else 1


def _collect(node: yaml.MappingNode, key: Key, name: str, layer: Layer) -> None:
    """Add the values of a mapping and their lines to ``layer``, recursively; an empty mapping is a value."""
    for key_node, value_node in node.value:
        line = _line(key_node.start_mark)
        if not (isinstance(key_node, yaml.ScalarNode) and key_node.value.isprintable()):
            raise ConfigError(f"{name}:{line}: a key is no plain word; write 'key: value' lines")
        child = (*key, str(key_node.value))
        if child in layer.origins:
            raise ConfigError(f"{name}:{line}: {'.'.join(child)} is given twice; keep one of them")
        layer.origins[child] = f"{name}:{line}"
        if isinstance(value_node, yaml.MappingNode) and value_node.value:
            _collect(value_node, child, name, layer)
        else:
            layer.values[child] = _value(value_node, child, name, layer)


def _value(node: yaml.Node, key: Key, name: str, layer: Layer) -> object:
    """Return a scalar, or a list of scalars, lists and mappings; add the lines of list items to ``layer`` by index."""
    if isinstance(node, yaml.SequenceNode):
        items = [((*key, str(number)), item) for number, item in enumerate(node.value)]
        layer.origins.update({item_key: f"{name}:{_line(item.start_mark)}" for item_key, item in items})
        return [_value(item, item_key, name, layer) for item_key, item in items]
    if isinstance(node, yaml.MappingNode):
        inner = Layer()
        _collect(node, (), name, inner)
        layer.origins.update({(*key, *inner_key): origin for inner_key, origin in inner.origins.items()})
        return inner.tree()
    where = f"{name}:{_line(node.start_mark)}: {'.'.join(key)}"
    if not isinstance(node, yaml.ScalarNode) or node.tag not in _SCALAR_TAGS:
        raise ConfigError(f"{where} has a tag; write a plain number, word or list")
    loader = _Yaml12("")
    try:
        value: object = loader.construct_object(node)
    except ValueError as error:  # an integer with more digits than Python converts
        raise ConfigError(f"{where} is a number of {len(node.value)} digits; write fewer") from error
    return value
