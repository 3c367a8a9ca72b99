import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria.criterion import DOLS
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.uncertainty.covariances import record_inflation
from riecjax.uncertainty.intervals import Sandwich

EQUATION = Equation(Term("k", "x"), -Term(1.0, "f"))


def records(stiffness, seed, noise=0.5, count=2000):
    rng = np.random.default_rng(seed)
    made = []
    for k in stiffness:
        x = rng.normal(size=count)
        f = k * x + noise * rng.normal(size=count)
        made.append(Record.from_samples({"x": x, "f": f}, time_step=0.01))
    return made


@pytest.mark.slow
def test_alike_recordings_are_left_alone_but_for_one_in_a_hundred():
    factors = []
    for seed in range(150):
        estimate = identify(EQUATION, records([3.0] * 4, seed), DOLS(), intervals=Sandwich())
        factors.append(float(estimate.inflation[0]))
    assert np.mean(np.array(factors) > 1) < 0.05


@pytest.mark.slow
def test_recordings_of_different_machines_widen_the_interval_until_it_holds_their_mean():
    rng = np.random.default_rng(0)
    inside = inflated = 0
    for seed in range(60):
        measured = records(3 + 0.3 * rng.normal(size=5), seed)
        estimate = identify(EQUATION, measured, DOLS(), intervals=Sandwich())
        low, high = estimate.interval("k")
        inside += low < 3.0 < high
        inflated += float(estimate.inflation[0]) > 1
    assert inflated >= 57
    assert inside >= 0.85 * 60


@pytest.mark.raises_finding("records_disagree")
def test_disagreement_is_named_in_words():
    estimate = identify(EQUATION, records([2.5, 3.0, 3.5], 0), DOLS())
    (finding,) = [f for f in estimate.findings() if f.code == "records_disagree"]
    assert "do not agree on k" in finding.message
    alike = identify(EQUATION, records([3.0] * 3, 1), DOLS())
    assert "records_disagree" not in [f.code for f in alike.findings()]


def test_one_record_has_nothing_to_disagree_with():
    influence = jax.random.normal(jax.random.key(0), (1, 10, 2))
    np.testing.assert_array_equal(record_inflation(influence, jnp.array([10])), [1, 1])


def test_the_widened_error_is_the_scatter_between_records_with_students_t():
    """Two records with blocks of no scatter of their own, by hand."""
    tiny = 1e-3 * np.array([1.0, -1.0])
    influence = np.stack([1.0 + tiny, -1.0 + tiny])[:, :, None]
    factor = float(record_inflation(jnp.asarray(influence), jnp.array([2, 2]))[0])
    # Sums of +2 and -2: variance 2/1 (4 + 4) = 16; pooled over blocks 4; t of one freedom 12.706.
    assert factor == pytest.approx(12.7062 / 1.95996 * np.sqrt(16 / 4), rel=1e-5)
