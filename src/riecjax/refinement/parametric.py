"""Models for every value of their parameters: what refinement varies."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression
from riecjax.equations.procedure import Procedure, require_no_slip
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, as_leaf
from riecjax.records.record import Record
from riecjax.simulation.equation_system import EquationSystem, equation_system
from riecjax.simulation.system import AbstractSystem

Values = Mapping[str, Leaf]


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
            name = ".".join(_key(part) for part in path)
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

    @classmethod
    def of(
        cls, model: Equation | Procedure, rates: Mapping[str, Expression] | None = None
    ) -> "ByCoefficients":
        """The system of an equation or a procedure, with `rates` of further states.

        **Raises:** `ModelError` if the equations cannot be simulated.
        """
        procedure = Procedure(((model,),)) if isinstance(model, Equation) else model
        # In general position: of two equal inertias, coupled by a third, ones would be singular.
        generic = np.random.default_rng(0).uniform(0.5, 1.5, len(procedure.parameters))
        known = {name: jnp.asarray(value) for name, value in procedure.known.items()}
        values = {**dict(zip(procedure.parameters, generic)), **known}
        system = equation_system(procedure, values, rates=rates)
        return cls(system, tuple(procedure.units.items()), tuple(procedure.known))

    @property
    def parameters(self) -> tuple[str, ...]:
        """The coefficients."""
        return tuple(self.system.values)

    @property
    def defaults(self) -> Values:
        """Values that the equations call known."""
        return {name: self.system.values[name] for name in self.known}

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each coefficient."""
        return dict(self.unit_pairs)

    def build(self, values: Values) -> Any:
        """The system with these coefficients."""
        given = {name: jnp.asarray(values[name]) for name in self.system.values if name in values}
        return eqx.tree_at(lambda s: s.values, self.system, {**self.system.values, **given})


@runtime_checkable
class HasParametricSystem(Protocol):
    """Something that knows its system for every value of its parameters, such as a `Model`."""

    def parametric_system(self, record: Record) -> AbstractParametric:
        """The system that this record can drive."""
        ...


Simulated = (
    AbstractParametric
    | AbstractSystem
    | Equation
    | Procedure
    | HasParametricSystem
    | Callable[[Values], AbstractSystem]
)
"""What output errors can be formed of."""


def as_parametric_system(model: Simulated, record: Record) -> AbstractParametric:
    """The system behind a model, for every value of its parameters.

    **Raises:** `ModelError` if it cannot be simulated.
    """
    require_no_slip(model)
    if isinstance(model, AbstractParametric):
        return model
    if isinstance(model, AbstractSystem):
        return ByFields(model)
    if isinstance(model, Equation | Procedure):
        return ByCoefficients.of(model)
    if isinstance(model, HasParametricSystem):
        return model.parametric_system(record)
    if callable(model):
        return ByFunction(model)
    raise ModelError(
        f"a {type(model).__name__} cannot be simulated; give an Equation, a Procedure, a Model, an "
        f"AbstractSystem, or a function of the parameters that returns one."
    )


def _key(part: Any) -> str:
    for attribute in ("name", "key", "idx"):
        if hasattr(part, attribute):
            return str(getattr(part, attribute))
    return str(part)
