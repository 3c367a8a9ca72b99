"""What one recording says of each equation, kept as sums."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int, UInt32

from riecjax.leaves import Leaf, namespace
from riecjax.records.noise import Noise


class Averages(eqx.Module):
    """Rows of an equation averaged by hats, as triangular factors: what tells means from motion.

    Row by row nothing is kept. Of rows `[1, y, A]` the triangular factor R of a QR decomposition
    has every norm, product and least-squares solution of its columns; below its first row, which
    holds the columns' means times the root of their number, stand their deviations from them.

    **Fields:** `rows` and `noise`, factors of the rows and of what noise adds to them, shape
    `(2 + p, 2 + p)`; `independent`, rows that share no data.
    """

    rows: Float[Leaf, "2+p 2+p"]
    noise: Float[Leaf, "2+p 2+p"]
    independent: Float[Leaf, ""]


class Activity(eqx.Module):
    """Sums over samples that tell a term which acts in bursts from one that acts all along.

    **Fields:** `square` and `fourth` power of the columns that stand under no derivative, zero for
    others, shape `(1 + p,)`; `gram`, outer products of all columns, differentiated by differences,
    shape `(1 + p, 1 + p)`; `samples`, how many were present.
    """

    square: Float[Leaf, " columns"]
    fourth: Float[Leaf, " columns"]
    gram: Float[Leaf, "columns columns"]
    samples: Float[Leaf, ""]

    def __add__(self, other: "Activity") -> "Activity":
        """Of both stretches of samples."""
        return Activity(
            self.square + other.square,
            self.fourth + other.fourth,
            self.gram + other.gram,
            self.samples + other.samples,
        )


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


class EquationSums(eqx.Module):
    """Sums over the windows of one equation on one recording.

    **Fields:**

    - `moments`: `[y A]^T [y A]` of windows that start in each short block of time, by bin of
      window lengths, shape `(bins, blocks, 1 + p, 1 + p)`.
    - `count`: number of these windows, shape `(bins, blocks)`.
    - `averages`, `activity`: what [`estimate`][] refuses or doubts by; `None` where they were
      summed under `jit` or `vmap`.
    - `survey`: `None` unless it was asked for.
    - `factor`: triangular factor of all rows, shape `(1 + p, 1 + p)`, where rows are so nearly
      collinear that their moments lose too many digits; else `None`.
    - `parameters`: names of the p regressors.
    - `noise`: what of the moments sensor noise adds in expectation, of the same shape, and
      `noise_of_source`, what each of the noise's sources adds to all blocks, shape
      `(bins, sources, 1 + p, 1 + p)`; `None` where nothing is known of it.
    """

    moments: Float[Leaf, "bins blocks columns columns"]
    count: Float[Leaf, "bins blocks"]
    averages: Averages | None
    activity: Activity | None
    survey: Survey | None
    factor: Float[Leaf, "columns columns"] | None
    parameters: tuple[str, ...] = eqx.field(static=True)
    noise: Float[Leaf, "bins blocks columns columns"] | None = None
    noise_of_source: Float[Leaf, "bins sources columns columns"] | None = None


class RecordingSums(eqx.Module):
    """Sums of all equations on one recording.

    **Fields:**

    - `stages`: equations of each stage of the procedure.
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

        def of(equation: EquationSums) -> EquationSums:
            moments, count, noise = (
                None if leaf is None else np.asarray(leaf[:, index], order="C")
                for leaf in (equation.moments, equation.count, equation.noise)
            )
            # A factor of all rows has no parts, and what one source adds is spread evenly.
            share, of_source = index.size / int(self.blocks), equation.noise_of_source
            return dataclasses.replace(
                equation,
                moments=moments,
                count=count,
                factor=None,
                noise=noise,
                noise_of_source=None if of_source is None else share * of_source,
            )

        # Rows are not spread evenly over blocks, so that it is not known how many were offered.
        return dataclasses.replace(
            self,
            stages=tuple(tuple(of(e) for e in stage) for stage in self.stages),
            blocks=np.asarray(index.size),
            offered=np.asarray(np.nan),
        )

    def scaled(self, factor: float) -> "RecordingSums":
        """Sums times a factor; triangular factors, whose squares are sums, times its root."""
        root = namespace(factor).sqrt(factor)

        def of(equation: EquationSums) -> EquationSums:
            averages, rows = equation.averages, equation.factor
            noise, of_source = equation.noise, equation.noise_of_source
            if averages is not None:
                averages = dataclasses.replace(
                    averages, rows=averages.rows * root, noise=averages.noise * root
                )
            return dataclasses.replace(
                equation,
                moments=equation.moments * factor,
                count=equation.count * factor,
                averages=averages,
                activity=jax.tree.map(lambda leaf: leaf * factor, equation.activity),
                factor=None if rows is None else rows * root,
                noise=None if noise is None else noise * factor,
                noise_of_source=None if of_source is None else of_source * factor,
            )

        stages = tuple(tuple(of(e) for e in stage) for stage in self.stages)
        return dataclasses.replace(self, stages=stages, offered=self.offered * factor)
