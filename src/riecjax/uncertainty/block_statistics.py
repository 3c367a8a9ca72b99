"""Block statistics: scores of blocks of time, the slope of their sum, each block's influence."""

# Stage s has the rows `[y A]` and finds the parameters theta_s, with those of earlier stages held
# at what these found. With A_s the columns of theta_s, block b contributes the score
#
#     psi_bs(theta) = A_bs^T (y_b - A_b theta),
#
# theta all parameters of all stages. The scores of all stages, psi_b = (psi_b1, psi_b2, ...), make
# one system of estimating equations, `sum_b psi_b(theta) = 0`, whose solution is the staged fit: in
# a two-step M-estimator each step's first-order condition is one equation of the stack (Newey and
# McFadden, 1994, section 6). It is linear in theta, so that its slope
#
#     J = -d/dtheta sum_b psi_b,   rows of stage s: A_s^T A,
#
# is exact and constant. J is block triangular: a stage's score depends on what earlier stages
# found, and not the other way round. The blocks below the diagonal carry what is uncertain in the
# masses into the stiffness that is found with them; least squares' covariance of one stage leaves
# them out.
#
# If block b counts with weight w_b, then `d theta / d w_b = J^-1 psi_b` at w = 1: the block's
# influence u_b. Where blocks are independent, `cov(theta) = J^-1 (sum psi_b psi_b^T) J^-T = sum u_b
# u_b^T`, the sandwich A^-1 B A^-T; all that follows differs in how it estimates the middle. No
# model of the errors enters: they may be autocorrelated within a block and of any size in each.

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from riecjax.linear_algebra import solve_scaled
from riecjax.summaries.blocks import ShortBlocks, blocks_in_use, merge_blocks, sum_blocks
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.block_length import block_length, politis_white

Unknowns = list[tuple[int, tuple[str, ...]]]
"""Place of each stage that finds something, and the parameters it finds."""


class BlockStatistics(NamedTuple):
    """All that covariances and intervals are computed from.

    **Fields:**

    - `unknowns`, `known`, `values`: what each stage finds, what is given, everything by name.
    - `length`: seconds to a block; `used`, how many blocks each record is cut into.
    - `blocks`: normal equations of each stage, `MOST_BLOCKS` blocks of each record along the
      leading axis, of which those beyond `used` are empty; `influence` of each.
    - `short`: the short blocks of time that these are made of; `short_blocks`, their normal
      equations, leading axes `(records, short blocks)`, and `short_influence`.
    """

    unknowns: Unknowns
    known: dict[str, Array]
    values: dict[str, Array]
    length: Float[Array, ""]
    used: Int[Array, " records"]
    blocks: list[NormalEquations]
    influence: Float[Array, "blocks p"]
    short: ShortBlocks
    short_blocks: list[NormalEquations]
    short_influence: Float[Array, "records short p"]

    @property
    def estimate(self) -> Float[Array, " p"]:
        """The values of what is found, in order."""
        return as_vector(self.unknowns, self.values)


def block_statistics(
    stages: Sequence[NormalEquations],
    known: Mapping[str, Array],
    values: Mapping[str, Array],
    short: ShortBlocks,
    longest_window: Float[Array, ""],
) -> BlockStatistics:
    """Statistics of blocks whose length is chosen from the short blocks' influence.

    **Arguments:** `stages`, normal equations with leading axes `(records, short blocks)`;
    `values`, their solution, by name.
    """
    flat = block_influence([stage.flattened() for stage in stages], known, values)
    influence = flat.reshape(short.number.shape[0], -1, flat.shape[-1])
    length = block_length(short, longest_window, politis_white(influence, short))
    used = blocks_in_use(short, length)
    blocks = [merge_blocks(stage, short, used) for stage in stages]
    return BlockStatistics(
        unknowns_of(blocks, known),
        dict(known),
        dict(values),
        length,
        used,
        blocks,
        # Scores add up over short blocks, and so does their influence.
        sum_blocks(influence, short, used),
        short,
        list(stages),
        influence,
    )


def unknowns_of(stages: Sequence[NormalEquations], known: Mapping[str, Array]) -> Unknowns:
    """What each stage finds, given what is known beforehand."""
    found = set(known)
    unknowns = []
    for i, equations in enumerate(stages):
        names = tuple(name for name in equations.parameters if name not in found)
        if names:
            unknowns.append((i, names))
            found |= set(names)
    return unknowns


def staged_values(
    totals: list[NormalEquations],
    unknowns: Unknowns,
    known: Mapping[str, Array],
    solver: Callable[[NormalEquations], Float[Array, " p"]],
) -> dict[str, Array]:
    """Every parameter by name, from the stages' normal equations (without an axis of blocks)."""
    found = dict(known)
    for i, names in unknowns:
        found |= dict(zip(names, solver(totals[i].fix(found))))
    return found


def as_vector(unknowns: Unknowns, values: Mapping[str, Array]) -> Float[Array, " p"]:
    """The values of all unknowns, in the order in which they are found."""
    return jnp.stack([values[name] for _, names in unknowns for name in names])


def scores(
    stages: list[NormalEquations], unknowns: Unknowns, values: Mapping[str, Array]
) -> Float[Array, "blocks p"]:
    """For each block of the leading axis, the sum of regressors times residuals."""
    parts = []
    for i, names in unknowns:
        blocks = stages[i]
        own = jnp.array([blocks.parameters.index(name) for name in names])
        at = jnp.stack([jnp.asarray(values[name]) for name in blocks.parameters])
        parts.append(blocks.moment[..., own] - blocks.gram[..., own, :] @ at)
    return jnp.concatenate(parts, axis=-1)


def slope(totals: list[NormalEquations], unknowns: Unknowns) -> Float[Array, "p p"]:
    """Derivative of the scores' sum with respect to all unknowns, negated."""
    names = [name for _, found in unknowns for name in found]
    rows = []
    for i, found in unknowns:
        equations = totals[i]
        own = jnp.array([equations.parameters.index(name) for name in found])
        held = [name for name in equations.parameters if name in names]
        place = jnp.array([names.index(name) for name in held])
        source = jnp.array([equations.parameters.index(name) for name in held])
        empty = jnp.zeros((len(found), len(names)), equations.moments.dtype)
        rows.append(empty.at[:, place].set(equations.gram[own][:, source]))
    return jnp.concatenate(rows)


def block_influence(
    stages: list[NormalEquations], known: Mapping[str, Array], values: Mapping[str, Array]
) -> Float[Array, "blocks p"]:
    """How far each block of time moves each parameter of all stages, slope^-1 times its score."""
    unknowns = unknowns_of(stages, known)
    totals = [stage.total() for stage in stages]
    return solve_scaled(slope(totals, unknowns), scores(stages, unknowns, values).T).T
