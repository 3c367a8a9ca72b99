"""Parameters and signals with unit and meaning, in plain data: listing them imports no JAX."""

from collections.abc import Hashable
from typing import NamedTuple, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value", bound=Hashable)


class Quantity(NamedTuple):
    """A parameter or signal: name, unit, meaning, and for simulation a default value."""

    name: str
    unit: str
    meaning: str
    default: float | None = None


class FrozenDict(dict[Key, Value]):
    """A mapping that does not change, and so can be part of what is compiled."""

    def __hash__(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return hash(tuple(self.items()))
