import jax
import numpy as np
import pytest

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows, RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import staged
from riecjax.equations.term import Term
from riecjax.errors import ModelError
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.studies.monte_carlo import seed_scatter
from riecjax.uncertainty.intervals import Naive

FIRST = Equation(Term("m", "v", derivative=1, measured=("a",)), -Term(1.0, "f"), name="first")
SECOND = Equation(
    Term("m", "v", derivative=1, measured=("a",)), Term("k", "x"), -Term(1.0, "g"), name="second"
)
MODEL = staged(FIRST, SECOND)


def record_of(n=3000):
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(n)
    x, v, a = np.sin(5 * t), 5 * np.cos(5 * t), -25 * np.sin(5 * t)
    f = 2.0 * a + rng.normal(size=n)
    return Record({"x": x, "v": v, "f": f, "g": f + 30.0 * x + rng.normal(size=n)}, 0.01)


def test_each_seed_is_the_fit_with_that_key():
    criterion, key = RIEC(RandomWindows(0.05, 0.4, 500)), jax.random.key(3)
    scatter = seed_scatter(MODEL, record_of(), criterion, key=key, seeds=5)
    assert scatter.parameters == ("m", "k")
    for one, theta in zip(jax.random.split(key, 5), scatter.theta):
        alone = identify(MODEL, record_of(), criterion, key=one, intervals=Naive())
        np.testing.assert_allclose(theta, alone.theta, rtol=1e-9)
    np.testing.assert_allclose(scatter.spread, np.std(np.asarray(scatter.theta), axis=0, ddof=1))


def test_known_values_are_not_scattered():
    criterion = RIEC(RandomWindows(0.05, 0.4, 300))
    scatter = seed_scatter(
        MODEL, record_of(), criterion, key=jax.random.key(0), known={"m": 2.0}, seeds=3
    )
    assert scatter.parameters == ("k",)


def test_what_draws_nothing_has_no_seeds():
    with pytest.raises(ModelError, match="only random windows"):
        seed_scatter(MODEL, record_of(), RIEC(AllWindows(0.05, 0.4)), key=jax.random.key(0))
    with pytest.raises(ModelError, match="at least two"):
        seed_scatter(
            MODEL, record_of(), RIEC(RandomWindows(0.05, 0.4, 9)), key=jax.random.key(0), seeds=1
        )
