"""Equations of motion, linear in their parameters or not, and their first-order expansion.

About any values of its parameters an equation is linear in their changes, to first order. That
expansion is an ordinary `Equation`, on a record that holds the equation error and its derivatives
by the parameters as signals. So every criterion, all windows in closed form among them, serves
equations that are not linear: refinement expands, solves, and expands again.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import both_present
from riecjax.equations.procedure import HasProcedure, Procedure, require_no_slip
from riecjax.equations.term import AbstractTerm, Term
from riecjax.errors import DataError, ModelError, users_code
from riecjax.records.record import Record
from riecjax.records.signals import Signals
from riecjax.refinement.parametric import AbstractParametric, ByFields, Values

Levels = dict[int, Float[Array, " n"]]
"""Samples of what is left to be differentiated so many times."""


class AbstractBalance(eqx.Module):
    """One equation of motion, M q'' - F(q, q', t) = 0, with its parameters as fields.

    What must vanish is

        force + d/dt momentum + d^2/dt^2 first_moment

    each a function of the signals of a record, one number for each sample. Derivatives are never
    formed: an integral criterion moves them onto its test function. An inertia is the momentum
    M q' where a velocity is recorded, and the first moment M q where only a position is. Override
    those that the equation has.

    ```python
    class Stribeck(AbstractBalance):
        M: Array
        Fc: Array
        Fs: Array
        vs: Array
        units = {"M": "kg", "Fc": "N", "Fs": "N", "vs": "m/s"}

        def momentum(self, signals):
            return self.M * signals["dq"]

        def force(self, signals):
            v = signals["dq"]
            friction = self.Fc + (self.Fs - self.Fc) * jnp.exp(-((v / self.vs) ** 2))
            return friction * jnp.sign(v) - signals["F"]
    ```

    Class variables: `name` and `unit` of the equation, `units` of the parameters, and `where`, as
    of an [`Equation`][]. Time in seconds is the signal `t`, unless the record has one of that name.
    """

    name: ClassVar[str] = "balance"
    unit: ClassVar[str] = ""
    units: ClassVar[Mapping[str, str]] = {}
    where: ClassVar[Callable[[Signals], Array] | None] = None

    def force(self, signals: Signals) -> Array | None:
        """What is not differentiated."""
        return None

    def momentum(self, signals: Signals) -> Array | None:
        """What is differentiated once."""
        return None

    def first_moment(self, signals: Signals) -> Array | None:
        """What is differentiated twice."""
        return None


class ParametricBalance(eqx.Module):
    """An equation of motion for every value of its parameters.

    **Fields:** `model`, an `Equation`, or something that builds an `AbstractBalance`.
    """

    model: Equation | AbstractParametric

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return self.model.parameters

    @property
    def units(self) -> Mapping[str, str]:
        """Units of its parameters."""
        return self.model.units

    @property
    def defaults(self) -> Values:
        """Values that it carries already."""
        if isinstance(self.model, Equation):
            return {name: jnp.asarray(value) for name, value in self.model.known.items()}
        return self.model.defaults

    def expanded(
        self, record: Record, values: Values, free: Sequence[str], smoothness: int
    ) -> tuple[Equation, Record]:
        """First-order expansion about `values`, for a criterion that takes derivatives off.

        **Returns:** an equation whose coefficients are the changes of the `free` parameters, and
        the record with the signals that it reads, whose names begin with `~`.

        **Raises:** `DataError` for a missing signal, or a derivative that is neither recorded nor
        taken off; `ModelError` for a balance that holds nothing or fails.
        """
        held = {n: jnp.asarray(values[n], record.time_step.dtype) for n in self.parameters}
        moving = tuple(name for name in self.parameters if name in free)
        levels, present = self._levels(record, held, smoothness)
        name, unit, where = self._labels(held)
        arrays: dict[str, Array] = {}
        terms: list[AbstractTerm] = []
        for order, level in levels.items():
            arrays[f"~:{order}"] = level
            terms.append(Term(1.0, f"~:{order}", derivative=order))
        for parameter in moving:
            along = {n: jnp.full_like(v, n == parameter) for n, v in held.items()}
            _, slopes = jax.jvp(
                lambda at: self._levels(record, at, smoothness)[0], (held,), (along,)
            )
            for order, slope in slopes.items():
                arrays[f"~:{order}/{parameter}"] = slope
                terms.append(Term(parameter, f"~:{order}/{parameter}", derivative=order))
        missing = {} if present is None else dict.fromkeys(arrays, ~present)
        equation = Equation(*terms, name=name, unit=unit, where=where)
        return equation, record.with_signals(arrays, missing=missing)

    def label(self, values: Values) -> tuple[str, str]:
        """Name and unit of the equation."""
        return self._labels(values)[:2]

    def _labels(self, values: Values) -> tuple[str, str, Callable[[Signals], Array] | None]:
        if isinstance(self.model, Equation):
            return self.model.name, self.model.unit, self.model.where
        module = self.model.build(values)
        return module.name, module.unit, type(module).where

    def _levels(
        self, record: Record, values: Values, smoothness: int
    ) -> tuple[Levels, Bool[Array, " n"] | None]:
        if isinstance(self.model, Equation):
            return _of_equation(self.model, record, values, smoothness)
        return _of_balance(self.model.build(values), record, smoothness)


def _of_equation(
    equation: Equation, record: Record, values: Values, smoothness: int
) -> tuple[Levels, Bool[Array, " n"] | None]:
    levels: Levels = {}
    present = None
    for term in equation.terms:
        # As criteria read it: derivatives that the test function cannot take off are recorded.
        read = max(term.derivative - smoothness, 0)
        sampled = term.samples(record, read)
        coefficients = [values[name] for name in term.parameters]
        total = (
            jnp.stack(coefficients) @ sampled.values
            if coefficients
            else jnp.sum(sampled.values, axis=0)
        )
        order = term.derivative - read
        levels[order] = levels[order] + total if order in levels else total
        present = both_present(present, sampled.present)
    return levels, present


def _of_balance(
    balance: AbstractBalance, record: Record, smoothness: int
) -> tuple[Levels, Bool[Array, " n"] | None]:
    timed = record if "t" in record.arrays else record.with_signals({"t": record.time})
    signals = timed.signals
    levels: Levels = {}
    for order, part in enumerate((balance.force, balance.momentum, balance.first_moment)):
        with users_code(f"{balance.name}.{part.__name__}"):
            level = part(signals)
        if level is None:
            continue
        level = jnp.asarray(level, record.time_step.dtype)
        if level.shape not in ((), (record.sample_count,)):
            raise ModelError(
                f"{balance.name}.{part.__name__} must return one number for each of the "
                f"{record.sample_count} samples; it returned shape {level.shape}."
            )
        levels[order] = jnp.broadcast_to(level, (record.sample_count,))
    if not levels:
        raise ModelError(f"{balance.name}: a balance needs a force, a momentum or a first moment.")
    if max(levels) > smoothness:
        raise DataError(
            f"{balance.name}: this criterion takes {smoothness} time derivative(s) off the motion, "
            f"and the balance needs {max(levels)}. Use windows that need no derivative, rx.Hat(), "
            f"or write its inertia as a momentum of a recorded velocity."
        )
    return levels, record.present(signals.read)


Balances = (
    Equation
    | Procedure
    | HasProcedure
    | AbstractBalance
    | AbstractParametric
    | Sequence["Balances"]
)
"""What equation errors can be formed of: one equation of motion or several."""


def as_balances(model: Balances) -> tuple[ParametricBalance, ...]:
    """Every equation of motion behind a model, for every value of its parameters.

    **Raises:** `ModelError` for something that holds none, or hidden elements.
    """
    if not isinstance(model, list | tuple):
        require_no_slip(model)
    if isinstance(model, AbstractBalance):
        return (ParametricBalance(ByFields(model)),)
    if isinstance(model, Equation | AbstractParametric):
        return (ParametricBalance(model),)
    if isinstance(model, Procedure):
        if model.has_hidden:
            raise ModelError(
                "hidden modes and springs have states of their own, which no integral of the "
                "equations shows: refine by rx.OutputError()."
            )
        return tuple(ParametricBalance(e) for stage in model.stages for e in stage)
    if isinstance(model, Sequence):
        return tuple(balance for part in model for balance in as_balances(part))
    if hasattr(model, "build_procedure"):
        return as_balances(model.build_procedure())
    raise ModelError(
        f"a {type(model).__name__} has no equation of motion to integrate; give an Equation, a "
        f"Procedure, a Model, an AbstractBalance, or several of them."
    )
