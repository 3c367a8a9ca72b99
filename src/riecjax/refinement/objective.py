"""Models for every value of their parameters, and the residuals that a refinement makes small.

A refinement varies parameters theta and, where a model is simulated, the initial states s of each
window. Whatever it compares, it is minimised through the same few quantities: the residuals r in
units of their errors, and their derivatives, as moments [r r_theta r_s]^T [r r_theta r_s] of short
pieces of time. Summed over a window they give a Gauss-Newton step (see `optimum`); summed over
blocks of time, the scores whose scatter is the uncertainty of theta. They are of the size of the
unknowns, however long the record.

**Initial states projected out.** Let J = dr/dtheta, S = dr/ds, C = S^T S and B = J^T S of a window.
To first order the best initial state follows theta by ds/dtheta = -C^-1 B^T, and the residual does

    (J - S C^-1 B^T) dtheta.

That is a linear map of columns, [r J S] -> [-r, J - S C^-1 B^T], the same in every piece of the
window. Applied to the moments of pieces it gives scores of theta alone by blocks of time. Their sum
has the Schur complement A - B C^-1 B^T of `optimum` for its Gram matrix: a covariance of theta
that includes what is not known of initial states.
"""

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from riecjax import arrays as xp
from riecjax.equations.equation import Equation
from riecjax.equations.equation_system import EquationSystem
from riecjax.equations.model import Model, as_model, equation_system, require_no_slip
from riecjax.equations.quantity import Quantity
from riecjax.errors import ModelError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.parameters import ParameterTable, name_in_recording, require_numbers
from riecjax.linear_algebra import solve_scaled
from riecjax.records.record import Record
from riecjax.simulation.system import AbstractSystem
from riecjax.summaries.summarise import record_keys

if TYPE_CHECKING:
    from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks

Leaf = Array | np.ndarray
Values = Mapping[str, Leaf]
Theta = Float[Array, " p"]
"""Free parameters over all records."""
Initial = Float[Array, "windows s"]
"""Initial states that are estimated, of each window."""
Energies = Float[Array, " quantities"]
"""Sums of squares."""


def _as_leaves(values: Mapping[str, Leaf | float]) -> Values:
    return {name: xp.asarray(value, float) for name, value in values.items()}


class ByFunction(eqx.Module):
    """A model that is built anew for each value of its parameters, by a function of these by name.

    **Fields:** `function` that returns the model; `names` of the parameters, none where any may be
    given; pairs of name and unit, as far as they are known; `defaults`, values that it carries
    already; `held`, what the function takes before the values, if it is not `None`: arrays that a
    closure would compile in.
    """

    function: Callable[..., Any] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True, default=())
    unit_pairs: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())
    defaults: Values = eqx.field(default_factory=dict, converter=_as_leaves)
    held: Any = None

    def build(self, values: Values) -> Any:
        """The model with these values, which may be traced."""
        return self.function(values) if self.held is None else self.function(self.held, values)


def by_fields(module: eqx.Module) -> ByFunction:
    """A module whose scalar fields are its parameters, by their path: `mount.rate`.

    Of an array, every entry is one: `F[0]`, `F[1]`. A class may give units by path in `units`.
    """
    leaves = jax.tree_util.tree_leaves_with_path(module)
    defaults = {
        name: xp.asarray(leaf)[entry]
        for path, leaf in leaves
        for name, entry in _entries(path, leaf)
    }
    units = tuple(getattr(module, "units", {}).items())
    return ByFunction(_with_fields, tuple(defaults), units, defaults, module)


