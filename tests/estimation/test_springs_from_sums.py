"""Springs in series with linear elements: systems solved by SciPy, found from sums."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import BODY, STANDARD, noisy
from tests.machines import LAG_MODEL as MODEL
from tests.machines import LAG_TRUTH as TRUTH
from tests.machines import body_with_lag as motion

import riecjax as rx
from riecjax.equations.element_motion import with_element_motion
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
    held = {name: TRUTH[name] for name in ("c", "K_series")}
    known = rx.identify(MODEL, clean, known=held, intervals=rx.Naive())
    assert known.parameters == ("m", "k")
    assert float(known["m"]) == pytest.approx(TRUTH["m"], rel=1e-3)
    # Without it, mass and damper make up for the lag.
    rigid = rx.identify(BODY, clean, intervals=rx.Naive())
    assert abs(float(rigid["m"]) / TRUTH["m"] - 1) > 0.05


@pytest.mark.slow
def test_a_spring_and_a_mode_are_found_together():
    mode = {"M_mode": 6.0, "K_mode": 21000.0, "B_mode": 120.0}
    record = rx.Record(motion(mode=tuple(mode.values())), STANDARD.step)
    estimate = rx.identify(MODEL.with_elements(rx.HiddenMode("v")), record)
    assert estimate.parameters == ("m", "c", "k", *mode, "K_series")
    for name, value in (TRUTH | mode).items():
        assert float(estimate[name]) == pytest.approx(value, rel=0.01), name


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


def test_what_lags_closes_the_equation(clean):
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    (left,) = equation_error(MODEL, clean, values)
    (without,) = equation_error(BODY, clean, {n: values[n] for n in ("m", "c", "k")})
    assert float(left.relative_rms) < 0.01 < 0.1 < float(without.relative_rms)
    plain, record = with_element_motion(MODEL, clean, values)
    assert not plain.has_hidden
    assert "v behind K_series" in record.arrays


def test_what_cannot_be_asked(clean):
    with pytest.raises(rx.ModelError, match="no equation has a coefficient 'd'"):
        rx.staged(BODY).with_elements(rx.SeriesSpring("d"))
    with pytest.raises(rx.ModelError, match="has a spring in series already"):
        MODEL.with_elements(rx.SeriesSpring("c"))
    with pytest.raises(rx.ModelError, match="known only where c is"):
        rx.identify(MODEL, clean, known={"K_series": 1e4})
    with pytest.raises(rx.ModelError, match="takes 2 derivatives off"):
        rx.identify(MODEL, clean, rx.RIEC(rx.AllWindows(0.05, 0.5)))
    with pytest.raises(rx.ModelError, match="per_record"):
        rx.identify(MODEL, [clean, clean], per_record=["k"])
    damper = rx.Terms("F", rx.roof([-1.0, 0.0, 1.0]), "v")
    mapped = rx.Equation(BODY.terms[0], damper, -rx.Term(1.0, "F"), name="mapped")
    model = rx.staged(mapped).with_elements(rx.SeriesSpring("F_1"))
    with pytest.raises(rx.ModelError, match=r"rx\.refine"):
        rx.identify(model, clean)
    with pytest.raises(rx.ModelError, match="behind its spring"):
        equation_error(model, clean, dict.fromkeys(model.parameter_names, 1.0))
    with pytest.raises(rx.ModelError, match=r"refine by rx\.OutputError"):
        rx.refine(MODEL, clean, dict(TRUTH), rx.IntegralError())
