"""The JSON Schema of run.json, generated from its model, and the names and descriptions of its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from inspect import cleandoc
from typing import Any, Final, get_type_hints

from msgspec import defstruct
from msgspec.json import schema as json_schema

from mavnav.metrics.gates import OF_MAP
from mavnav.outputs.documents.run_json import RunDocument

Schema = dict[str, Any]

UNITS: Final = {
    "_deg_per_m": "deg/m",
    "_per_m": "1/m",
    "_per_s": "1/s",
    "_m_s": "m/s",
    "_deg_s": "deg/s",
    "_hz": "Hz",
    "_bits": "bit",
    "_bytes": "byte",
    "_share": "1",
    **{f"_{unit}": unit for unit in ("mm2", "m2", "mm", "m", "s", "deg", "rad", "cells")},
}
"""Suffix of a name -> unit; what has none of them is a count or a ratio: 1."""

CONFIGURATION: Final = ("Config", "OdometryConfig", "PaperConfig", "PaperExpert", "RobustConfig", "RobustExpert")
"""Definitions of the configuration in the schema."""


@cache
def run_schema() -> Schema:
    """Return the JSON Schema of run.json; every number in it has a title, a description and a unit."""
    definitions = json_schema(RunDocument)["$defs"]
    for name in CONFIGURATION:  # it is written whole, with the search grid as text
        definitions[name]["required"] = list(definitions[name]["properties"])
    definitions["Config"]["properties"]["grid"] = {"type": "string"}
    schema = _inline(definitions.pop("RunDocument"), definitions, "", {})
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "run.json", **schema}


def _inline(node: Schema, defs: dict[str, Schema], name: str, around: Schema) -> Schema:
    """Put definitions in their places, so that each number is described by where it is.

    ``around`` is the key of the record or list that a number is in: its description and unit hold for the number too.
    """
    if "$ref" in node:
        key = {k: v for k, v in node.items() if k not in {"$ref", "default"}}
        return _inline(defs[node["$ref"].rpartition("/")[2]], defs, "", {"unit": _unit(name), **key}) | key
    if _is_number(node):
        return _describe({k: v for k, v in node.items() if k != "default"}, name, around)
    node = {k: cleandoc(v) if k == "description" else v for k, v in node.items() if k not in {"title", "default"}}
    if "properties" in node:
        node["properties"] = {k: _inline(child, defs, k, around) for k, child in node["properties"].items()}
    if "anyOf" in node:
        node["anyOf"] = [_inline(option, defs, name, {}) for option in node["anyOf"]]
    for part in ("items", "additionalProperties"):
        if isinstance(node.get(part), dict):
            node[part] = _inline(node[part], defs, name, {k: node[k] for k in ("description", "unit") if k in node})
    return node


def _is_number(node: Schema) -> bool:
    return any(option.get("type") in {"number", "integer"} for option in node.get("anyOf", [node]))


def _describe(node: Schema, name: str, around: Schema) -> Schema:
    """Complete title, description and unit of a number by its name and by the key around it."""
    unit = node.get("unit") or _unit(name) or around.get("unit") or "1"
    bare = next((name.removesuffix(suffix) for suffix in UNITS if name.endswith(suffix)), name)
    texts = [text for text in (node.get("description"), around.get("description")) if text]
    description = f"{texts[0]} ({texts[1]})" if len(texts) == 2 else "".join(texts)
    return {"title": bare.replace("_", " "), **node, "description": description, "unit": unit}


def _unit(name: str) -> str:
    return next((unit for suffix, unit in UNITS.items() if name.endswith(suffix)), "")


@cache
def run_keys() -> dict[str, Schema]:
    """Return the schema of every key of run.json by its full name, ``*`` for any key or place of a list."""
    return dict(_keys(run_schema()))


def _keys(node: Schema, name: str = "") -> Iterator[tuple[str, Schema]]:
    for option in node.get("anyOf", [node]):
        any_key = [option[key] for key in ("items", "additionalProperties") if isinstance(option.get(key), dict)]
        for key, child in (*option.get("properties", {}).items(), *(("*", child) for child in any_key)):
            yield f"{name}{key}", child
            yield from _keys(child, f"{name}{key}.")


def number_names(*, reference: bool = False) -> list[str]:
    """Return the names of the numbers and truth values of a replay's run.json, with those of references if asked."""
    sections = {*run_schema()["required"], *OF_MAP, *(["reference"] if reference else [])}
    keys = {name: node for name, node in run_keys().items() if name.partition(".")[0] in sections}
    return [name for name, node in keys.items() if _is_number(node) or node.get("type") == "boolean"]


def number_schema(name: str) -> Schema:
    """Return the schema of a number; that of the record around it where this has a direction, as a distribution may."""
    keys = _section_keys(name.partition(".")[0])
    around = keys.get(name.rpartition(".")[0], {})
    return around if "better" in around else keys[name]


@cache
def _section_keys(section: str) -> dict[str, Schema]:
    """Return what `run_keys` has of one section, in a fraction of the time: every page needs a few."""
    definitions = json_schema(defstruct("Part", [(section, _hints()[section])]))["$defs"]
    return dict(_keys(_inline(definitions.pop("Part"), definitions, "", {})))


@cache
def _hints() -> dict[str, Any]:
    return get_type_hints(RunDocument, include_extras=True)