def _entries(path: Any, leaf: Any) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Names of all numbers in a leaf of a module, each with its entry of an array."""
    name = jax.tree_util.keystr(path, simple=True, separator=".")
    if eqx.is_inexact_array(leaf) or isinstance(leaf, float):
        for entry in np.ndindex(np.shape(leaf)):
            yield name + "".join(f"[{i}]" for i in entry), entry


def _with_fields(module: eqx.Module, values: Values) -> Any:
    def filled(path: Any, leaf: Any) -> Any:
        for name, entry in _entries(path, leaf):
            if name in values:
                whole = xp.asarray(leaf, float)
                value = xp.asarray(values[name], whole.dtype)
                leaf = xp.with_entries(whole, entry, value) if entry else value
        return leaf

    return jax.tree_util.tree_map_with_path(filled, module)


def _with_coefficients(system: EquationSystem, values: Values) -> EquationSystem:
    given = {name: xp.asarray(values[name]) for name in system.values if name in values}
    return eqx.tree_at(lambda s: s.values, system, {**system.values, **given})


Simulatable = ByFunction | AbstractSystem | Equation | Model | Callable[[Values], AbstractSystem]
"""What output errors can be formed of."""


def as_parametric_system(model: Simulatable, record: Record) -> ByFunction:
    """The system behind a model, for every value of its parameters.

    **Raises:** `ModelError` if it cannot be simulated.
    """
    require_no_slip(model)
    if isinstance(model, ByFunction):
        return model
    if isinstance(model, EquationSystem):
        units = {name: unit for e in model.equations for name, unit in e.units.items()}
        pairs, names = tuple(units.items()), tuple(model.values)
        return ByFunction(_with_coefficients, names, pairs, model.values, model)
    if isinstance(model, AbstractSystem):
        return by_fields(model)
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
        known = {name: xp.asarray(value, float) for name, value in given.items()}
        # In general position: of two equal inertias, coupled by a third, ones would be singular.
        generic = np.random.default_rng(0).uniform(0.5, 1.5, len(model.parameter_names))
        values = {**dict(zip(model.parameter_names, generic)), **known}
        system = equation_system(model, values, rates=None if is_driven else {})
        settled = {name: system.values[name] for name in known}
        units = tuple(model.units.items())
        return ByFunction(_with_coefficients, tuple(system.values), units, settled, system)
    if callable(model):
        return ByFunction(model)
    raise ModelError(
        f"a {type(model).__name__} cannot be simulated; give an Equation, a Model, an "
        f"AbstractSystem, or a function of the parameters that returns one."
    )


class Simulated(NamedTuple):
    """A record's windows as they are simulated.

    **Fields:** `left`, simulated minus recorded in units of sigma, 0 where nothing is compared; its
    derivatives `by_initial` states of the window.
    """

    left: Float[Array, "windows longest channels"]
    by_initial: Float[Array, "windows longest channels s"]


class Expansion(NamedTuple):
    """Residuals at a point and their first derivatives, as moments.

    **Fields:**

    - `pieces`: for each record the Gram matrices of residual, its derivatives by the parameters
      and by the window's initial states, of each window cut into pieces of time; shape
      `(windows, pieces, 1 + p + s, 1 + p + s)`.
    - `energy`: sum of squared residuals of each of the `labels`.
    - `simulated`: of what is simulated, the [`Simulated`][] of each record.
    """

    pieces: list[Float[Array, "windows pieces columns columns"]]
    energy: Energies
    simulated: "Sequence[Simulated]" = ()

    def moments(self) -> Float[Array, "windows columns columns"]:
        """Of each window."""
        return xp.concatenate([xp.sum(record, axis=1) for record in self.pieces])


class AbstractResiduals(eqx.Module):
    """Residuals of all records, of parameters and of the initial states of windows.

    **Fields:**

    - `table`: the parameters over all records, and the values of those that are not free; `start`,
      values of the free ones at which a search begins.
    - `labels`: quantities whose residuals are told one by one, channels or equations; their
      `units`.
    - `curved`: whether moments curve as what is made small does, or, for what searches for its
      least, as squares do; `None` where that is the same.

    Of what is simulated, and empty where nothing is:

    - `initial`: first guess of the initial states that are estimated; `initial_state_names`.
    - `method` of simulation; `most_steps` that it may take between samples without being asked, 0
      of a user's own.
    """

    table: ParameterTable
    start: Theta
    labels: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    initial: Initial = eqx.field(default_factory=lambda: np.zeros((1, 0)), kw_only=True)
    initial_state_names: tuple[str, ...] = eqx.field(static=True, default=(), kw_only=True)
    method: Any = eqx.field(default=None, kw_only=True)
    curved: Bool[Leaf, ""] | None = eqx.field(default=None, kw_only=True)
    most_steps: int = eqx.field(static=True, default=0, kw_only=True)

    @abstractmethod
    def expansion(self, theta: Theta, initial: Initial) -> Expansion:
        """The residuals at a point, to first order."""

    def at(self, theta: Theta, initial: Initial) -> Expansion:
        """The expansion, traced as the caller is or by one program for all points, in double
        precision."""
        if xp.are_traced(self, theta, initial):
            return _expanded(self, theta, initial)
        method = None if self.method is None else self.method.counted()
        counted = dataclasses.replace(self, method=method, most_steps=0)
        return xp.in_double(_expanded, counted, theta, initial)

    @abstractmethod
    def rms(self, energy: Energies) -> Energies:
        """Root mean square of what is left of each of `labels`, in its unit."""

    @abstractmethod
    def independent_rows(self) -> Float[Array, ""]:
        """Number of residuals that may be taken as independent, for the weight of priors."""

    @abstractmethod
    def blocks(self, expansion: Expansion) -> "tuple[NormalEquations, ShortBlocks]":
        """Normal equations of the changes of the parameters, in short blocks of time.

        Leading axes `(records, short blocks)`; initial states are projected out.
        """


@eqx.filter_jit
def _expanded(residuals: AbstractResiduals, theta: Theta, initial: Initial) -> Expansion:
    return residuals.expansion(theta, initial)


RIDGE = 1e-10
"""What keeps an initial state that no residual depends on from a division by zero; relative."""


def without_initial(
    pieces: Float[Array, "windows pieces columns columns"], p: int
) -> Float[Array, "windows pieces 1+p 1+p"]:
    """Of the pieces of windows, moments of minus the residual and of its derivatives while initial
    states follow: a change of the parameters is to take the residual off."""
    mix = np.diag(np.append(-1.0, np.ones(p))).astype(pieces.dtype)[None]
    if pieces.shape[-1] > 1 + p:
        whole = xp.sum(pieces, axis=1)
        states, parameters = slice(1 + p, None), slice(1, 1 + p)
        following = solve_scaled(whole[:, states, states], whole[:, states, parameters], RIDGE)
        followed = xp.pad(-following, [(0, 0), (0, 0), (1, 0)])
        mix = xp.broadcast_to(mix, (len(followed), *mix.shape[1:]))
        mix = xp.concatenate([mix, followed], axis=1)
    mix = mix[:, None]
    return xp.matmul(xp.swapaxes(mix, 2, 3), xp.matmul(pieces, mix))


class AbstractObjective(eqx.Module):
    """What is made small: squares of equation errors, or of output errors, over windows."""

    def suited(self, model: Any) -> "AbstractObjective":
        """This objective with what the model says where nothing was asked for."""
        return self

    def residuals(
        self,
        model: Any,
        records: list[Record],
        start: Estimate | Mapping[str, float | Array],
        known: Mapping[str, float | Array] = MappingProxyType({}),
        per_record: Collection[str] = (),
        key: Key[Array, ""] | None = None,
    ) -> Any:
        """The residuals of a model along records; see [`refine`][] for the arguments.

        What is known goes before what an estimate carries along, that before the start, and that
        before the model's own values. Of an estimate, what each record has its own of is that of
        the estimate unless `per_record` says otherwise.

        **Raises:** `ModelError` for a model that this objective cannot use, and for values or
        settings that do not suit it; `DataError` for what the records lack.
        """
        models = self.models(model, records[0])
        # No names where any may be given.
        names = tuple(dict.fromkeys(name for model in models for name in model.names))
        defaults: dict[str, Leaf] = {}
        units: dict[str, str] = {}
        for model in models:
            units |= {n: unit for n, unit in model.unit_pairs if unit or n not in units}
            defaults |= model.defaults
        carried: Mapping[str, float | Array] = {}
        parts: dict[str, Any] = {}
        if isinstance(start, Estimate):
            rows = start.table.rows
            if not names:
                units |= {name: row.unit for row in rows for name in (row.name, row.local)}
            parts = {row.local: row.element for row in rows if row.element is not None}
            carried, per_record = start.known, per_record or start.table.per_record
            start = {name: start.single()[name] for name in start.parameters}
        numbered = {name_in_recording(n, i): n for n in per_record for i in range(len(records))}
        given = {**start, **carried, **known}
        local = names or tuple(dict.fromkeys(numbered.get(name, name) for name in given))
        quantities = [Quantity(name, units.get(name, ""), "") for name in local]
        table = ParameterTable.of(quantities, per_record, len(records), parts)
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
        numbers = {name: xp.asarray(values[name], dtype) for name in table.names}
        table = table.settled({n: v for n, v in numbers.items() if n not in begun or n in fixed})
        if not table.free:
            raise ModelError("every parameter is known; nothing is left to refine.")
        # In NumPy where nothing is traced: JAX would compile each small step.
        theta = xp.stack([numbers[name] for name in table.free])
        return self.over(models, records, table, theta, record_keys(key, len(records)))

    @abstractmethod
    def models(self, model: Any, record: Record) -> Sequence[ByFunction]:
        """What a model consists of: its system, or its equations of motion."""

    @abstractmethod
    def over(
        self,
        models: Sequence[ByFunction],
        records: list[Record],
        table: ParameterTable,
        start: Theta,
        keys: list[Key[Array, ""] | None],
    ) -> AbstractResiduals:
        """The residuals of `models` along records, whose parameters are those of a table."""

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
