"""Integral refinement: the criterion of eq. (17) for equations that are not linear in theta.

An equation of motion leaves e(theta, t) = sum_k d^k/dt^k q_k(theta, t), k = 0 to 2, and a criterion
compares its impulse over each window with zero. With a test function phi that vanishes at its ends
as often as need be, integration by parts leaves no derivative of a signal,

    r(theta) = int phi e dt = sum_k (-1)^k int phi^(k) q_k(theta, t) dt.

About theta each q_k is q_k(theta) + sum_i (dq_k/dtheta_i) delta_i to first order. Put in, r is

    r(theta) + sum_i delta_i sum_k (-1)^k int phi^(k) dq_k/dtheta_i dt,

which is eq. (17) of an ordinary equation with unknowns delta, known term q_k and the derivatives
for its signals, on a record that holds these. So any criterion forms its normal equations, all
windows in closed form among them, at the cost of one linear identification with a column more, and
their solution is a Gauss-Newton step. Derivatives by theta commute with phi because phi does not
depend on theta; windows are drawn once and stay. Of an equation linear in theta the second line is
exact: the first undamped step is [`identify`][] of all equations at once, and ends the search.

Of a linear equation the known term moves to the right, and the target is minus that: here -q_k, so
that its `moments` are of [r, dr/dtheta].
"""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax import arrays as xp
from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.criteria.windows import DEFAULT_BAND
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, require_no_slip, told_apart
from riecjax.equations.term import Term, combined, samples_of
from riecjax.errors import DataError, ModelError, users_code
from riecjax.estimation.stages import over_records
from riecjax.records.record import Record, Signal, Signals
from riecjax.refinement.objective import (
    AbstractObjective,
    AbstractResiduals,
    ByFunction,
    Energies,
    Expansion,
    Initial,
    Theta,
    Values,
    by_fields,
    without_initial,
)
from riecjax.summaries.normal_equations import (
    NormalEquations,
    ShortBlocks,
    short_blocks,
    stack_normal_equations,
)
from riecjax.summaries.one_pass import stage_normal_equations


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


def expanded(
    model: ByFunction, record: Record, values: Values, free: Sequence[str], smoothness: int
) -> tuple[Equation, Record]:
    """First-order expansion about `values` of an equation of motion, for a criterion that takes so
    many derivatives off.

    **Returns:** an equation whose coefficients are the changes of the `free` parameters, and the
    record with the signals that it reads, whose names begin with `~`.

    **Raises:** `DataError` for a missing signal, or a derivative that is neither recorded nor taken
    off; `ModelError` for a balance that holds nothing or fails.
    """
    held = {n: jnp.asarray(values[n], record.time_step.dtype) for n in model.names}
    levels = _levels(model, record, held, smoothness)
    name, unit, where = _label(model, held)
    # The error is the equation's target, so that its rows are those of [r, dr/dtheta].
    parts: list[tuple[float | str, str, int, Any]] = [
        (-1.0, f"~:{order}", order, level.values) for order, level in levels.items()
    ]
    moving = {name: held[name] for name in model.names if name in free}
    slopes = jax.jacfwd(
        lambda at: {
            k: level.values for k, level in _levels(model, record, held | at, smoothness).items()
        }
    )(moving)
    parts += [(name, f"~:{k}/{name}", k, slopes[k][name]) for name in moving for k in levels]
    present = combined(lambda *values: values[0], *levels.values()).present
    signals = {name: Signal(values, present) for _, name, _, values in parts}
    terms = [Term(coefficient, name, derivative=k) for coefficient, name, k, _ in parts]
    equation = Equation(*terms, name=name, unit=unit, where=where)
    return equation, record.with_signals(signals)


def _label(model: ByFunction, values: Values) -> tuple[str, str, Any]:
    """Name and unit of an equation, and where it is to be trusted."""
    built = model.build(values)
    where = built.where if isinstance(built, Equation) else type(built).where
    return built.name, built.unit, where


