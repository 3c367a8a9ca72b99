"""Integral refinement: the criterion of eq. (17) for equations that are not linear in theta.

An equation of motion leaves e(theta, t) = sum_k d^k/dt^k q_k(theta, t), k = 0 to 2, and a criterion
compares its impulse over each window with zero. With a test function phi that vanishes at its ends
as often as need be, integration by parts leaves no derivative of a signal,

    r(theta) = int phi e dt = sum_k (-1)^k int phi^(k) q_k(theta, t) dt.

About theta each q_k is q_k(theta) + sum_i (dq_k/dtheta_i) delta_i to first order. Put in, r is

    r(theta) + sum_i delta_i sum_k (-1)^k int phi^(k) dq_k/dtheta_i dt,

which is eq. (17) of an ordinary equation with unknowns delta, known term q_k and the derivatives
for its signals. So any criterion forms its normal equations, all windows in closed form among them,
at the cost of one linear identification with a column more, and their solution is a Gauss-Newton
step. Derivatives by theta commute with phi because phi does not depend on theta; windows are drawn
once and stay. Of an equation linear in theta the second line is exact: the first undamped step is
[`identify`][] of all equations at once, and ends the search.

A linear equation's `moments` are of [known term moved to the right, columns], so its target is -r:
hence the change of sign of the first column.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.criteria.windows import DEFAULT_BAND
from riecjax.equations.procedure import Procedure, told_apart
from riecjax.errors import ModelError
from riecjax.estimation.parameters import Sharing
from riecjax.estimation.stages import all_normal_equations
from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.refinement.balance import ParametricBalance, as_balances
from riecjax.refinement.objective import (
    AbstractMisfit,
    AbstractObjective,
    Expansion,
    Parameters,
    Specification,
)
from riecjax.refinement.parametric import ByFunction
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks, short_blocks


class IntegralMisfit(AbstractMisfit):
    """Impulses of the equation error over all windows of all records.

    `labels` are the equations; `units` theirs, times seconds for each integration.
    """

    balances: tuple[ParametricBalance, ...]
    records: list[Record]
    criterion: AbstractCriterion
    keys: list[Key[Array, ""] | None]
    known: dict[str, Leaf]
    count: Float[Array, " equations"]
    longest_window: Float[Array, ""]
    names: tuple[str, ...] = eqx.field(static=True)
    local: tuple[str, ...] = eqx.field(static=True)
    sharing: Sharing = eqx.field(static=True)
    labels: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)

    def energy(
        self, theta: Float[Array, " p"], initial: Float[Array, "windows s"]
    ) -> Float[Array, " quantities"]:
        """Of each equation."""
        return jnp.stack([jnp.sum(part.energy) for part in self._equations(theta)])

    def expansion(self, theta: Float[Array, " p"], initial: Float[Array, "windows s"]) -> Expansion:
        """By blocks of the windows' starts, all records in one piece."""
        parts = self._equations(theta)
        moments = sum(part.moments for part in parts[1:]) + parts[0].moments
        pieces = _first_negated(moments).reshape(1, -1, *moments.shape[2:])
        return Expansion([pieces], jnp.stack([jnp.sum(part.energy) for part in parts]))

    def rms(self, energy: Float[Array, " quantities"]) -> Float[Array, " quantities"]:
        """Of the impulses of each equation over a window."""
        return jnp.sqrt(energy / jnp.maximum(self.count, 1))

    def independent_rows(self) -> Float[Array, ""]:
        """As many as disjoint windows of the greatest length."""
        short = short_blocks(self.records, self.criterion)
        window = jnp.maximum(self.longest_window, jnp.min(short.seconds))
        return len(self.balances) * jnp.sum(short.durations) / window

    def blocks(self, expansion: Expansion) -> tuple[NormalEquations, ShortBlocks]:
        """By blocks of the windows' starts."""
        short = short_blocks(self.records, self.criterion)
        most = expansion.pieces[0].shape[1] // len(self.records)
        (pieces,) = expansion.pieces
        moments = _first_negated(pieces).reshape(len(self.records), most, *pieces.shape[2:])
        share = jnp.sum(self.count) / (len(self.records) * most)
        count = jnp.full(moments.shape[:2], share)
        return NormalEquations(moments, count, self.names), short

    def _equations(self, theta: Float[Array, " p"]) -> list[NormalEquations]:
        """Of each equation, in the changes of the parameters."""
        values = {**self.known, **dict(zip(self.names, theta))}
        of_record = [
            self.sharing.values_of(self.local, values, i) for i in range(len(self.records))
        ]
        return [self._expanded(balance, of_record) for balance in self.balances]

    def _expanded(
        self, balance: ParametricBalance, values: Sequence[Mapping[str, Leaf]]
    ) -> NormalEquations:
        free = self.sharing.free_somewhere(self.local, self.names)
        smoothness = self.criterion.smoothness
        expanded = [
            balance.expanded(record, own, free, smoothness)
            for record, own in zip(self.records, values)
        ]
        (equations,) = all_normal_equations(
            Procedure(((expanded[0][0],),)),
            self.sharing,
            [record for _, record in expanded],
            self.criterion,
            self.keys,
        )
        # What is free in some record may be fixed in another: it does not change.
        fixed = {n: jnp.zeros(()) for n in equations.parameters if n not in self.names}
        return equations.fix(fixed).embed(self.names)


