"""What a refinement makes small: a sum of squares over windows, its expansion, and its settings."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.estimation.parameters import Sharing, Value
from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.refinement.parametric import Values
from riecjax.summaries.blocks import ShortBlocks
from riecjax.summaries.normal_equations import NormalEquations


class Expansion(NamedTuple):
    """Residuals at a point and their first derivatives, as moments.

    **Fields:**

    - `pieces`: for each record the Gram matrices of residual, its derivatives by the parameters
      and by the window's start, of each window cut into pieces of time; shape
      `(windows, pieces, 1 + p + s, 1 + p + s)`.
    - `energy`: sum of squared residuals of each quantity in the misfit's `labels`.
    """

    pieces: list[Float[Array, "windows pieces columns columns"]]
    energy: Float[Array, " quantities"]

    def moments(self) -> Float[Array, "windows columns columns"]:
        """Of each window."""
        return jnp.concatenate([jnp.sum(record, axis=1) for record in self.pieces])


class AbstractMisfit(eqx.Module):
    """A sum of squared residuals of parameters and of starts of windows."""

    names: eqx.AbstractVar[tuple[str, ...]]
    """Parameters that are free, over all records."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Quantities whose residuals are told one by one."""
        raise NotImplementedError

    @property
    def units(self) -> tuple[str, ...]:
        """Units of `labels`."""
        raise NotImplementedError

    @property
    def start_names(self) -> tuple[str, ...]:
        """Names of the states whose starts are estimated."""
        return ()

    @property
    def longest_window(self) -> Float[Array, ""]:
        """Seconds after which two residuals share no data."""
        raise NotImplementedError

    def first_starts(self) -> Float[Array, "windows s"]:
        """Initial states to start from, of those components that are estimated."""
        return jnp.zeros((1, 0))

    def start_scale(self) -> Float[Array, " s"]:
        """Size of these components."""
        return jnp.ones(0)

    def settled_energy(
        self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]
    ) -> Float[Array, " quantities"]:
        """`energy` of the starts that leave least with these parameters, searched from others."""
        return self.energy(theta, starts)

    @property
    def steps_label(self) -> str:
        """How finely it is simulated; empty where nothing is."""
        return ""

    def finer(self, factor: int) -> "AbstractMisfit | None":
        """This misfit simulated in steps so many times as short; None where there are no steps."""
        return None

    @property
    def room_for_steps(self) -> int:
        """How many times as short its steps may be made without being asked; 1 for not at all."""
        return 1

    def energy(
        self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]
    ) -> Float[Array, " quantities"]:
        """Sum of squared residuals of each of `labels`, without derivatives."""
        raise NotImplementedError

    def expansion(self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]) -> Expansion:
        """The residuals at a point, to first order."""
        raise NotImplementedError

    def rms(self, energy: Float[Array, " quantities"]) -> Float[Array, " quantities"]:
        """Root mean square of what is left of each of `labels`, in its unit."""
        raise NotImplementedError

    def independent_rows(self) -> Float[Array, ""]:
        """Number of residuals that may be taken as independent, for the weight of priors."""
        raise NotImplementedError

    def blocks(self, expansion: Expansion) -> tuple[NormalEquations, ShortBlocks]:
        """Normal equations of the changes of the parameters, in short blocks of time.

        Leading axes `(records, short blocks)`; starts of windows are projected out.
        """
        raise NotImplementedError


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
