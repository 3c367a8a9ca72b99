import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria.criterion import Rows
from riecjax.errors import ModelError
from riecjax.summaries.normal_equations import NormalEquations

NAMES = ("a", "b", "c")


def random_rows(count, seed, names=NAMES):
    columns = np.random.default_rng(seed).normal(size=(1 + len(names), count))
    return Rows(jnp.array(columns), jnp.arange(count), names)


def moments(columns):
    return np.asarray(columns) @ np.asarray(columns).T


def test_normal_equations_are_the_gram_matrix_of_target_and_regressors():
    rows = random_rows(50, 0)
    equations = NormalEquations.of_rows(rows).total()
    A, y = np.asarray(rows.regressors), np.asarray(rows.target)
    np.testing.assert_allclose(equations.gram, A.T @ A, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(equations.moment, A.T @ y, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(equations.energy, y @ y, rtol=1e-13)
    assert float(equations.count) == 50


def test_adding_equals_stacking_rows():
    one, other = random_rows(50, 0), random_rows(31, 1)
    added = NormalEquations.of_rows(one).total() + NormalEquations.of_rows(other).total()
    stacked = NormalEquations.of_rows(Rows.concatenate([one, other])).total()
    np.testing.assert_allclose(added.moments, stacked.moments, rtol=1e-12, atol=1e-12)
    assert float(added.count) == 81


def test_blocks_hold_their_own_rows_and_add_up_to_the_whole():
    rows = random_rows(50, 0)
    block = np.random.default_rng(1).integers(0, 4, 50)
    blocks = NormalEquations.of_rows(rows, block_of_row=jnp.array(block), block_count=5)
    for i in range(5):
        expected = moments(rows.columns[:, block == i])
        np.testing.assert_allclose(blocks.moments[i], expected, rtol=1e-12, atol=1e-12)
        assert float(blocks.count[i]) == (block == i).sum()
    whole = NormalEquations.of_rows(rows).total()
    np.testing.assert_allclose(blocks.total().moments, whole.moments, rtol=1e-12, atol=1e-12)
    assert float(blocks.total().count) == 50


def test_equations_of_different_parameters_are_not_added():
    one = NormalEquations.of_rows(random_rows(5, 0, ("a", "b")))
    other = NormalEquations.of_rows(random_rows(5, 0, ("b", "a")))
    with pytest.raises(ModelError, match=r"different parameters cannot be added.*`embed`"):
        _ = one + other


@pytest.mark.parametrize("block_count", [1, 3])
def test_embedding_equations_equals_embedding_rows(block_count):
    rows, names = random_rows(30, 0, ("a", "b")), ("z", "b", "y", "a")
    block = jnp.arange(30) % block_count
    settings = dict(block_of_row=block, block_count=block_count)
    found = NormalEquations.of_rows(rows, **settings).embed(names)
    expected = NormalEquations.of_rows(rows.embed(names), **settings)
    np.testing.assert_allclose(found.moments, expected.moments, rtol=1e-12, atol=1e-12)
    assert found.parameters == names


def test_embedding_never_drops_a_parameter():
    with pytest.raises(ModelError, match=r"cannot leave out \['b', 'c'\]; fix them instead"):
        NormalEquations.of_rows(random_rows(5, 0)).embed(("a",))


@pytest.mark.parametrize("known", [{}, {"b": 2.0}, {"a": -1.5, "c": 1e3}, {"other": 1.0}])
def test_fixing_in_equations_equals_fixing_in_rows(known):
    rows = random_rows(30, 0)
    found = NormalEquations.of_rows(rows).fix(known)
    expected = NormalEquations.of_rows(rows.fix({k: jnp.array(v) for k, v in known.items()}))
    np.testing.assert_allclose(found.moments, expected.moments, rtol=1e-11, atol=1e-11)
    assert found.parameters == expected.parameters == tuple(n for n in NAMES if n not in known)


def test_residual_energy_equals_the_sum_of_squared_residuals():
    rows, theta = random_rows(30, 0), np.array([0.3, -2.0, 5.0])
    blocks = NormalEquations.of_rows(rows, block_of_row=jnp.arange(30) // 10, block_count=3)
    residual = np.asarray(rows.target) - np.asarray(rows.regressors) @ theta
    expected = (residual**2).reshape(3, 10).sum(1)
    np.testing.assert_allclose(blocks.residual_energy(jnp.array(theta)), expected, rtol=1e-12)


def test_residual_energy_is_never_negative():
    rows, theta = random_rows(30, 0), jnp.array([0.3, -2.0, 5.0])
    exact = Rows(rows.columns.at[0].set(theta @ rows.columns[1:]), rows.position, NAMES)
    equations = NormalEquations.of_rows(exact).total()
    energy = float(equations.residual_energy(theta))
    assert 0 <= energy < 1e-14 * float(equations.energy)