def _first_negated(moments: Float[Array, "*n c c"]) -> Float[Array, "*n c c"]:
    """Moments of rows whose first column is negated."""
    return moments.at[..., 0, 1:].multiply(-1.0).at[..., 1:, 0].multiply(-1.0)


class IntegralError(AbstractObjective):
    """Impulses of the equation error over windows, as [`identify`][] makes them small.

    For equations that are linear in their parameters this is `identify` of all of them at once.

    **Arguments:** `criterion`; by default all windows of half the periods of the model's band, or
    of 1 to 10 Hz.
    """

    criterion: AbstractCriterion | None = None

    @property
    def _criterion(self) -> AbstractCriterion:
        return RIEC.of_band(DEFAULT_BAND) if self.criterion is None else self.criterion

    @property
    def needs_key(self) -> bool:
        """Whether windows are drawn at random."""
        return self._criterion.needs_key

    def suited(self, model: Any) -> "IntegralError":
        """With windows for the model's band, unless others were asked for."""
        band = getattr(model, "band", None) or DEFAULT_BAND
        return IntegralError(RIEC.of_band(band)) if self.criterion is None else self

    def parametric(self, model: Any, record: Record) -> tuple[ParametricBalance, ...]:
        """The equations of motion.

        **Raises:** `ModelError` for a function that does not name its parameters.
        """
        balances = as_balances(model)
        if any(isinstance(b.model, ByFunction) and not b.parameters for b in balances):
            raise ModelError(
                "a function that builds a balance needs the names of its parameters, by which its "
                "equation is expanded: rx.refinement.ByFunction(function, names=('M', 'K'))."
            )
        return balances

    def parameters(self, parametric: tuple[ParametricBalance, ...]) -> Parameters:
        """Of all equations."""
        units: dict[str, str] = {}
        defaults = {}
        for balance in parametric:
            units |= {n: u for n, u in balance.units.items() if u or n not in units}
            defaults |= balance.defaults
        names = dict.fromkeys(name for balance in parametric for name in balance.parameters)
        return Parameters(tuple(names), defaults, units)

    def misfit(self, specified: Specification) -> IntegralMisfit:
        """Over all windows of the criterion."""
        for record in specified.records:
            self._criterion.check(record)
        criterion = self._criterion.fitted(specified.records)
        free = set(specified.sharing.free_somewhere(specified.local, specified.names))
        # An equation without free parameters would only add a constant.
        chosen = [i for i, b in enumerate(specified.model) if set(b.parameters) & free]
        labels = [specified.model[i].label(specified.values) for i in chosen]
        rows = [
            [criterion.row_count(record) or 0.0 for record in specified.records] for _ in chosen
        ]
        return IntegralMisfit(
            balances=tuple(specified.model[i] for i in chosen),
            records=specified.records,
            criterion=criterion,
            keys=specified.keys,
            known=specified.fixed,
            count=np.array(rows).sum(axis=1),
            longest_window=jnp.asarray(criterion.block_length),
            names=specified.names,
            local=specified.local,
            sharing=specified.sharing,
            labels=told_apart([name for name, _ in labels]),
            units=tuple(criterion.row_unit(unit) for _, unit in labels),
        )

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        return {"refine": "integral", **self._criterion.describe()}
