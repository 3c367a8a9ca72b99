"""What structures leave of folds that they were not fitted to, held against the rows themselves."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from riecjax.discovery.search import Folds
from riecjax.summaries.normal_equations import NormalEquations


def folds_of(rows: np.ndarray, count: int, noise: np.ndarray | None = None) -> Folds:
    """Folds of rows `(n, 1 + p)`, the target first."""
    parts = np.array_split(rows, count)
    samples = np.stack([part.T @ part for part in parts])
    names = tuple("abcdefgh"[: rows.shape[1] - 1])
    motion = samples if noise is None else samples - noise
    return Folds(samples, motion, names)


@pytest.fixture
def rows() -> np.ndarray:
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((400, 3)) * [1.0, 100.0, 0.01]
    target = columns @ [2.0, 0.03, 0.0] + 0.5 * rng.standard_normal(400)
    return np.column_stack([target, columns])


def test_what_is_left_is_that_of_rows_that_were_left_out(rows):
    found = folds_of(rows, 8).left(("a", "c"))
    for number, part in enumerate(np.array_split(rows, 8)):
        others = np.concatenate([p for i, p in enumerate(np.array_split(rows, 8)) if i != number])
        theta = np.linalg.lstsq(others[:, [1, 3]], others[:, 0], rcond=None)[0]
        left = np.sum((part[:, 0] - part[:, [1, 3]] @ theta) ** 2)
        assert found.samples[number] == pytest.approx(left, rel=1e-9)
        assert found.motion[number] == pytest.approx(left, rel=1e-9)


def test_noise_is_taken_off_columns_before_they_are_fitted_and_off_what_is_left():
    """Of a column with noise of its own size, least squares find half."""
    rng = np.random.default_rng(1)
    signal = rng.standard_normal(40000)
    rows = np.column_stack([3 * signal, signal + rng.standard_normal(signal.size)])
    noise = np.diag([0.0, signal.size / 10])
    found = folds_of(rows, 10, noise)
    assert folds_of(rows, 10).fitted(("a",))[0] == pytest.approx(1.5, rel=0.03)
    assert found.fitted(("a",))[0] == pytest.approx(3.0, rel=0.03)
    left = found.left(("a",))
    assert abs(left.motion.sum()) < 0.03 * found.energy
    assert left.samples.sum() == pytest.approx(9 * signal.size, rel=0.05)


def test_folds_are_of_whole_blocks_and_empty_blocks_are_in_none():
    moments = np.arange(2 * 6, dtype=float).reshape(2, 6, 1, 1) * np.ones((2, 2))
    count = np.ones((2, 6))
    count[1, 4:] = 0
    moments[1, 4:] = np.nan
    found = Folds.of(NormalEquations(jnp.asarray(moments), jnp.asarray(count), ("a",)), most=5)
    blocks = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
    assert found.samples[:, 0, 0].tolist() == [sum(blocks[2 * i : 2 * i + 2]) for i in range(5)]
    assert found.number == 5


@pytest.mark.parametrize("apart", [True, False])
def test_columns_that_are_nearly_one_are_not_told_apart(rows, apart):
    double = rows[:, 1] + (0.1 if apart else 1e-5) * rows[:, 2] / 100
    found = folds_of(np.column_stack([rows, double]), 8)
    assert found.told_apart(("a", "d")) == apart
    assert not found.told_apart(("a", "b", "c", "d")) or apart


@pytest.mark.parametrize("decay", [0.0, 6.0])
def test_chance_is_uniform_of_columns_that_explain_nothing(decay):
    """Also where nearly all of the motion is in one of the folds."""
    rng = np.random.default_rng(2)
    size = np.exp(-decay * np.linspace(0, 1, 400))[:, None]
    chances = []
    for _ in range(1000):
        columns = size * rng.standard_normal((400, 3))
        target = columns[:, 0] + 0.3 * rng.standard_normal(400)
        chances.append(folds_of(np.column_stack([target, columns]), 20).chance(("a", "b"), "b"))
    # Where energy is in few folds the larger of two variances is taken, which is cautious.
    assert np.mean(np.less(chances, 0.05)) < 0.075
    assert np.mean(np.less(chances, 0.001)) < 0.005
    if not decay:
        assert scipy.stats.kstest(chances, "uniform").pvalue > 1e-3
