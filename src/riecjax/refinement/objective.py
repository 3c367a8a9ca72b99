"""What a refinement makes small, and what it is given to work on."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Key

from riecjax.estimation.sharing import Sharing, Value
from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.refinement.misfit import AbstractMisfit
from riecjax.refinement.parametric import Values


class Setup(NamedTuple):
    """A refinement as it was asked for.

    **Fields:**

    - `model`: as the objective made it, for every value of its parameters.
    - `records` and `keys`, one for each.
    - `values`: of every parameter over all records, free or not; `names` of the free ones.
    - `local`: names of the parameters as one record knows them; `sharing` between records.
    - `units` of the parameters, by local name.
    """

    model: Any
    records: list[Record]
    keys: list[Key[Array, ""] | None]
    values: dict[str, Leaf]
    names: tuple[str, ...]
    local: tuple[str, ...]
    sharing: Sharing
    units: Mapping[str, str]

    @property
    def fixed(self) -> dict[str, Leaf]:
        """Values of the parameters that are not free."""
        return {name: value for name, value in self.values.items() if name not in self.names}

    def of_record(self, index: int) -> dict[str, Leaf]:
        """Values as one record knows them."""
        return self.sharing.values_of(self.local, self.values, index)

    def of_free(self, given: Mapping[str, Value]) -> dict[str, Value]:
        """What is given by name, over all records: of an own `offset`, for each that is free.

        A name of which nothing is free stays as it is.
        """
        found: dict[str, Value] = {}
        # What is given for one record comes after what is given for all, and replaces it.
        for name in sorted(given, key=lambda name: name not in self.sharing.own):
            free = [n for n in self.sharing.everywhere([name]) if n in self.names]
            found |= dict.fromkeys(free or [name], given[name])
        return found


class Parameters(NamedTuple):
    """Names, values and units that a model comes with."""

    names: tuple[str, ...]
    defaults: Values
    units: Mapping[str, str]


class AbstractObjective(eqx.Module):
    """A sum of squares over windows: of equation errors, or of output errors."""

    @property
    def needs_key(self) -> bool:
        """Whether windows are drawn at random."""
        return False

    def suited(self, model: Any) -> "AbstractObjective":
        """This objective with what the model says where nothing was asked for."""
        return self

    def parametric(self, model: Any, record: Record) -> Any:
        """The model for every value of its parameters.

        **Raises:** `ModelError` for a model that this objective cannot use.
        """
        raise NotImplementedError

    def parameters(self, parametric: Any) -> Parameters:
        """What is known of the parameters; no names where any may be given."""
        raise NotImplementedError

    def misfit(self, setup: Setup) -> AbstractMisfit:
        """The sum of squares itself.

        **Raises:** `DataError` for what the records lack; `ModelError` for settings that do not
        suit the model.
        """
        raise NotImplementedError

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        raise NotImplementedError
