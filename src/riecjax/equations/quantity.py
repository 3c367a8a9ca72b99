"""Parameters and signals with unit and meaning, in plain data: listing them imports no JAX."""

from collections.abc import Callable, Hashable, Mapping
from typing import Any, NamedTuple, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value", bound=Hashable)


class Quantity(NamedTuple):
    """A parameter or signal: name, unit, meaning, and for simulation a default value."""

    name: str
    unit: str
    meaning: str
    default: float | None = None


class Machine(NamedTuple):
    """What is simulated where it is not what equations say.

    **Fields:** `build`, a function of parameters by name that returns a system (in a listing
    `module:function`), `None` where it is the equations that are simulated; `parameters` that it
    takes, with defaults, those that are identified unless given.
    """

    build: Callable[[Mapping[str, Any]], Any] | str | None = None
    parameters: tuple[Quantity, ...] = ()


BY_EQUATIONS = Machine()


class FrozenDict(dict[Key, Value]):
    """A mapping that does not change, and so can be part of what is compiled."""

    def __hash__(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return hash(tuple(self.items()))
