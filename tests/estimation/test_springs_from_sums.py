"""Springs in series with linear elements: systems solved by SciPy, found from sums."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import BODY, STANDARD, noisy
from tests.machines import LAG_MODEL as MODEL
from tests.machines import LAG_TRUTH as TRUTH
from tests.machines import body_with_lag as motion

import riecjax as rx
from riecjax.equations.hidden_elements import Expanded
from riecjax.equations.hidden_motion import with_hidden_motion
from riecjax.models.model import as_model
from riecjax.validation import equation_error


@pytest.fixture(scope="module")
def clean() -> rx.Record:
    return rx.Record(motion(), STANDARD.step)


def test_a_spring_is_found_beside_its_damper(clean):
    estimate = rx.identify(MODEL, clean)
    assert estimate.parameters == ("m", "c", "k", "K_series")
    for name, value in TRUTH.items():
        assert float(estimate[name]) == pytest.approx(value, rel=1e-3), name
    assert dict(estimate.units)["K_series"] == "N/m"
    assert "series_spring_not_carried" not in [f.code for f in estimate.findings()]
    # Without it, mass and damper make up for the lag.
    rigid = rx.identify(BODY, clean)
    assert abs(float(rigid["m"]) / TRUTH["m"] - 1) > 0.05


@pytest.mark.slow
def test_intervals_cover_at_5_percent_of_noise():
    covered = []
    for seed in range(12):
        estimate = rx.identify(
            MODEL, rx.Record(noisy(motion(seed=seed), 0.05, seed), STANDARD.step)
        )
        assert float(estimate["K_series"]) == pytest.approx(TRUTH["K_series"], rel=0.15)
        ends = [(name, estimate.interval(name)) for name in TRUTH]
        covered.append([float(low) <= TRUTH[n] <= float(high) for n, (low, high) in ends])
    # Of 12 draws of a 95 % interval fewer than 9 cover once in 430.
    assert np.sum(covered, axis=0).min() >= 9


@pytest.mark.raises_finding("series_spring_not_carried")
@pytest.mark.slow
def test_no_lag_is_no_spring():
    codes = []
    for seed in range(6):
        lagging = motion(seed=seed, series=2e7)
        estimate = rx.identify(MODEL, rx.Record(noisy(lagging, 0.05, seed), STANDARD.step))
        assert float(estimate["m"]) == pytest.approx(TRUTH["m"], rel=0.05)
        codes.append([finding.code for finding in estimate.findings()])
    assert sum("series_spring_not_carried" in of for of in codes) >= 5


def test_a_spring_that_is_known_is_no_unknown(clean):
    known = {name: TRUTH[name] for name in ("c", "K_series")}
    estimate = rx.identify(MODEL, clean, known=known)
    assert estimate.parameters == ("m", "k")
    assert float(estimate["m"]) == pytest.approx(TRUTH["m"], rel=1e-3)


def test_linearised_equations_leave_the_residual_itself():
    # By Euler's theorem: all regressors, times their parameters, are what is left beside D y.
    expanded = Expanded.of(BODY, [rx.HiddenMode("v")], [rx.SeriesSpring("c")])
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    values |= {"M_mode": jnp.asarray(2.0), "K_mode": jnp.asarray(9e4), "B_mode": jnp.asarray(50.0)}
    mix = expanded.linearised(values)
    theta = jnp.stack([jnp.asarray(1.0), *(-values[n] for n in expanded.all_parameters)])
    shapes = [names.shape(values) for names, _ in expanded.elements]
    np.testing.assert_allclose(theta @ mix, expanded.residual(values, shapes), rtol=1e-12)


def test_residual_is_the_product_of_polynomials():
    """(1 + tau s) (m s v + k x - F) + c v, written out."""
    expanded = Expanded.of(BODY, [], [rx.SeriesSpring("c")])
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    tau = TRUTH["c"] / TRUTH["K_series"]
    shapes = [names.shape(values) for names, _ in expanded.elements]
    found = dict(zip(("", *expanded.equation.parameters), expanded.residual(values, shapes)))
    # The target is F, and its derivative is a term on the equation's own side.
    expected = {"": 1.0, "m": -20.0, "c": -200.0, "k": -4000.0, "m'": -20 * tau, "k'": -4000 * tau}
    for name, value in expected.items():
        assert float(found.pop(name)) == pytest.approx(value), name
    assert float(found.pop("c'")) == 0
    assert float(found.pop("target'")) == pytest.approx(-tau)
    assert found == {}


def test_what_lags_closes_the_equation(clean):
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    (left,) = equation_error(MODEL, clean, values)
    (without,) = equation_error(BODY, clean, {n: values[n] for n in ("m", "c", "k")})
    assert float(left.relative_rms) < 0.01 < 0.1 < float(without.relative_rms)
    plain, record = with_hidden_motion(MODEL, clean, values)
    assert not plain.has_hidden
    assert "v behind K_series" in record.arrays


def test_a_model_has_its_springs():
    model = as_model(BODY).with_series_springs(rx.SeriesSpring("c"))
    assert [(q.name, q.unit) for q in model.parameters][-1] == ("K_series", "N/m")
    assert model.build_procedure().springs == (rx.SeriesSpring("c"),)


def test_what_cannot_be_asked(clean):
    with pytest.raises(rx.ModelError, match="no equation has a coefficient 'd'"):
        rx.staged(BODY).with_series_springs(rx.SeriesSpring("d"))
    with pytest.raises(rx.ModelError, match="has a spring in series already"):
        MODEL.with_series_springs(rx.SeriesSpring("c"))
    with pytest.raises(rx.ModelError, match="known only where c is"):
        rx.identify(MODEL, clean, known={"K_series": 1e4})
    with pytest.raises(rx.ModelError, match="takes 2 derivatives off"):
        rx.identify(MODEL, clean, rx.RIEC(rx.AllWindows(0.05, 0.5)))
    with pytest.raises(rx.ModelError, match="per_record"):
        rx.identify(MODEL, [clean, clean], per_record=["k"])
    damper = rx.Terms("F", rx.roof([-1.0, 0.0, 1.0]), "v")
    mapped = rx.Equation(BODY.terms[0], damper, -rx.Term(1.0, "F"), name="mapped")
    procedure = rx.staged(mapped).with_series_springs(rx.SeriesSpring("F_1"))
    with pytest.raises(rx.ModelError, match=r"rx\.refine"):
        rx.identify(procedure, clean)
    with pytest.raises(rx.ModelError, match="behind its spring"):
        equation_error(procedure, clean, dict.fromkeys(procedure.parameters, 1.0))
    with pytest.raises(rx.ModelError, match=r"refine by rx\.OutputError"):
        rx.refine(MODEL, clean, dict(TRUTH), rx.IntegralError())
