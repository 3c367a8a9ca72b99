"""What a refinement makes small: a sum of squares over windows, as it was asked for and at a point.

A refinement varies parameters theta and, where a model is simulated, the initial states s of each
window. Whatever it compares, it is minimised through the same few quantities: the residuals r in
units of their errors, and their derivatives, as moments [r r_theta r_s]^T [r r_theta r_s] of short
pieces of time. Summed over a window they give a Gauss-Newton step (see `optimum`); summed over
blocks of time, the scores whose scatter is the uncertainty of theta. They are of the size of the
unknowns, however long the record.

Models for every value of their parameters: what refinement varies.
"""

from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.equations.equation import Equation
from riecjax.equations.equation_system import EquationSystem
from riecjax.equations.model import Model, as_model, equation_system, require_no_slip
from riecjax.equations.quantity import Quantity
from riecjax.errors import ModelError
from riecjax.estimation.estimate import AbstractEstimate
from riecjax.estimation.parameters import ParameterTable, name_in_recording, require_numbers
from riecjax.leaves import Leaf, as_leaf, is_concrete
from riecjax.records.record import Record
from riecjax.simulation.system import AbstractSystem
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks
from riecjax.summaries.task import record_keys

Values = Mapping[str, Leaf]
Theta = Float[Array, " p"]
"""Free parameters over all records."""
Initial = Float[Array, "windows s"]
"""Initial states that are estimated, of each window."""
Energies = Float[Array, " quantities"]
"""Sums of squares."""


class AbstractParametric(eqx.Module):
    """A model that is built anew for each value of its parameters."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it knows of; empty where any name may be given."""
        raise NotImplementedError

    @property
    def defaults(self) -> Values:
        """Values that it carries already."""
        return {}

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the parameters, as far as they are known."""
        return {}

    def build(self, values: Values) -> Any:
        """The model with these values, which may be traced."""
        raise NotImplementedError


class ByFunction(AbstractParametric):
    """A function of the parameters by name that returns the model."""

    function: Callable[[Values], Any] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True, default=())
    unit_pairs: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())
    default_values: dict[str, float] = eqx.field(default_factory=dict)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names, if they were given."""
        return self.names

    @property
    def defaults(self) -> Values:
        """Values that were given."""
        return {name: as_leaf(value) for name, value in self.default_values.items()}

    @property
    def units(self) -> Mapping[str, str]:
        """Units that were given."""
        return dict(self.unit_pairs)

    def build(self, values: Values) -> Any:
        """What the function returns."""
        return self.function(values)


class ByFields(AbstractParametric):
    """A module whose scalar fields are its parameters, by their path: `mount.rate`.

    Of an array, every entry is one: `F[0]`, `F[1]`. A class may give units by path in `units`.
    """

    module: eqx.Module

    @property
    def _paths(self) -> dict[str, tuple[int, tuple[int, ...] | None]]:
        """Name to the place of the leaf, and the entry of an array."""
        found: dict[str, tuple[int, tuple[int, ...] | None]] = {}
        leaves = jax.tree_util.tree_leaves_with_path(self.module)
        for place, (path, leaf) in enumerate(leaves):
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            if not (eqx.is_inexact_array(leaf) or isinstance(leaf, float)):
                continue
            for entry in np.ndindex(np.shape(leaf)):
                label = "".join(f"[{i}]" for i in entry)
                found[name + label] = (place, entry or None)
        return found

    @property
    def parameters(self) -> tuple[str, ...]:
        """Paths of all numbers in the module."""
        return tuple(self._paths)

    @property
    def defaults(self) -> Values:
        """The module's own values."""
        leaves = jax.tree.leaves(self.module)
        return {
            name: jnp.asarray(leaves[place] if entry is None else leaves[place][entry])
            for name, (place, entry) in self._paths.items()
        }

    @property
    def units(self) -> Mapping[str, str]:
        """The class's `units`, if it has any."""
        return getattr(self.module, "units", {})

    def build(self, values: Values) -> Any:
        """The module with these values in their fields."""
        leaves, structure = jax.tree.flatten(self.module)
        for name, (place, entry) in self._paths.items():
            if name not in values:
                continue
            leaf = jnp.asarray(leaves[place], jnp.result_type(float))
            value = jnp.asarray(values[name], leaf.dtype)
            leaves[place] = value if entry is None else leaf.at[entry].set(value)
        return jax.tree.unflatten(structure, leaves)


class ByCoefficients(AbstractParametric):
    """The system of equations that are linear in their coefficients, see [`equation_system`][]."""

    system: EquationSystem
    unit_pairs: tuple[tuple[str, str], ...] = eqx.field(static=True)
    known: tuple[str, ...] = eqx.field(static=True)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The coefficients."""
        return tuple(self.system.values)

    @property
    def defaults(self) -> Values:
        """Values that the equations call known, and those to simulate with."""
        return {name: self.system.values[name] for name in self.known}

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each coefficient."""
        return dict(self.unit_pairs)

    def build(self, values: Values) -> Any:
        """The system with these coefficients."""
        given = {name: jnp.asarray(values[name]) for name in self.system.values if name in values}
        return eqx.tree_at(lambda s: s.values, self.system, {**self.system.values, **given})


