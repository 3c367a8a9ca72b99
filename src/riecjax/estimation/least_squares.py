"""Linear least squares with scaled columns, and what can be said of its conditioning."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float, Int

from riecjax.criteria.rows import Rows
from riecjax.linear_algebra import symmetric_eigen, unit_diagonal, unit_scale
from riecjax.summaries.normal_equations import NormalEquations


class Solution(eqx.Module):
    """A least-squares solution.

    **Fields:**

    - `theta`: parameters, shape `(p,)`; of least norm in scaled columns where they are not unique.
    - `condition_number`: of the regressor matrix with its columns scaled to unit length.
    - `rank`: numerical rank of that matrix.
    - `weakest_direction`: unit vector over the parameters, each in units of one over its column's
      length, along which the residual changes least: the combination the data tells least about.
    """

    theta: Float[Array, " p"]
    condition_number: Float[Array, ""]
    rank: Int[Array, ""]
    weakest_direction: Float[Array, " p"]


def solve(equations: NormalEquations) -> Solution:
    """Solve normal equations (without a leading axis of blocks).

    Columns are scaled to unit length first, which makes the condition number independent of units
    and, among diagonal scalings, close to the least possible. The derivative with respect to the
    equations is the implicit one, of any order, also where the rank is deficient.
    """
    # G theta = m differentiates to G dtheta = dm - dG theta: one more solve with the same G, here
    # with its eigenvectors, which are not differentiated themselves (their derivative divides by
    # differences of eigenvalues). Where the rank is deficient, the pseudo-inverse keeps theta in
    # the range of G. lax's linear solve rather than lineax's: the latter's derivative raises on
    # numbers that are not finite, which optimisers and diverged lanes of a batch may pass through.
    gram, scale = unit_diagonal(equations.gram)
    # Rounding of the Gram matrix hides singular values of A below sqrt(eps) of the largest.
    tolerance = float(jnp.finfo(gram.dtype).eps) * gram.shape[0]
    eigenvalues, vectors = symmetric_eigen(jax.lax.stop_gradient(gram))
    valid = eigenvalues > tolerance * eigenvalues[-1]
    inverse = jnp.where(valid, 1 / jnp.where(valid, eigenvalues, 1.0), 0.0)
    theta = jax.lax.custom_linear_solve(
        lambda x: gram @ x,
        equations.moment * scale,
        lambda _, right: vectors @ (inverse * (vectors.T @ right)),
        symmetric=True,
    )
    singular_values = jnp.sqrt(jnp.maximum(eigenvalues, 0))
    return _solution(theta * scale, singular_values, vectors[:, 0], tolerance**0.5)


FACTORED = 2**13
"""Rows whose rounding a triangular factor may hold, and which decides about its rank."""


def solve_rows(rows: Rows) -> Solution:
    """Solve rows by a singular value decomposition: slower, accurate to eps times cond."""
    scale = unit_scale(jnp.sum(rows.regressors**2, axis=0))
    matrix = rows.regressors * scale[None, :]
    tolerance = float(jnp.finfo(matrix.dtype).eps) * max(*matrix.shape, FACTORED)
    theta = lx.linear_solve(
        lx.MatrixLinearOperator(matrix), rows.target, solver=lx.SVD(rcond=tolerance), throw=False
    ).value
    # With fewer rows than parameters the missing singular values are zero.
    missing = max(matrix.shape[1] - matrix.shape[0], 0)
    _, singular_values, right = jnp.linalg.svd(
        jax.lax.stop_gradient(matrix), full_matrices=missing > 0
    )
    singular_values = jnp.pad(singular_values, (0, missing))
    return _solution(theta * scale, singular_values[::-1], right[-1], tolerance)


def _solution(
    theta: Array, ascending: Float[Array, " p"], weakest: Array, tolerance: float
) -> Solution:
    largest, smallest = ascending[-1], ascending[0]
    floor = jnp.finfo(ascending.dtype).tiny
    rank = jnp.sum(ascending > tolerance * largest)
    return Solution(theta, largest / jnp.maximum(smallest, floor), rank, weakest)
