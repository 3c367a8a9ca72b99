"""Integral refinement: the criterion of eq. (17) for equations that are not linear in theta."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.criteria.windows import DEFAULT_BAND
from riecjax.equations.procedure import Procedure, told_apart
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
    Setup,
)
from riecjax.summaries.blocks import ShortBlocks, short_blocks
from riecjax.summaries.normal_equations import NormalEquations


class IntegralMisfit(AbstractMisfit):
    """Impulses of the equation error over all windows of all records."""

    balances: tuple[ParametricBalance, ...]
    records: list[Record]
    criterion: AbstractCriterion
    keys: list[Key[Array, ""] | None]
    known: dict[str, Leaf]
    count: Float[Array, " equations"]
    names: tuple[str, ...] = eqx.field(static=True)
    local: tuple[str, ...] = eqx.field(static=True)
    sharing: Sharing = eqx.field(static=True)
    equation_labels: tuple[tuple[str, str], ...] = eqx.field(static=True)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the equations."""
        return told_apart([name for name, _ in self.equation_labels])

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the rows: of the equation, times seconds for each integration."""
        return tuple(unit for _, unit in self.equation_labels)

    @property
    def longest_window(self) -> Float[Array, ""]:
        """beta."""
        return jnp.asarray(self.criterion.block_length)

    def energy(
        self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]
    ) -> Float[Array, " quantities"]:
        """Of each equation."""
        return jnp.stack([jnp.sum(part.energy) for part in self._equations(theta)])

    def expansion(self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]) -> Expansion:
        """By blocks of the windows' starts, all records in one piece."""
        parts = self._equations(theta)
        # Moments hold minus the residual, as what changes of the parameters are to explain.
        sign = jnp.ones(1 + theta.shape[0]).at[0].set(-1.0)
        moments = sum(part.moments for part in parts[1:]) + parts[0].moments
        pieces = moments.reshape(1, -1, *moments.shape[2:])
        return Expansion(
            [pieces * (sign[:, None] * sign[None, :])[None, None]],
            jnp.stack([jnp.sum(part.energy) for part in parts]),
        )

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
        sign = jnp.ones(pieces.shape[-1]).at[0].set(-1.0)
        moments = pieces * (sign[:, None] * sign[None, :])[None, None]
        moments = moments.reshape(len(self.records), most, *pieces.shape[2:])
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
        """The equations of motion."""
        return as_balances(model)

    def parameters(self, parametric: tuple[ParametricBalance, ...]) -> Parameters:
        """Of all equations."""
        units: dict[str, str] = {}
        defaults = {}
        for balance in parametric:
            units |= {n: u for n, u in balance.units.items() if u or n not in units}
            defaults |= balance.defaults
        names = dict.fromkeys(name for balance in parametric for name in balance.parameters)
        return Parameters(tuple(names), defaults, units)

    def misfit(self, setup: Setup) -> IntegralMisfit:
        """Over all windows of the criterion."""
        for record in setup.records:
            self._criterion.check(record)
        criterion = self._criterion.fitted(setup.records)
        labels = tuple(balance.label(setup.values) for balance in setup.model)
        free = set(setup.sharing.free_somewhere(setup.local, setup.names))
        # An equation without free parameters would only add a constant.
        chosen = [i for i, b in enumerate(setup.model) if set(b.parameters) & free]
        rows = [[criterion.row_count(record) or 0.0 for record in setup.records] for _ in chosen]
        return IntegralMisfit(
            balances=tuple(setup.model[i] for i in chosen),
            records=setup.records,
            criterion=criterion,
            keys=setup.keys,
            known=setup.fixed,
            count=np.array(rows).sum(axis=1),
            names=setup.names,
            local=setup.local,
            sharing=setup.sharing,
            equation_labels=tuple((labels[i][0], criterion.row_unit(labels[i][1])) for i in chosen),
        )

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        return {"refine": "integral", **self._criterion.describe()}