Simulated = (
    AbstractParametric | AbstractSystem | Equation | Model | Callable[[Values], AbstractSystem]
)
"""What output errors can be formed of."""


def as_parametric_system(model: Simulated, record: Record) -> AbstractParametric:
    """The system behind a model, for every value of its parameters.

    **Raises:** `ModelError` if it cannot be simulated.
    """
    require_no_slip(model)
    if isinstance(model, AbstractParametric):
        return model
    if isinstance(model, EquationSystem):
        units = {name: unit for e in model.equations for name, unit in e.units.items()}
        return ByCoefficients(model, tuple(units.items()), tuple(model.values))
    if isinstance(model, AbstractSystem):
        return ByFields(model)
    if isinstance(model, Equation | Model):
        model = as_model(model)
        quantities = model.simulation_parameters
        defaults = {q.name: q.default for q in quantities if q.default is not None}
        if model.has_own_system(record):
            units = tuple((quantity.name, quantity.unit) for quantity in quantities)
            return ByFunction(
                model.system.build, tuple(q.name for q in quantities), units, defaults
            )
        is_driven = model.is_driven_by(record)
        given = {**(defaults if is_driven else {}), **model.known}
        known = {name: jnp.asarray(value, float) for name, value in given.items()}
        # In general position: of two equal inertias, coupled by a third, ones would be singular.
        generic = np.random.default_rng(0).uniform(0.5, 1.5, len(model.parameter_names))
        values = {**dict(zip(model.parameter_names, generic)), **known}
        system = equation_system(model, values, rates=None if is_driven else {})
        return ByCoefficients(system, tuple(model.units.items()), tuple(known))
    if callable(model):
        return ByFunction(model)
    raise ModelError(
        f"a {type(model).__name__} cannot be simulated; give an Equation, a Model, an "
        f"AbstractSystem, or a function of the parameters that returns one."
    )


class Expansion(NamedTuple):
    """Residuals at a point and their first derivatives, as moments.

    **Fields:**

    - `pieces`: for each record the Gram matrices of residual, its derivatives by the parameters
      and by the window's initial states, of each window cut into pieces of time; shape
      `(windows, pieces, 1 + p + s, 1 + p + s)`.
    - `energy`: sum of squared residuals of each quantity in the misfit's `labels`.
    """

    pieces: list[Float[Array, "windows pieces columns columns"]]
    energy: Energies

    def moments(self) -> Float[Array, "windows columns columns"]:
        """Of each window."""
        return jnp.concatenate([jnp.sum(record, axis=1) for record in self.pieces])


class AbstractMisfit(eqx.Module):
    """A sum of squared residuals, of parameters and of the initial states of windows."""

    table: eqx.AbstractVar[ParameterTable]
    """The parameters over all records, and the values of those that are not free."""
    labels: eqx.AbstractVar[tuple[str, ...]]
    """Quantities whose residuals are told one by one: channels, or equations."""
    units: eqx.AbstractVar[tuple[str, ...]]
    """Units of `labels`."""
    longest_window: eqx.AbstractVar[Float[Array, ""]]
    """Seconds after which two residuals share no data."""

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that are free, over all records."""
        return self.table.free

    def of_record(self, theta: Theta, index: int) -> dict[str, Leaf]:
        """Every parameter's value with these free ones, as one record knows it."""
        values = {**self.table.known, **dict(zip(self.names, theta))}
        return self.table.values_of(values, index)

    @property
    def initial_state_names(self) -> tuple[str, ...]:
        """Names of the states whose initial values are estimated."""
        return ()

    def first_initial(self) -> Initial:
        """First guess of the initial states that are estimated."""
        return jnp.zeros((1, 0))

    def initial_scale(self) -> Float[Array, " s"]:
        """Size of these states."""
        return jnp.ones(0)

    def profiled_energy(self, theta: Theta, initial: Initial) -> Energies:
        """`energy` at the initial states that leave least with these parameters."""
        return self.energy(theta, initial)

    @property
    def steps_label(self) -> str:
        """How finely it is simulated; empty where nothing is."""
        return ""

    def finer(self, factor: int) -> "AbstractMisfit | None":
        """This misfit simulated in steps so many times as short; None where there are no steps."""
        return None

    @property
    def step_factor_limit(self) -> int:
        """How many times as short its steps may be made without being asked; 1 for not at all."""
        return 1

    def energy(self, theta: Theta, initial: Initial) -> Energies:
        """Sum of squared residuals of each of `labels`, without derivatives."""
        raise NotImplementedError

    def expansion(self, theta: Theta, initial: Initial) -> Expansion:
        """The residuals at a point, to first order."""
        raise NotImplementedError

    def curved(self, theta: Theta, initial: Initial, found: Expansion) -> Expansion:
        """What was `found` at an optimum, with the curvature of what is made small.

        Other than what the search needs where that is no sum of squares.
        """
        return found

    def rms(self, energy: Energies) -> Energies:
        """Root mean square of what is left of each of `labels`, in its unit."""
        raise NotImplementedError

    def independent_rows(self) -> Float[Array, ""]:
        """Number of residuals that may be taken as independent, for the weight of priors."""
        raise NotImplementedError

    def blocks(self, expansion: Expansion) -> tuple[NormalEquations, ShortBlocks]:
        """Normal equations of the changes of the parameters, in short blocks of time.

        Leading axes `(records, short blocks)`; initial states are projected out.
        """
        raise NotImplementedError


