import jax
import numpy as np
import pytest

import riecjax as rx
from riecjax.models.quarter_car.identification import mass_equation, quarter_car_by_body
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.paper.reproduction import identification_record
from riecjax.simulation.inputs import band_limited_noise
from riecjax.validation.choice import window_choice


@pytest.fixture(scope="module")
def quarter_car():
    record = identification_record(quarter_car_source(), jax.random.key(0)).record
    return record.select("F_t", "x1", "x2", "x3", "x4", "v_r")


def law(alpha: float, beta: float) -> rx.AllWindows:
    """Windows of which those of one test compile once."""
    return rx.AllWindows(alpha, beta, longest_samples=256)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "test_function"),
    [(quarter_car_by_body(), rx.Boxcar(8)), (mass_equation(), rx.Hat(8))],
    ids=["boxcar", "hat"],
)
def test_the_predicted_share_of_error_is_that_of_fits_at_other_lengths(
    quarter_car, model, test_function
):
    estimate = rx.identify(
        model, quarter_car, rx.RIEC(law(0.05, 0.5), test_function), intervals=rx.Naive()
    )
    choice = window_choice(model, quarter_car, estimate)
    for equation, stage in zip(choice.equations, estimate.stages):
        assert equation.current_share == pytest.approx(float(stage.relative_rms), rel=0.1)
    for alpha, beta in [(0.2, 0.205), (0.4, 0.405), (0.8, 0.805)]:
        fit = rx.identify(
            model, quarter_car, rx.RIEC(law(alpha, beta), test_function), intervals=rx.Naive()
        )
        at = [np.interp(alpha, choice.length, each.error_share) for each in choice.equations]
        np.testing.assert_allclose(at, [float(s.relative_rms) for s in fit.stages], rtol=0.12)


def spring(disturbance) -> tuple[rx.Equation, rx.Record]:
    n = 12_000
    motion = np.asarray(band_limited_noise(jax.random.key(1), n, 0.005, bandwidth=10.0, rms=1.0))
    record = rx.Record({"x": motion, "F": 4 * motion + disturbance(np.arange(n) * 0.005)}, 0.005)
    return rx.Equation(rx.Term("k", "x"), -rx.Term(1.0, "F"), name="spring"), record


def test_a_fast_error_wants_long_windows_and_an_offset_short_ones():
    for disturbance, side in (
        (lambda t: np.diff(np.random.default_rng(0).normal(size=t.size + 1)), "shorter"),
        (lambda t: 0.2 + 0 * t, "longer"),
    ):
        model, record = spring(disturbance)
        choice = window_choice(model, record, {"k": 4.0}, windows=rx.AllWindows(0.1, 0.4))
        low, high = choice.recommended
        assert f"{side} ones are ruled out by spring" in choice.reason
        assert (low > 0.1) == (side == "shorter")
        assert (high < 0.3) == (side == "longer")
        assert high >= 1.99 * low
