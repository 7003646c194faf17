"""The base of the sections of a configuration: dataclasses that share their methods."""

from __future__ import annotations

from dataclasses import MISSING, Field, FrozenInstanceError, dataclass, fields
from typing import Any, ClassVar, TypeVar, dataclass_transform


class Section:
    """What all sections share: frozen, with keyword arguments, equal if all values are.

    ``dataclass`` would generate these methods for every class, which takes 4 ms of processor time in every run.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __init__(self, **values: Any) -> None:  # noqa: ANN401  of the fields
        """Set the given values and the defaults of the others; raises TypeError for a name that is no field."""
        for each in fields(self):
            default = each.default if each.default_factory is MISSING else each.default_factory()
            object.__setattr__(self, each.name, values.pop(each.name, default))
        if values:
            raise TypeError(f"{type(self).__name__} has no {', '.join(values)}")
        self.__post_init__()

    def __post_init__(self) -> None:
        """Do what follows from the values."""

    def __setattr__(self, name: str, value: object) -> None:
        """Raise FrozenInstanceError."""
        raise FrozenInstanceError(f"{name} cannot be set to {value}")

    def __delattr__(self, name: str) -> None:
        """Raise FrozenInstanceError."""
        raise FrozenInstanceError(f"{name} cannot be deleted")

    def __eq__(self, other: object) -> bool:
        """Return whether the classes and all values are equal."""
        return vars(self) == vars(other) if type(self) is type(other) else NotImplemented

    def __hash__(self) -> int:
        """Return a hash of all values."""
        return hash(tuple(getattr(self, each.name) for each in fields(self)))

    def __repr__(self) -> str:
        """Write as a call of the class."""
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in vars(self).items())})"


Made = TypeVar("Made", bound=Section)


@dataclass_transform(kw_only_default=True, frozen_default=True)
def section(made: type[Made]) -> type[Made]:
    """Make a subclass of `Section` a dataclass, which pydantic can check."""
    return dataclass(init=False, repr=False, eq=False, kw_only=True)(made)