def _levels(
    model: ByFunction, record: Record, values: Values, smoothness: int
) -> dict[int, Signal]:
    """Samples of what is left to be differentiated so many times."""
    levels: dict[int, Signal] = {}
    balance = model.build(values)
    if isinstance(balance, Equation):
        for term in balance.terms:
            # As criteria read it: derivatives that the test function cannot take off are recorded.
            read = max(term.derivative - smoothness, 0)
            coefficients = [values[name] for name in term.parameters]

            def total(columns: Float[Array, "columns n"], weights=coefficients) -> Array:
                return jnp.stack(weights) @ columns if weights else jnp.sum(columns, axis=0)

            level, order = combined(total, samples_of(term, record, read)), term.derivative - read
            before = levels.get(order)
            levels[order] = level if before is None else combined(operator.add, before, level)
        return levels
    timed = record if "t" in record.arrays else record.with_signals({"t": record.time})
    signals = timed.signals
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
        levels[order] = Signal(jnp.broadcast_to(level, (record.sample_count,)))
    if not levels:
        raise ModelError(f"{balance.name}: a balance needs a force, a momentum or a first moment.")
    if max(levels) > smoothness:
        raise DataError(
            f"{balance.name}: this criterion takes {smoothness} time derivative(s) off the motion, "
            f"and the balance needs {max(levels)}. Use windows that need no derivative, rx.Hat(), "
            f"or write its inertia as a momentum of a recorded velocity."
        )
    present = record.present(signals.read)
    return {order: Signal(level.values, present) for order, level in levels.items()}


Balances = Equation | Model | AbstractBalance | ByFunction | Sequence["Balances"]
"""What equation errors can be formed of: one equation of motion or several."""


def as_balances(model: Balances) -> tuple[ByFunction, ...]:
    """Every equation of motion behind a model, for every value of its parameters.

    **Raises:** `ModelError` for something that holds none, or hidden elements.
    """
    if not isinstance(model, list | tuple):
        require_no_slip(model)
    if isinstance(model, AbstractBalance):
        return (by_fields(model),)
    if isinstance(model, ByFunction):
        return (model,)
    if isinstance(model, Equation | Model):
        if isinstance(model, Model) and model.has_hidden:
            raise ModelError(
                "hidden elements have motions of their own, which no integral of the "
                "equations shows: refine by rx.OutputError()."
            )
        equations = (model,) if isinstance(model, Equation) else model.equations
        # Linear in its parameters, an equation is the same whatever these are.
        return tuple(
            ByFunction(_itself, e.parameters, tuple(e.units.items()), e.known, e) for e in equations
        )
    if isinstance(model, Sequence):
        return tuple(balance for part in model for balance in as_balances(part))
    raise ModelError(
        f"a {type(model).__name__} has no equation of motion to integrate; give an Equation, a "
        f"Model, an AbstractBalance, or several of them."
    )


def _itself(equation: Equation, values: Values) -> Equation:
    return equation


