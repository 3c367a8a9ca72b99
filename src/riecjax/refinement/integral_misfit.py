"""Integral refinement: the criterion of eq. (17) for equations that are not linear in theta."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.estimation.assembly import all_normal_equations, short_blocks
from riecjax.estimation.blocks import ShortBlocks
from riecjax.estimation.normal_equations import NormalEquations
from riecjax.estimation.procedure import Procedure, told_apart
from riecjax.estimation.sharing import Sharing
from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.refinement.balance import ParametricBalance
from riecjax.refinement.misfit import AbstractMisfit, Expansion


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
