"""Small linear systems as plain arithmetic, thousands at a time."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def solve_scaled(
    matrix: Float[Array, "p p"], right: Float[Array, "p k"], ridge: float = 0.0
) -> Float[Array, "p k"]:
    """matrix^-1 right, by elimination once the matrix has a diagonal of ones (plus `ridge`).

    Rows and columns of a Gram matrix have the units of its parameters, whose sizes would else
    decide what is rounded away. A ridge keeps one that nothing depends on from a division by zero.
    """
    scale = unit_scale(jnp.diagonal(matrix))
    scaled = matrix * scale[:, None] * scale[None, :]
    if ridge:
        scaled = scaled + ridge * jnp.eye(scaled.shape[0], dtype=scaled.dtype)
    return scale[:, None] * eliminate(scaled, scale[:, None] * right)


def eliminate(matrix: Float[Array, "p p"], right: Float[Array, "p k"]) -> Float[Array, "p k"]:
    """matrix^-1 right, see [`eliminate_with_pivots`][]."""
    return eliminate_with_pivots(matrix, right)[0]


def eliminate_with_pivots(
    matrix: Float[Array, "p p"], right: Float[Array, "p k"]
) -> tuple[Float[Array, "p k"], Float[Array, " p"]]:
    """matrix^-1 right by Gauss and Jordan's elimination, and its pivots, which are not exchanged.

    For matrices whose leading blocks are positive definite, which need no exchange; scale them to a
    diagonal of ones first (see [`solve_scaled`][]). A compiler turns it into vector instructions
    over thousands of small matrices, where LAPACK is called once for each.
    """
    size = matrix.shape[0]

    def step(table: Array, k: Array) -> tuple[Array, Array]:
        row = table[k] / table[k, k]
        cleared = table - table[:, k][:, None] * row[None, :]
        return cleared.at[k].set(row), table[k, k]

    table = jnp.concatenate([matrix, right], axis=1)
    table, pivots = jax.lax.scan(step, table, jnp.arange(size))
    return table[:, size:], pivots


def unit_scale(diagonal: Float[Array, " p"]) -> Float[Array, " p"]:
    """Factors that bring a matrix with this diagonal to a diagonal of ones, on either side.

    Parameters may differ by ten powers of ten. 1 where the diagonal is zero.
    """
    size = jnp.abs(diagonal)
    return jnp.where(size > 0, 1 / jnp.sqrt(jnp.where(size > 0, size, 1.0)), 1.0)