class IntegralResiduals(AbstractResiduals):
    """Impulses of the equation error over all windows of all records.

    `labels` are the equations; `units` theirs, times seconds for each integration.
    """

    models: tuple[ByFunction, ...]
    records: list[Record]
    criterion: AbstractCriterion
    keys: list[Key[Array, ""] | None]
    count: Float[Array, " equations"]

    def expansion(self, theta: Theta, initial: Initial) -> Expansion:
        """By blocks of the windows' starts, all records in one piece."""
        known = [self.table.values_at(theta, i) for i in range(len(self.records))]
        names, free = self.table.free, self.table.free_somewhere
        every = []
        for model in self.models:
            parts = []
            for record, values, key in zip(self.records, known, self.keys):
                equation, error = expanded(model, record, values, free, self.criterion.smoothness)
                alone = Model(stages=((equation,),))
                parts += stage_normal_equations(alone, error, self.criterion, key, blocks=True)
            equations = over_records(stack_normal_equations(parts), self.table)
            # What is free in some record may be fixed in another: it does not change.
            fixed = {name: jnp.zeros(()) for name in equations.parameters if name not in names}
            every.append(equations.fix(fixed).embed(names))
        moments = sum(each.moments for each in every[1:]) + every[0].moments
        pieces = moments.reshape(1, -1, *moments.shape[2:])
        return Expansion([pieces], jnp.stack([jnp.sum(each.energy) for each in every]))

    def rms(self, energy: Energies) -> Energies:
        """Of the impulses of each equation over a window."""
        return xp.sqrt(energy / xp.maximum(self.count, 1))

    def independent_rows(self) -> Float[Array, ""]:
        """As many as disjoint windows of the greatest length."""
        short = short_blocks(self.records, self.criterion)
        window = xp.maximum(short.longest_window, xp.min(short.seconds))
        return len(self.models) * xp.sum(short.durations) / window

    def blocks(self, expansion: Expansion) -> tuple[NormalEquations, ShortBlocks]:
        """By blocks of the windows' starts."""
        moments = without_initial(expansion.pieces[0], len(self.table.free))
        moments = moments.reshape(len(self.records), -1, *moments.shape[2:])
        count = xp.full(moments.shape[:2], xp.sum(self.count) / math.prod(moments.shape[:2]))
        short = short_blocks(self.records, self.criterion)
        return NormalEquations(moments, count, self.table.free), short


class IntegralError(AbstractObjective):
    """Impulses of the equation error over windows, as [`identify`][] makes them small.

    For equations that are linear in their parameters this is `identify` of all of them at once.

    **Arguments:** `criterion`; by default all windows of half the periods of the model's band, or
    of 1 to 10 Hz.
    """

    criterion: AbstractCriterion | None = None

    def suited(self, model: Any) -> "IntegralError":
        """With windows for the model's band, unless others were asked for."""
        band = getattr(model, "band", None) or DEFAULT_BAND
        return IntegralError(RIEC.of_band(band)) if self.criterion is None else self

    def models(self, model: Any, record: Record) -> tuple[ByFunction, ...]:
        """The equations of motion.

        **Raises:** `ModelError` for a function that does not name its parameters.
        """
        models = as_balances(model)
        if any(isinstance(m, ByFunction) and m.held is None and not m.names for m in models):
            raise ModelError(
                "a function that builds a balance needs the names of its parameters, by which its "
                "equation is expanded: rx.refinement.ByFunction(function, names=('M', 'K'))."
            )
        return models

    def over(
        self,
        models: Sequence[ByFunction],
        records: list[Record],
        table: Any,
        start: Theta,
        keys: list[Key[Array, ""] | None],
    ) -> IntegralResiduals:
        """Over all windows of the criterion."""
        criterion = self.criterion or RIEC.of_band(DEFAULT_BAND)
        if criterion.needs_key and keys[0] is None:
            raise ModelError("random windows need a key: key=jax.random.key(seed).")
        for record in records:
            criterion.check(record)
        criterion = criterion.fitted(records)
        free = {*table.free_somewhere}
        # An equation without free parameters would only add a constant.
        models = tuple(model for model in models if free & {*model.names})
        values = table.values_at(start, 0)
        labels = [_label(model, values) for model in models]
        rows = [[criterion.row_count(record) or 0.0 for record in records] for _ in models]
        return IntegralResiduals(
            models=models,
            records=records,
            criterion=criterion,
            keys=keys,
            table=table,
            start=start,
            count=np.array(rows).sum(axis=1),
            labels=told_apart([name for name, *_ in labels]),
            units=tuple(criterion.row_unit(unit) for _, unit, _ in labels),
        )

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        criterion = self.criterion or RIEC.of_band(DEFAULT_BAND)
        return {"refine": "integral", **criterion.describe()}