class Specification(NamedTuple):
    """A refinement as it was asked for.

    **Fields:**

    - `model`: what the objective made of it, for every value of its parameters.
    - `records` and `keys`, one for each.
    - `values`: of every parameter over all records, free or not.
    - `table` of the parameters, in which those that are not free are known.
    """

    model: tuple[Any, ...]
    records: list[Record]
    keys: list[Key[Array, ""] | None]
    values: dict[str, Leaf]
    table: ParameterTable

    @property
    def theta(self) -> Float[Array, " p"]:
        """Values of the free parameters, at which the search begins."""
        free = [self.values[name] for name in self.table.free]
        # In NumPy where nothing is traced: JAX would compile each small step.
        return jnp.asarray(np.stack(free)) if is_concrete(free) else jnp.stack(free)


class AbstractObjective(eqx.Module):
    """A sum of squares over windows: of equation errors, or of output errors."""

    @property
    def needs_key(self) -> bool:
        """Whether windows are drawn at random."""
        return False

    def suited(self, model: Any) -> "AbstractObjective":
        """This objective with what the model says where nothing was asked for."""
        return self

    def parametric(self, model: Any, record: Record) -> "tuple[Any, ...]":
        """What the model consists of, each with `parameters`, their `defaults` and `units`: its
        system, or its equations of motion, for every value of the parameters.

        **Raises:** `ModelError` for a model that this objective cannot use.
        """
        raise NotImplementedError

    def misfit(self, specified: Specification) -> AbstractMisfit:
        """The sum of squares itself.

        **Raises:** `DataError` for what the records lack; `ModelError` for settings that do not
        suit the model.
        """
        raise NotImplementedError

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        raise NotImplementedError

    def specify(
        self,
        model: Any,
        records: list[Record],
        start: AbstractEstimate | Mapping[str, float | Array],
        known: Mapping[str, float | Array] = MappingProxyType({}),
        per_record: Collection[str] = (),
        key: Key[Array, ""] | None = None,
    ) -> Specification:
        """Every parameter's value, and which are free; see [`refine`][].

        What is known goes before what an estimate carries along, that before the start, and that
        before the model's own values. Of an estimate, what each record has its own of is that of
        the estimate unless `per_record` says otherwise.
        """
        parametric = self.parametric(model, records[0])
        if self.needs_key and key is None:
            raise ModelError("random windows need a key: key=jax.random.key(seed).")
        # No names where any may be given.
        names = tuple(dict.fromkeys(name for part in parametric for name in part.parameters))
        defaults: dict[str, Leaf] = {}
        units: dict[str, str] = {}
        for part in parametric:
            units |= {n: u for n, u in part.units.items() if u or n not in units}
            defaults |= part.defaults
        carried: Mapping[str, float | Array] = {}
        elements: list[Any] = []
        if isinstance(start, AbstractEstimate):
            own = {name_of: row for row in start.table.rows for name_of in (row.name, row.local)}
            units = units if names else {**units, **{name: row.unit for name, row in own.items()}}
            elements = [row.element for row in start.table.rows if row.element is not None]
            carried, per_record = start.known, per_record or start.table.per_record
            start = {name: start.single()[name] for name in start.parameters}
        numbered = {name_in_recording(n, i): n for n in per_record for i in range(len(records))}
        given = {**start, **carried, **known}
        local = names or tuple(dict.fromkeys(numbered.get(name, name) for name in given))
        quantities = [Quantity(name, units.get(name, ""), "") for name in local]
        table = ParameterTable.of(quantities, per_record, len(records), elements)
        table.require(given)
        require_numbers(known)
        begun, fixed = table.values(start), {**table.values(carried), **table.values(known)}
        values = {**table.values(defaults), **begun, **fixed}
        if missing := [name for name in table.names if name not in values]:
            raise ModelError(
                f"no value is given for {', '.join(missing)}. Name it in start (to refine it) or "
                f"in known (to hold it)."
            )
        dtype = records[0].time_step.dtype
        numbers = {
            name: (np if is_concrete(values[name]) else jnp).asarray(values[name], dtype)
            for name in table.names
        }
        table = table.holding({n: v for n, v in numbers.items() if n not in begun or n in fixed})
        if not table.free:
            raise ModelError("every parameter is known; nothing is left to refine.")
        return Specification(parametric, records, record_keys(key, len(records)), numbers, table)
