"""Integral refinement: of linear equations it is their identification, of others an expansion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from jaxtyping import Array

from nightly import nightly
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Bump, Hat
from riecjax.criteria.windows import AllWindows, RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.errors import DataError, ModelError
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.refinement.integral_error import AbstractBalance, IntegralError, as_balances, expanded
from riecjax.refinement.refine import refine
from riecjax.uncertainty.intervals import BlockBootstrap

TRUTH = {"M": 2.0, "Fv": 3.0, "Fc": 1.5, "Fs": 4.0, "vs": 0.15}
START = {"M": 1.0, "Fv": 1.0, "Fc": 1.0, "Fs": 1.0, "vs": 0.4}
UNITS = {"M": "kg", "Fv": "N s/m", "Fc": "N", "Fs": "N", "vs": "m/s"}
WIDTH = 0.02
"""Width in m/s over which the friction changes its sign."""


def friction(p, v, tanh, exp):
    rise = (p["Fs"] - p["Fc"]) * exp(-((v / p["vs"]) ** 2))
    return p["Fv"] * v + (p["Fc"] + rise) * tanh(v / WIDTH)


class Stribeck(AbstractBalance):
    """M q'' + friction(q') = F: not linear in Fs and vs together."""

    M: Array
    Fv: Array
    Fc: Array
    Fs: Array
    vs: Array

    name = "stribeck"
    unit = "N"
    units = UNITS

    def momentum(self, signals):
        return self.M * signals["dq"]

    def force(self, signals):
        values = {name: getattr(self, name) for name in TRUTH}
        return friction(values, signals["dq"], jnp.tanh, jnp.exp) - signals["F"]


class ByPosition(Stribeck):
    """The same with the inertia on the position."""

    def momentum(self, signals):  # pyright: ignore[reportIncompatibleMethodOverride]
        return None

    def first_moment(self, signals):
        return self.M * signals["q"]


def balance(kind=Stribeck, values=START):
    return kind(**{name: jnp.asarray(value) for name, value in values.items()})


def force(t):
    return 6 * np.sin(2.1 * t) + 5 * np.sin(5.3 * t + 1) + 3 * np.sin(0.7 * t)


@pytest.fixture(scope="module")
def record():
    t = np.arange(8001) / 400
    run = scipy.integrate.solve_ivp(
        lambda t, s: [s[1], (force(t) - friction(TRUTH, s[1], np.tanh, np.exp)) / TRUTH["M"]],
        (0, t[-1]),
        [0.0, 0.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    )
    signals = {"q": run.y[0], "dq": run.y[1], "F": force(t)}
    return Record.from_samples(signals, time_step=1 / 400)


LINEAR = Equation(
    Term("M", "q", derivative=2, measured=("dq", "ddq"), unit="kg"),
    Term("c", "q", derivative=1, measured=("dq",), unit="N s/m"),
    Term("k", "q", unit="N/m"),
    -Term(1.0, "F"),
    name="linear",
    unit="N",
)


@pytest.mark.parametrize(
    ("criterion", "unit"),
    [
        (RIEC(RandomWindows(0.05, 0.5, 500)), "N s"),
        *nightly(
            [
                (RIEC(AllWindows(0.05, 0.5)), "N s"),
                (RIEC(AllWindows(0.1, 1.0), Hat(4)), "N s^2"),
                (RIEC(RandomWindows(0.1, 1.0, 500), Bump(lengths=4)), "N s"),
            ]
        ),
    ],
    ids=["random", "all", "hat", "bump"],
)
def test_of_a_linear_equation_it_is_its_identification(record, criterion, unit):
    key = jax.random.key(3)
    estimate = identify(LINEAR, record, criterion, key=key, intervals=BlockBootstrap(200))
    start = {"M": 10.0, "c": -5.0, "k": 0.0}
    by = IntegralError(criterion)
    refined = refine(LINEAR, record, start, by, key=key, intervals=BlockBootstrap(200))
    assert bool(refined.search.converged)
    np.testing.assert_allclose(refined.theta, estimate.theta, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(refined.covariance, estimate.covariance, rtol=1e-3)
    assert refined.search.quantity_units == (unit,)
    assert float(refined.search.rms[0]) == pytest.approx(
        float(estimate.stages[0].residual_rms), rel=1e-6
    )


@pytest.mark.parametrize(
    ("kind", "test_function"),
    [(Stribeck, None), *nightly([(Stribeck, Hat(4)), (ByPosition, Hat(4))])],
)
def test_friction_that_is_not_linear_is_found_from_far_away(record, kind, test_function):
    windows = AllWindows(0.05, 0.5)
    by = IntegralError(RIEC(windows) if test_function is None else RIEC(windows, test_function))
    refined = refine(balance(kind), record, START, by)
    assert bool(refined.search.converged)
    assert dict(refined.units) == UNITS
    for name, true in TRUTH.items():
        # What is left is the quadrature's error, where the friction turns within some samples.
        assert float(refined[name]) == pytest.approx(true, rel=0.01)
    assert float(refined.search.rms[0]) < 0.01 * float(refined.search.rms_before[0])


def test_the_expansion_has_the_slopes_of_differences(record):
    (model,) = as_balances(balance())
    values = {name: jnp.asarray(value) for name, value in START.items()}
    equation, signals = expanded(model, record, values, ("M", "vs", "Fs"), 1)
    assert set(equation.parameters) == {"M", "vs", "Fs"}
    v = np.asarray(record["dq"])
    np.testing.assert_allclose(signals["~:1"], START["M"] * v)
    np.testing.assert_allclose(signals["~:1/M"], v)
    for name in ("vs", "Fs"):
        up, down = ({**START, name: START[name] + s * 1e-6} for s in (1, -1))
        slope = friction(up, v, np.tanh, np.exp) - friction(down, v, np.tanh, np.exp)
        np.testing.assert_allclose(signals[f"~:0/{name}"], slope / 2e-6, atol=1e-6)


class Time(AbstractBalance):
    """A momentum that a force fills which decays with time."""

    rate: Array

    def momentum(self, signals):
        return signals["p"]

    def force(self, signals):
        return -jnp.exp(-self.rate * signals["t"])


def test_time_is_a_signal():
    t = np.arange(1001) / 100
    held = Record.from_samples({"p": (1 - np.exp(-0.7 * t)) / 0.7}, time_step=0.01)
    refined = refine(Time(jnp.asarray(0.2)), held, {"rate": 0.2}, IntegralError())
    assert float(refined["rate"]) == pytest.approx(0.7, rel=1e-4)


class Crooked(Time):
    def force(self, signals):
        return jnp.zeros(3)


class Empty(AbstractBalance):
    rate: Array


@pytest.mark.parametrize(
    ("model", "error", "words"),
    [
        (Crooked(jnp.asarray(1.0)), ModelError, "one number for each"),
        (Empty(jnp.asarray(1.0)), ModelError, "needs a force, a momentum or a first moment"),
        (3.0, ModelError, "no equation of motion"),
    ],
)
def test_what_is_no_balance_is_refused(model, error, words):
    held = Record.from_samples({"p": np.arange(1001.0)}, time_step=0.01)
    with pytest.raises(error, match=words):
        refine(model, held, {"rate": 1.0}, IntegralError())


def test_an_inertia_on_the_position_needs_windows_that_take_two_derivatives(record):
    by = IntegralError(RIEC(AllWindows(0.05, 0.5)))
    with pytest.raises(DataError, match="Hat"):
        refine(balance(ByPosition), record, START, by)
