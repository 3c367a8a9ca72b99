"""Small dense linear algebra: scaling, elimination in bulk, eigenvalues, triangular factors.

Matrices here have as many rows as a model has parameters, and there may be thousands of them.
"""

# Rounding. All solves scale a symmetric matrix G to D G D with a diagonal of ones first. It makes
# results independent of units, and among diagonal scalings it comes within a factor of p of the
# least condition number of a p x p matrix (van der Sluis, 1969). With normal equations, G = A^T A:
# singular values s of the scaled rows appear as s^2. G is rounded at eps, so that s below sqrt(eps)
# cannot be told from zero, and theta carries a relative error of about eps cond(A)^2. Rows, or
# their triangular factor R (A = Q R), carry eps cond(A). Normal equations are what adds up over
# blocks, records and machines; so they are used wherever that error is small, and
# `gram_condition_limit` says where.

import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.leaves import Leaf


def unit_scale(diagonal: Float[Leaf, "*batch p"]) -> Float[Array, "*batch p"]:
    """Factors that bring a matrix with this diagonal to a diagonal of ones, on either side.

    Parameters may differ by ten powers of ten. 1 where the diagonal is zero.
    """
    size = abs(diagonal)
    return xp.where(size > 0, 1 / xp.sqrt(xp.where(size > 0, size, 1.0)), 1.0)


def unit_diagonal(
    matrix: Float[Any, "*batch p p"],
) -> tuple[Float[Array, "*batch p p"], Float[Array, "*batch p"]]:
    """The matrix scaled to a diagonal of ones, and the factors, see [`unit_scale`][]."""
    scale = unit_scale(xp.diagonal(matrix, axis1=-2, axis2=-1))
    return matrix * scale[..., :, None] * scale[..., None, :], scale


def solve_scaled(
    matrix: Float[Array, "*batch p p"], right: Float[Array, "*batch p k"], ridge: float = 0.0
) -> Float[Array, "*batch p k"]:
    """matrix^-1 right, by elimination once the matrix has a diagonal of ones (plus `ridge`).

    Rows and columns of a Gram matrix have the units of its parameters, whose sizes would else
    decide what is rounded away. A ridge keeps one that nothing depends on from a division by zero.
    """
    scaled, scale = unit_diagonal(matrix)
    if ridge:
        identity = np.eye(scaled.shape[-1], dtype=scaled.dtype)
        scaled = scaled + ridge * identity.reshape((1,) * (scaled.ndim - 2) + identity.shape)
    right = xp.broadcast_to(right, (*matrix.shape[:-1], right.shape[-1]))
    return scale[..., :, None] * eliminate(scaled, scale[..., :, None] * right)


def eliminate(
    matrix: Float[Array, "*batch p p"], right: Float[Array, "*batch p k"]
) -> Float[Array, "*batch p k"]:
    """matrix^-1 right, see [`eliminate_with_pivots`][]."""
    return eliminate_with_pivots(matrix, right)[0]


def eliminate_with_pivots(
    matrix: Float[Array, "*batch p p"], right: Float[Array, "*batch p k"]
) -> tuple[Float[Array, "*batch p k"], Float[Array, "*batch p"]]:
    """matrix^-1 right by Gauss and Jordan's elimination, and its pivots, which are not exchanged.

    For matrices whose leading blocks are positive definite, which need no exchange; scale them to a
    diagonal of ones first (see [`solve_scaled`][]). The pivots are then the shares of each column's
    square that those before it do not explain. Thousands of small matrices go through it together,
    in vector instructions, where LAPACK is called once for each.
    """
    size = matrix.shape[-1]
    right = xp.broadcast_to(right, (*matrix.shape[:-1], right.shape[-1]))
    table = xp.concatenate([matrix, right], axis=-1)
    if xp.is_traced(table):

        def step(table: Array, k: Array) -> tuple[Array, Array]:
            pivot = table[..., k, k]
            row = table[..., k, :] / pivot[..., None]
            cleared = table - table[..., :, k][..., None] * row[..., None, :]
            return cleared.at[..., k, :].set(row), pivot

        table, pivots = jax.lax.scan(step, table, np.arange(size))
        return table[..., size:], xp.moveaxis(pivots, 0, -1)
    count = math.prod(table.shape[:-2])
    # Matrices side by side in memory, so that each operation runs along all of them; columns that
    # are done are not touched again.
    table = np.ascontiguousarray(np.moveaxis(table.reshape(count, *table.shape[-2:]), 0, -1))
    pivots = np.empty((size, table.shape[-1]))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k in range(size):
            pivots[k] = table[k, k]
            row = table[k, k + 1 :] / pivots[k]
            table[:, k + 1 :] -= table[:, k, None] * row
            table[k, k + 1 :] = row
    solved = np.moveaxis(table[:, size:], -1, 0)
    return solved.reshape(right.shape), pivots.T.reshape(right.shape[:-1])


def solve_few(matrix: Float[Array, "p p"], right: Float[Array, " p"]) -> Float[Array, " p"]:
    """matrix^-1 right of any small matrix: up to 3 x 3 by Cramer's rule.

    A library call in every stage of every step of a simulation made the quarter car's three
    equations eight times slower. Cramer's rule is not backward stable, which costs digits only
    where the matrix is ill-conditioned; the coupling of a few masses is not.
    """
    count = right.shape[0]
    if count > 3:
        return xp.linalg.solve(matrix, right)
    columns = [[matrix[i, j] for i in range(count)] for j in range(count)]
    known = [right[i] for i in range(count)]
    replaced = ([*columns[:j], known, *columns[j + 1 :]] for j in range(count))
    return xp.stack([_determinant(c) for c in replaced]) / _determinant(columns)


