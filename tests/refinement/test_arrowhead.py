"""Steps with starts eliminated window by window, against the dense solution by NumPy."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.linear_algebra import triangular_factor
from riecjax.refinement.optimum import Linearised

ROWS = 12
stepped = eqx.filter_jit(Linearised.step)


def problem(windows, p=3, s=2, seed=0):
    """Random residuals and Jacobians of windows, and the same as one dense problem."""
    rng = np.random.default_rng(seed)
    residual = rng.normal(size=(windows, ROWS))
    by_parameter = rng.normal(size=(windows, ROWS, p)) * 10.0 ** rng.integers(-3, 4, p)
    by_start = rng.normal(size=(windows, ROWS, s)) * 10.0 ** rng.integers(-2, 3, s)
    prior, slope = rng.normal(size=p), np.abs(rng.normal(size=p))
    columns = np.concatenate([residual[:, :, None], by_parameter, by_start], axis=2)
    dense = np.zeros((windows * ROWS + p, p + windows * s))
    for w in range(windows):
        rows = slice(w * ROWS, (w + 1) * ROWS)
        dense[rows, :p] = by_parameter[w]
        dense[rows, p + w * s : p + (w + 1) * s] = by_start[w]
    dense[windows * ROWS :, :p] = np.diag(slope)
    moments = jnp.asarray(np.einsum("wri,wrj->wij", columns, columns))
    linear = Linearised(moments, jnp.asarray(prior), jnp.asarray(slope), None)
    return linear, dense, np.concatenate([residual.ravel(), prior])


@pytest.mark.parametrize("windows", [1, 2, 7])
@pytest.mark.parametrize("starts", [0, 2])
@pytest.mark.parametrize("damping", [1e-12, 0.3])
def test_a_step_is_the_dense_one(windows, starts, damping):
    linear, jacobian, residual = problem(windows, s=starts)
    step, work, damped = stepped(linear, jnp.asarray(damping))
    gram, gradient = jacobian.T @ jacobian, jacobian.T @ residual
    expected = -np.linalg.solve(gram + damping * np.diag(np.diag(gram)), gradient)
    found = np.concatenate([step.parameters, np.asarray(step.initial).ravel()])
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert float(work) == pytest.approx(-gradient @ expected, rel=1e-8)
    assert float(damped) == pytest.approx(damping * expected**2 @ np.diag(gram), rel=1e-6)
    assert float(linear.energy) == pytest.approx(residual @ residual)


def test_factors_of_windows_have_the_same_moments():
    linear, _, _ = problem(5)
    factors = np.asarray(triangular_factor(linear.moments))
    np.testing.assert_allclose(np.tril(factors, -1), 0, atol=1e-12)
    again = np.einsum("wki,wkj->wij", factors, factors)
    size = np.sqrt(np.einsum("wii->wi", np.asarray(linear.moments)))
    scale = size[:, :, None] * size[:, None, :]
    np.testing.assert_allclose(again / scale, np.asarray(linear.moments) / scale, atol=1e-12)


def test_a_silent_column_and_a_repeated_one_have_a_factor():
    columns = np.random.default_rng(1).normal(size=(9, 4))
    columns[:, 2] = 0.0
    columns[:, 3] = columns[:, 1]
    moments = columns.T @ columns
    factor = np.asarray(triangular_factor(jnp.asarray(moments)))
    assert np.all(np.isfinite(factor))
    np.testing.assert_allclose(factor.T @ factor, moments, atol=1e-10)
