"""How far an equation's sums bear out the noise that is taken off them, and what is unsure of it.

**Bound.** Less what noise adds, the moments of target and regressors are those of the signals,
which no combination of columns can make negative. So C <= M: the largest eigenvalue of C against M
is at most one, and one if the model is right, since then nothing but noise is left of the equation.
Noise that comes out larger is not there: the motion itself, or a command, reached up to half the
sampling rate and was taken for it. Then C is taken as large as it can be, and no larger.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.leaves import Leaf
from riecjax.linear_algebra import solve_scaled, symmetric_eigen, unit_diagonal
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.block_statistics import BlockStatistics, scores, slope

SCATTER = 1.25
"""Eigenvalue up to which noise that is judged right may come out, by chance."""
MOST = 0.9
"""Share of the regressors' moments that is taken off at most."""


def largest_share(
    noise: Float[Array, "q q"], moments: Float[Array, "q q"]
) -> tuple[Float[Array, ""], Float[Array, " q"]]:
    """The largest eigenvalue of one matrix against another, and its vector over the columns."""
    scaled, scale = unit_diagonal(moments)
    ridge = 100 * float(jnp.finfo(scaled.dtype).eps)
    values, vectors = symmetric_eigen(scaled)
    # Square roots of the eigenvalues bring the moments to the unit matrix.
    root = vectors / jnp.sqrt(jnp.maximum(values, 0.0) + ridge)[None, :]
    shares, mixed = symmetric_eigen(root.T @ (noise * scale[:, None] * scale[None, :]) @ root)
    return shares[-1], scale * (root @ mixed[:, -1])


def borne_out(equations: NormalEquations) -> NormalEquations:
    """The same, with leading axes `(records, blocks)`, and no more noise than moments bear out."""
    if equations.noise is None:
        return equations
    total = equations.flattened().total()
    assert total.noise is not None
    noise, moments = jax.lax.stop_gradient((total.noise, total.moments))
    with_target = largest_share(noise, moments)[0]
    regressors = largest_share(noise[1:, 1:], moments[1:, 1:])[0]
    least = jnp.finfo(noise.dtype).tiny
    share = jnp.where(with_target > SCATTER, 1 / jnp.maximum(with_target, least), 1.0)
    share = jnp.minimum(share, MOST / jnp.maximum(regressors, least))
    of_source = None if equations.noise_of_source is None else share * equations.noise_of_source
    return equations.with_noise(share * equations.noise, of_source)


def level_covariance(
    statistics: BlockStatistics, freedom: Float[Leaf, "records sources"]
) -> Float[Array, "p p"]:
    """Covariance of the estimates because the noise's variances were themselves estimated.

    A variance with nu degrees of freedom scatters by sqrt(2 / nu) of itself, and takes with it what
    is subtracted from the scores.

    **Arguments:** `freedom` of the variances of each source.
    """
    totals = [stage.total() for stage in statistics.blocks]
    # Sources of all records, one after the other, in place of blocks.
    of_source = []
    for stage in statistics.short_blocks:
        assert stage.noise_of_source is not None
        moments = stage.noise_of_source.reshape(-1, *stage.moments.shape[-2:])
        of_source.append(NormalEquations(moments, jnp.zeros(len(moments)), stage.parameters))
    moved = scores(of_source, statistics.unknowns, statistics.values)
    moved = solve_scaled(slope(totals, statistics.unknowns), moved.T)
    spread = moved * jnp.sqrt(2 / jnp.asarray(freedom)).ravel()[None, :]
    return spread @ spread.T
