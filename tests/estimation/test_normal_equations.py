import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from riecjax.criteria.criterion import Rows
from riecjax.errors import ModelError
from riecjax.estimation.normal_equations import NormalEquations, normal_equations
from riecjax.estimation.procedure import block_sandwich, solve_stages

NAMES = ("a", "b", "c")


def random_rows(count, seed, names=NAMES):
    columns = np.random.default_rng(seed).normal(size=(1 + len(names), count))
    return Rows(jnp.array(columns), jnp.arange(count), names)


def moments(columns):
    return np.asarray(columns) @ np.asarray(columns).T


def test_normal_equations_are_the_gram_matrix_of_target_and_regressors():
    rows = random_rows(50, 0)
    equations = normal_equations(rows).total()
    A, y = np.asarray(rows.regressors), np.asarray(rows.target)
    np.testing.assert_allclose(equations.gram, A.T @ A, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(equations.moment, A.T @ y, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(equations.energy, y @ y, rtol=1e-13)
    assert float(equations.count) == 50


def test_adding_equals_stacking_rows():
    one, other = random_rows(50, 0), random_rows(31, 1)
    added = normal_equations(one).total() + normal_equations(other).total()
    stacked = normal_equations(Rows.concatenate([one, other])).total()
    np.testing.assert_allclose(added.moments, stacked.moments, rtol=1e-12, atol=1e-12)
    assert float(added.count) == 81


def test_blocks_hold_their_own_rows_and_add_up_to_the_whole():
    rows = random_rows(50, 0)
    block = np.random.default_rng(1).integers(0, 4, 50)
    blocks = normal_equations(rows, block_of_row=jnp.array(block), block_count=5)
    for i in range(5):
        expected = moments(rows.columns[:, block == i])
        np.testing.assert_allclose(blocks.moments[i], expected, rtol=1e-12, atol=1e-12)
        assert float(blocks.count[i]) == (block == i).sum()
    whole = normal_equations(rows).total()
    np.testing.assert_allclose(blocks.total().moments, whole.moments, rtol=1e-12, atol=1e-12)
    assert float(blocks.total().count) == 50


def test_equations_of_different_parameters_are_not_added():
    one = normal_equations(random_rows(5, 0, ("a", "b")))
    other = normal_equations(random_rows(5, 0, ("b", "a")))
    with pytest.raises(ModelError, match=r"different parameters cannot be added.*`embed`"):
        _ = one + other


@pytest.mark.parametrize("block_count", [1, 3])
def test_embedding_equations_equals_embedding_rows(block_count):
    rows, names = random_rows(30, 0, ("a", "b")), ("z", "b", "y", "a")
    block = jnp.arange(30) % block_count
    settings = dict(block_of_row=block, block_count=block_count)
    found = normal_equations(rows, **settings).embed(names)
    expected = normal_equations(rows.embed(names), **settings)
    np.testing.assert_allclose(found.moments, expected.moments, rtol=1e-12, atol=1e-12)
    assert found.parameters == names


def test_embedding_never_drops_a_parameter():
    with pytest.raises(ModelError, match=r"cannot leave out \['b', 'c'\]; fix them instead"):
        normal_equations(random_rows(5, 0)).embed(("a",))


@pytest.mark.parametrize("known", [{}, {"b": 2.0}, {"a": -1.5, "c": 1e3}, {"other": 1.0}])
def test_fixing_in_equations_equals_fixing_in_rows(known):
    rows = random_rows(30, 0)
    found = normal_equations(rows).fix(known)
    expected = normal_equations(rows.fix({k: jnp.array(v) for k, v in known.items()}))
    np.testing.assert_allclose(found.moments, expected.moments, rtol=1e-11, atol=1e-11)
    assert found.parameters == expected.parameters == tuple(n for n in NAMES if n not in known)


def test_residual_energy_equals_the_sum_of_squared_residuals():
    rows, theta = random_rows(30, 0), np.array([0.3, -2.0, 5.0])
    blocks = normal_equations(rows, block_of_row=jnp.arange(30) // 10, block_count=3)
    residual = np.asarray(rows.target) - np.asarray(rows.regressors) @ theta
    expected = (residual**2).reshape(3, 10).sum(1)
    np.testing.assert_allclose(blocks.residual_energy(jnp.array(theta)), expected, rtol=1e-12)


def test_residual_energy_is_never_negative():
    rows, theta = random_rows(30, 0), jnp.array([0.3, -2.0, 5.0])
    exact = Rows(rows.columns.at[0].set(theta @ rows.columns[1:]), rows.position, NAMES)
    equations = normal_equations(exact).total()
    energy = float(equations.residual_energy(theta))
    assert 0 <= energy < 1e-14 * float(equations.energy)


# Covariance against Monte Carlo. Regressors and errors are first-order autoregressions, as
# overlapping windows make them: textbook standard errors are far too small for such data.

REPETITIONS, ROWS, BLOCKS = 1000, 2000, 40


def autoregression(key, rho, shape=()):
    """Unit-variance process of ROWS samples along the last axis."""
    noise = jax.random.normal(key, (*shape, ROWS)) * jnp.sqrt(1 - rho**2)
    first = noise[..., 0] / jnp.sqrt(1 - rho**2)

    def step(x, e):
        return rho * x + e, rho * x + e

    _, rest = jax.lax.scan(step, first, jnp.moveaxis(noise[..., 1:], -1, 0))
    return jnp.concatenate([first[..., None], jnp.moveaxis(rest, 0, -1)], axis=-1)


def in_blocks(columns, names) -> NormalEquations:
    rows = Rows(columns, jnp.arange(ROWS), names)
    return normal_equations(
        rows, block_of_row=jnp.arange(ROWS) * BLOCKS // ROWS, block_count=BLOCKS
    )


def estimate(stages):
    solutions = solve_stages(stages, {})
    theta = jnp.concatenate([stage.solution.theta for stage in solutions])
    covariance = block_sandwich(stages, solutions, {}, BLOCKS)
    textbook = [
        stage.residual_rms**2 * jnp.diagonal(jnp.linalg.inv(stages[stage.stage].total().gram))[-1]
        for stage in solutions
    ]
    return theta, covariance, jnp.stack(textbook)


TRUTH = jnp.array([2.0, -300.0])
UNITS = jnp.array([1.0, 1e-3])


def one_stage(key):
    keys = jax.random.split(key)
    x = autoregression(keys[0], 0.8, (2,))
    # Correlated regressors of unlike sizes.
    regressors = jnp.stack([x[0], 0.6 * x[0] + 0.8 * x[1]]) * UNITS[:, None]
    y = TRUTH @ regressors + autoregression(keys[1], 0.9)
    return estimate([in_blocks(jnp.stack([y, *regressors]), ("a", "b"))])


def two_stages(key):
    keys = jax.random.split(key, 3)
    x, w, v = autoregression(keys[0], 0.8, (3,))
    first = 2.0 * x + autoregression(keys[1], 0.9)
    # The second stage's own errors are small: b is uncertain because a, found before, is.
    second = 2.0 * w + 5.0 * (v + 0.7 * w) + 0.1 * autoregression(keys[2], 0.9)
    return estimate(
        [
            in_blocks(jnp.stack([first, x]), ("a",)),
            in_blocks(jnp.stack([second, w, v + 0.7 * w]), ("a", "b")),
        ]
    )


@pytest.mark.parametrize("experiment", [one_stage, two_stages])
def test_block_sandwich_covariance_agrees_with_monte_carlo(experiment):
    keys = jax.random.split(jax.random.key(0), REPETITIONS)
    theta, covariance, textbook = jax.jit(jax.vmap(experiment))(keys)
    actual = np.cov(np.asarray(theta).T)
    predicted = np.asarray(covariance).mean(0)
    # The actual variance is itself known to sqrt(2 / 1000) = 4.5 % (one sigma), and 40 blocks of
    # 50 rows lose a few percent of the correlation at their borders.
    np.testing.assert_allclose(np.diag(predicted), np.diag(actual), rtol=0.15)
    correlation, expected = (c[0, 1] / np.sqrt(c[0, 0] * c[1, 1]) for c in (predicted, actual))
    assert correlation == pytest.approx(expected, abs=0.1)
    # The textbook formula would not have passed.
    assert np.asarray(textbook).mean(0)[-1] < 0.4 * actual[-1, -1]

    truth = np.asarray(TRUTH) if experiment is one_stage else np.array([2.0, 5.0])
    errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    reach = scipy.stats.t.ppf(0.975, BLOCKS - 1)
    coverage = (np.abs(np.asarray(theta) - truth) < reach * errors).mean(0)
    assert (coverage > 0.92).all()
    assert (coverage < 0.975).all()


def test_block_sandwich_equals_the_formula_for_one_stage():
    rows = random_rows(60, 5)
    block = np.arange(60) // 6
    stages = [normal_equations(rows, block_of_row=jnp.array(block), block_count=10)]
    found = block_sandwich(stages, solve_stages(stages, {}), {}, 10)
    A, y = np.asarray(rows.regressors), np.asarray(rows.target)
    theta = np.linalg.lstsq(A, y)[0]
    scores = np.stack([A[block == i].T @ (y - A @ theta)[block == i] for i in range(10)])
    bread = np.linalg.inv(A.T @ A)
    expected = 10 / 9 * bread @ (scores.T @ scores) @ bread
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)