def _determinant(columns: list[list[Array]]) -> Array:
    """Of the small matrix with these columns, by the minors of its first one."""
    first, *others = columns
    if not others:
        return first[0]
    minors = ([[*c[:i], *c[i + 1 :]] for c in others] for i in range(len(first)))
    terms = [entry * _determinant(minor) for entry, minor in zip(first, minors)]
    return sum(terms[2::2], start=terms[0]) - sum(terms[3::2], start=terms[1])


def symmetric_eigen(matrix: Float[Array, "p p"]) -> tuple[Float[Array, " p"], Float[Array, "p p"]]:
    """Eigenvalues of a symmetric matrix, least first, and eigenvectors in columns.

    NaN of a matrix that is not finite. Under vmap, a CPU takes one matrix at a time; other devices
    take them all at once.
    """
    if not xp.is_traced(matrix):
        if not np.isfinite(matrix).all():
            return np.full(len(matrix), np.nan), np.full(np.shape(matrix), np.nan)
        return _eigen(matrix)
    return jax.lax.platform_dependent(matrix, cpu=_one_by_one, default=_eigen)


def _eigen(matrix: Float[Array, "p p"]) -> tuple[Float[Array, " p"], Float[Array, "p p"]]:
    values, vectors = xp.linalg.eigh(matrix)
    return values, vectors


# LAPACK's batched calls wait for threads of the pool that they run on: two at once, on a machine of
# two cores, wait for each other for ever (jaxlib 0.10.2).
_one_by_one = jax.custom_batching.sequential_vmap(_eigen)

Factor = Float[np.ndarray, "columns columns"]


def factor_of_gram(gram: Float[Array | np.ndarray, "columns columns"]) -> Factor:
    """A triangular factor of which this is the square, to half of its digits (not under jit).

    By eigenvalues: gram = V diag(s^2) V^T is the square of diag(s) V^T, whose QR is triangular.
    Cholesky's factor would fail where rounding has left an eigenvalue below zero. Columns are first
    brought to unit length, so that rounding of a large one does not cover a small one. Zero for a
    column that is, and NaN throughout where the square is not finite.
    """
    if not np.isfinite(gram).all():
        return np.full(np.shape(gram), np.nan)
    lengths = np.sqrt(np.maximum(np.diagonal(gram), 0.0))
    inverse = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
    squares, vectors = np.linalg.eigh(inverse[:, None] * np.asarray(gram) * inverse)
    return _factor(np.sqrt(np.maximum(squares, 0.0))[:, None] * vectors.T) * lengths


def joined_factor(factors: Sequence[Float[Leaf, "columns columns"]]) -> Factor:
    """The triangular factor of all rows that these are the factors of (not under jit)."""
    return _factor(np.concatenate([np.asarray(one) for one in factors]))


def _factor(rows: Float[np.ndarray, "rows columns"]) -> Factor:
    """A triangular factor without a negative number on its diagonal, filled up with zeros."""
    size = rows.shape[1]
    if not np.isfinite(rows).all():
        return np.full((size, size), np.nan)
    factor = np.linalg.qr(rows, mode="r")
    signed = np.where(np.diagonal(factor) < 0, -1.0, 1.0)[:, None] * factor
    return np.pad(signed, [(0, size - len(factor)), (0, 0)])


def triangular_factor(moments: Float[Array, "*batch n n"]) -> Float[Array, "*batch n n"]:
    """Upper triangle R with R^T R = moments, to rounding; zero for a column that is."""
    n, diagonal = moments.shape[-1], xp.diagonal(moments, axis1=-2, axis2=-1)
    size = xp.maximum(diagonal, 0.0)
    scale = unit_scale(size)
    # Columns that explain one another would leave a pivot of rounding, of either sign.
    rounding = 8 * n * xp.finfo(moments.dtype).eps
    identity = np.eye(n, dtype=moments.dtype).reshape((1,) * (moments.ndim - 2) + (n, n))
    scaled = moments * scale[..., :, None] * scale[..., None, :] + rounding * identity
    factor = xp.swapaxes(xp.linalg.cholesky(scaled), -1, -2)
    return xp.sqrt(size)[..., None, :] * factor


def gram_condition_limit(dtype: np.dtype) -> float:
    """Condition number of rows past which their Gram matrix no longer serves.

    It keeps the error of eps cond^2 in theta below 1e-5 in 64-bit (cond 2e5) and below 1e-2 in
    32-bit (cond 290).
    """
    eps = float(xp.finfo(dtype).eps)
    return ((1e-5 if eps < 1e-10 else 1e-2) / eps) ** 0.5


def gram_suffices(gram: Float[Any, "p p"]) -> bool:
    """Whether a Gram matrix is conditioned well enough to be solved (not under jit)."""
    squares = np.linalg.eigvalsh(unit_diagonal(gram)[0])
    return bool(squares[0] * gram_condition_limit(gram.dtype) ** 2 > squares[-1])
