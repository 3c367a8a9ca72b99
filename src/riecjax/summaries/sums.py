"""What one recording says of each equation, kept as sums."""

import dataclasses
from collections.abc import Callable
from typing import Self

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int, UInt32

from riecjax.leaves import Leaf, namespace
from riecjax.records.signal import Noise
from riecjax.summaries.normal_equations import NormalEquations


class Survey(eqx.Module):
    """What only a check and figures ask for.

    **Fields:**

    - `noise`: mean outer product of what the signals' noise adds to a row, shape
      `(1 + p, 1 + p)`.
    - `quadrature`: outer products, summed, of the differences from rows integrated with the highest
      order, and of these, shape `(2, 1 + p, 1 + p)`; zero where there is no higher order.
    - `rows`: some of the rows, shape `(rows, 1 + p)`, and `start`, seconds from the recording's
      first sample to their windows, shape `(rows,)`.
    - `reach`: for each term with a basis, its prefix, least and largest argument.
    """

    noise: Float[Leaf, "columns columns"]
    quadrature: Float[Leaf, "2 columns columns"]
    rows: Float[Leaf, "rows columns"]
    start: Float[Leaf, " rows"]
    reach: dict[str, Float[Leaf, "2"]]


class EquationSums(NormalEquations):
    """Normal equations of one equation on one recording, over windows by bins of their lengths.

    Leading axes are `(bins, blocks)`, blocks those of time in which windows start, and of
    `noise_of_source` they are `(bins, sources)`.

    **Further fields:**

    - `survey`: `None` unless it was asked for.
    - `factor`: triangular factor of all rows, shape `(1 + p, 1 + p)`, where rows are so nearly
      collinear that their moments lose too many digits; else `None`.
    - `constant`: products of the rows of a column that is 1 throughout with its own rows, the
      target's and the regressors', of shape `(bins, blocks, 2 + p)`: what tells means from motion.
      `None` where rows were summed under `jit` or `vmap`, or combined afterwards.
    """

    survey: Survey | None = None
    factor: Float[Leaf, "columns columns"] | None = None
    constant: Float[Leaf, "bins blocks 1+columns"] | None = None

    def each(self, of_sums: Callable[[Leaf], Leaf], **others: Callable[[Leaf], Leaf]) -> Self:
        """The same done to all sums by bins and blocks, and what is said of `others` by name."""
        by_name = dict.fromkeys(("moments", "count", "noise", "constant"), of_sums) | others
        there = {name: getattr(self, name) for name in by_name}
        changed = {n: by_name[n](leaf) for n, leaf in there.items() if leaf is not None}
        return dataclasses.replace(self, **changed)

    def of_bins(self, first: int, last: int) -> Self:
        """The sums of some bins of lengths, first and one beyond the last, in one."""

        def together(bins: Leaf) -> Leaf:
            return bins[first:last].sum(0, keepdims=True)

        return self.each(together, noise_of_source=together)


class RecordingSums(eqx.Module):
    """Sums of all equations on one recording.

    **Fields:**

    - `stages`: equations of each stage of the model.
    - `blocks`: how many short blocks of time hold the recording; arrays may be longer.
    - `block_seconds`: that each of them lasts.
    - `offered`: rows there would be of one equation without gaps and masks; NaN if not known.
    - `samples`, `time_step`: of the recording.
    - `digest`: SHA-256 of its content and of all settings, zero where it was summed under `jit`.
    - `noise` of the recording's signals.
    """

    stages: tuple[tuple[EquationSums, ...], ...]
    blocks: Int[Leaf, ""]
    block_seconds: Float[Leaf, ""]
    offered: Float[Leaf, ""]
    samples: Int[Leaf, ""]
    time_step: Float[Leaf, ""]
    digest: UInt32[Leaf, "8"]
    noise: Noise = eqx.field(default_factory=Noise)

    def of_blocks(self, index: Int[np.ndarray, " blocks"]) -> "RecordingSums":
        """The sums of some of the blocks (not under jit)."""
        if index.size == int(self.blocks):
            return self

        # A factor of all rows has no parts, and what one source adds is spread evenly.
        share = index.size / int(self.blocks)

        def of(equation: EquationSums) -> EquationSums:
            some = equation.each(
                lambda leaf: np.asarray(leaf[:, index], order="C"),
                noise_of_source=lambda leaf: share * leaf,
            )
            return dataclasses.replace(some, factor=None)

        # Rows are not spread evenly over blocks, so that it is not known how many were offered.
        return dataclasses.replace(
            self.of_equations(of), blocks=np.asarray(index.size), offered=np.asarray(np.nan)
        )

    def in_blocks(self, most: int) -> "RecordingSums":
        """The same in so many blocks of time at most, neighbours added up (not under jit)."""
        held = int(self.blocks)
        if held <= most:
            return self
        first = -(-np.arange(most) * held // most)

        def of(equation: EquationSums) -> EquationSums:
            return equation.each(lambda sums: np.add.reduceat(np.asarray(sums), first, axis=1))

        seconds = float(self.blocks) * float(self.block_seconds)
        return dataclasses.replace(
            self.of_equations(of),
            blocks=np.asarray(most),
            block_seconds=np.asarray(seconds / most),
        )

    def of_equations(self, of: Callable[[EquationSums], EquationSums]) -> "RecordingSums":
        """The same done to the sums of every equation."""
        stages = tuple(tuple(map(of, stage)) for stage in self.stages)
        return dataclasses.replace(self, stages=stages)

    def scaled(self, factor: float) -> "RecordingSums":
        """Sums times a factor; triangular factors, whose squares are sums, times its root."""
        root = namespace(factor).sqrt(factor)

        def times(leaf: Leaf) -> Leaf:
            return leaf * factor

        def of(equation: EquationSums) -> EquationSums:
            return equation.each(times, noise_of_source=times, factor=lambda rows: rows * root)

        return dataclasses.replace(self.of_equations(of), offered=self.offered * factor)
