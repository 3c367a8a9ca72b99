import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import riecjax as rx
from riecjax.arrays import hosted
from riecjax.criteria.criterion import Rows
from riecjax.estimation import stages
from riecjax.estimation.stages import solve
from riecjax.linear_algebra import gram_condition_limit
from riecjax.summaries.normal_equations import NormalEquations

NAMES = ("a", "b", "c")


def as_rows(A, y):
    columns = jnp.concatenate([jnp.asarray(y)[None], jnp.asarray(A).T])
    return Rows(columns, jnp.arange(columns.shape[1]), NAMES[: A.shape[1]])


@eqx.filter_jit
def by_gram(rows):
    return stages.solve(NormalEquations.of_rows(rows).total())


def solve_rows(rows):
    return stages.solve_rows(hosted(rows))


def random_problem(count=40, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3)), rng.normal(size=count)


def scaled_condition(A):
    return np.linalg.cond(A / np.linalg.norm(A, axis=0))


@pytest.mark.parametrize("solver", [by_gram, solve_rows])
def test_the_solution_and_its_conditioning_agree_with_numpy(solver):
    A, y = random_problem()
    A = A @ np.array([[1.0, 0.9, 0.0], [0.0, 0.5, 0.3], [0.0, 0.0, 1.0]])
    found = solver(as_rows(A, y))
    np.testing.assert_allclose(found.theta, np.linalg.lstsq(A, y)[0], rtol=1e-11)
    assert float(found.condition_number) == pytest.approx(scaled_condition(A), rel=1e-10)
    assert int(found.rank) == 3
    _, _, right = np.linalg.svd(A / np.linalg.norm(A, axis=0))
    assert abs(right[-1] @ np.asarray(found.weakest_direction)) == pytest.approx(1, abs=1e-10)
    units = np.array([1e6, 1.0, 1e-6])
    scaled = solver(as_rows(A * units, 1e6 * y))
    np.testing.assert_allclose(np.asarray(scaled.theta) * units, 1e6 * found.theta, rtol=1e-12)
    assert float(scaled.condition_number) == pytest.approx(float(found.condition_number), rel=1e-9)


@pytest.mark.parametrize("kind", ["collinear", "silent", "fewer rows than parameters"])
@pytest.mark.parametrize("solver", [by_gram, solve_rows])
def test_what_is_short_of_rank_names_a_direction_without_effect(solver, kind):
    A, y = random_problem(2 if kind == "fewer rows than parameters" else 40)
    if kind == "collinear":
        A[:, 2] = 1e4 * (A[:, 0] - A[:, 1])
    if kind == "silent":
        A[:, 1] = 0.0
    found = solver(as_rows(A, y))
    assert int(found.rank) == 2
    # A Gram matrix shows no singular value below sqrt(eps) of the largest.
    assert float(found.condition_number) > 1e7
    lengths = np.maximum(np.linalg.norm(A, axis=0), 1e-9)
    direction = np.asarray(found.weakest_direction)
    assert np.linalg.norm(direction) == pytest.approx(1)
    np.testing.assert_allclose(A / lengths @ direction, 0, atol=1e-6)
    # Of all solutions, the one of least norm in scaled columns.
    least = np.linalg.lstsq(A / lengths, y, rcond=1e-9)[0] / lengths
    np.testing.assert_allclose(found.theta, least, rtol=1e-6, atol=1e-15)


def nearly_collinear(gap, count=200):
    """Two regressors that differ by `gap`, and the exact answer 1, 2."""
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(2, count))
    y = x + gap * y
    return {"x": x, "y": y, "u": x + 2 * y}


def test_rows_are_far_more_accurate_than_the_gram_matrix_where_columns_nearly_agree():
    signals = nearly_collinear(1e-6)
    rows = as_rows(np.stack([signals["x"], signals["y"]], axis=1), signals["u"])
    gram, direct = (
        np.abs(np.asarray(solver(rows).theta) - [1, 2]).max() for solver in (by_gram, solve_rows)
    )
    # eps cond is 3e-10, eps cond^2 is 4e-4.
    assert direct < 1e-8
    assert gram > 1e3 * direct


TWO = rx.Equation(rx.Term(1.0, "u"), -rx.Term("a", "x"), -rx.Term("b", "y"), name="shaft")


@pytest.mark.raises_finding("ill_conditioned")
def test_identify_turns_to_rows_where_the_gram_matrix_no_longer_serves():
    gap = 1e-7
    assert 1 / gap > gram_condition_limit(jnp.dtype(jnp.float64))
    record = rx.Record.from_samples(nearly_collinear(gap), time_step=0.1)
    found = rx.identify(TWO, record, rx.DOLS())
    np.testing.assert_allclose(found.theta, [1, 2], rtol=1e-6)
    assert int(found.rank) == 2
    finding = next(f for f in found.findings() if f.code == "ill_conditioned")
    assert finding.message.endswith("is 0.71 a - 0.71 b.")


def test_derivatives_of_the_solution_agree_with_finite_differences_to_second_order():
    A, y = random_problem(count=8)

    @jax.jit
    def theta(columns):
        return by_gram(Rows(columns, jnp.arange(8), NAMES)).theta

    check_grads(theta, (as_rows(A, y).columns,), order=2, rtol=1e-5, atol=1e-6)


def test_derivatives_stay_finite_and_right_where_the_rank_is_deficient():
    A, y = random_problem()
    A[:, 2] = A[:, 1]

    def theta(y):
        return by_gram(as_rows(A, y)).theta

    # theta is linear in y, so its derivative along y is theta itself.
    value, slope = jax.jvp(theta, (jnp.array(y),), (jnp.array(y),))
    np.testing.assert_allclose(slope, value, rtol=1e-9)
    gradient = jax.jacrev(theta)(jnp.array(y))
    # The Gram matrix holds this inverse to about eps cond^2 of its nonzero part.
    np.testing.assert_allclose(gradient, np.linalg.pinv(A), rtol=1e-9, atol=1e-10)


def test_numbers_that_are_not_finite_pass_through_one_lane_of_a_batch_only():
    A, y = random_problem()
    good = as_rows(A, y).columns
    batch = jnp.stack([good, good.at[0, 3].set(jnp.nan)])
    theta = jax.vmap(lambda c: by_gram(Rows(c, jnp.arange(40), NAMES)).theta)(batch)
    np.testing.assert_allclose(theta[0], np.linalg.lstsq(A, y)[0], rtol=1e-11)
    assert np.isnan(theta[1]).all()


@pytest.mark.parametrize(("platform", "operand"), [("cpu", "3x3"), ("cuda", "30x3x3")])
def test_only_a_cpu_takes_the_matrices_of_a_batch_one_by_one(platform, operand):
    """Two calls of LAPACK at once wait for each other for ever on a machine of two cores."""
    moments = jnp.broadcast_to(jnp.eye(4) + 0.1, (30, 4, 4))

    def theta(moments):
        return solve(NormalEquations(moments, jnp.asarray(9.0), ("a", "b", "c"))).theta

    traced = jax.jit(jax.vmap(theta)).trace(moments)
    program = traced.lower(lowering_platforms=(platform,)).as_text()
    assert re.findall(r"@\w+syevd_ffi.*: \(tensor<(\w+)xf64>\)", program) == [operand]
    assert ("stablehlo.while" in program) == (platform == "cpu")
    np.testing.assert_allclose(jax.vmap(theta)(moments)[4], theta(moments[4]), rtol=1e-12)
