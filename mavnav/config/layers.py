"""Layers of configuration values with the origin of each value."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from msgspec import Struct, field

Key = tuple[str, ...]


class Layer(Struct, frozen=True):
    """Values by dotted key, and the origin of each: ``file:line`` or the option."""

    values: dict[Key, object] = field(default_factory=dict)
    origins: dict[Key, str] = field(default_factory=dict)

    def over(self, below: Layer) -> Layer:
        """Merge this layer over another one; a value replaces those of its own key, and of its sub- and super-keys.

        An empty section replaces nothing that lies within it.
        """
        values = {k: v for k, v in self.values.items() if v != {} or not any(_inside(b, k) for b in below.values)}
        kept = {k: v for k, v in below.values.items() if not any(_overlap(k, mine) for mine in values)}
        origins = {k: o for k, o in below.origins.items() if not any(_inside(k, mine) for mine in values)}
        return Layer(kept | values, origins | self.origins)

    def spelled_out(self, key: Key, within: str) -> Layer:
        """Return the layer with the short form of a section, a word for it all, as that value within the section."""
        if not isinstance(self.values.get(key), str):
            return self
        inner = (*key, within)
        origins = {inner: self.origins[key]} if key in self.origins else {}
        return Layer({(inner if k == key else k): value for k, value in self.values.items()}, self.origins | origins)

    def within(self, section: str) -> Layer:
        """Return the layer with all keys prefixed by a section."""
        return self.rename_keys(lambda key: (section, *key))

    def rename_keys(self, name: Callable[[Key], Key]) -> Layer:
        """Return the layer with other keys."""
        values = {name(key): value for key, value in self.values.items()}
        return Layer(values, {name(key): origin for key, origin in self.origins.items()})

    def tree(self) -> dict[str, Any]:
        """Return the values as nested dictionaries."""
        root: dict[str, Any] = {}
        for key, value in self.values.items():
            branch = root
            for name in key[:-1]:
                branch = branch.setdefault(name, {})
            branch[key[-1]] = value
        return root


def leaves(section: Mapping[str, Any], above: Key = ()) -> dict[Key, Any]:
    """Return the values of nested dictionaries by their keys; an empty one has none."""
    values: dict[Key, Any] = {}
    for name, value in section.items():
        key = (*above, name)
        values |= leaves(value, key) if isinstance(value, dict) else {key: value}
    return values


def by_dotted_key(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of nested dictionaries by their dotted keys; an empty one has none."""
    return {".".join(key): value for key, value in leaves(section).items()}


def _overlap(a: Key, b: Key) -> bool:
    return all(one == other for one, other in zip(a, b, strict=False))


def _inside(key: Key, list_key: Key) -> bool:
    """Return whether a key is below ``list_key``."""
    return len(key) > len(list_key) and key[: len(list_key)] == list_key
