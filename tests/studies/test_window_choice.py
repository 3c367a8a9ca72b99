import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from riecjax.criteria.bump import Bump
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Boxcar, Hat
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.errors import ModelError
from riecjax.estimation.identify import identify
from riecjax.models.quarter_car.equations import mass_equation, quarter_car_by_body
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.paper.reproduction import identification_record
from riecjax.records.record import Record
from riecjax.simulation.excitation import band_limited_noise
from riecjax.studies.expected_gain import expected_gain, window_gain
from riecjax.studies.window_choice import window_choice

FREQUENCY = np.array([0.0, 0.3, 1.0, 3.7, 10.0, 42.0])
WEIGHTS = {
    "boxcar": (Boxcar(), lambda t, length: 1.0),
    "hat": (Hat(), lambda t, length: length / 2 - abs(t)),
    "bump": (Bump(5), lambda t, length: (1 - (2 * t / length) ** 2) ** 5),
}


@pytest.mark.parametrize("name", WEIGHTS)
def test_gain_is_the_size_of_the_weights_fourier_integral(name):
    test_function, weight = WEIGHTS[name]
    lengths = np.array([0.07, 0.4])
    found = window_gain(FREQUENCY, lengths, test_function)
    for i, f in enumerate(FREQUENCY):
        for j, length in enumerate(lengths):
            integral, _ = scipy.integrate.quad(
                lambda t, f=f, length=length: weight(t, length) * np.cos(2 * np.pi * f * t),
                -length / 2,
                length / 2,
                limit=400,
            )
            assert found[i, j] == pytest.approx(abs(integral), rel=1e-6, abs=1e-9)


def test_a_boxcar_is_blind_at_multiples_of_its_frequency_and_the_average_is_not():
    length = np.array([0.1])
    np.testing.assert_allclose(
        window_gain(np.array([10.0, 20, 30]), length, Boxcar()), 0, atol=1e-9
    )
    frequency = np.linspace(0.5, 40, 400)
    averaged = expected_gain(frequency, 0.1, 1.0, Boxcar())
    omega = 2 * np.pi * frequency
    # Half of the envelope 2 / w or more: no drop-out (Fig. 3).
    assert np.all(averaged[frequency > 2] * omega[frequency > 2] / 2 > 0.5)


@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize(("alpha", "beta"), [(0.05, 0.5), (0.2, 0.21)])
def test_expected_gains_are_averages_over_many_lengths(alpha, beta, name, power):
    test_function, _ = WEIGHTS[name]
    frequency = np.concatenate([[0.0], np.linspace(0.1, 60, 97)])
    length = alpha + (beta - alpha) * (np.arange(20_000) + 0.5) / 20_000
    brute = np.mean(window_gain(frequency, length, test_function) ** power, axis=1)
    found = expected_gain(frequency, alpha, beta, test_function, power=power)
    np.testing.assert_allclose(found, brute, rtol=1e-4, atol=1e-6 * brute[0])


def test_gain_of_an_unknown_weight_is_refused():
    with pytest.raises(ModelError, match="not for int"):
        window_gain(FREQUENCY, np.array([0.1]), 3)  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def quarter_car():
    record = identification_record(quarter_car_source(reconstructed()), jax.random.key(0)).record
    return record.select("F_t", "x1", "x2", "x3", "x4", "v_r")


def law(alpha: float, beta: float) -> AllWindows:
    """Windows of which those of one test compile once."""
    return AllWindows(alpha, beta, longest_samples=256)


@pytest.mark.parametrize(
    ("model", "test_function"),
    [(quarter_car_by_body(), Boxcar(8)), (mass_equation(), Hat(8))],
    ids=["boxcar", "hat"],
)
def test_the_predicted_share_of_error_is_that_of_fits_at_other_lengths(
    quarter_car, model, test_function
):
    estimate = identify(model, quarter_car, RIEC(law(0.05, 0.5), test_function))
    choice = window_choice(model, quarter_car, estimate)
    for equation, stage in zip(choice.equations, estimate.stages):
        assert equation.current_share == pytest.approx(float(stage.relative_rms), rel=0.1)
    for alpha, beta in [(0.2, 0.205), (0.4, 0.405), (0.8, 0.805)]:
        fit = identify(model, quarter_car, RIEC(law(alpha, beta), test_function))
        at = [np.interp(alpha, choice.length, each.error_share) for each in choice.equations]
        np.testing.assert_allclose(at, [float(s.relative_rms) for s in fit.stages], rtol=0.12)


def test_the_quarter_car_wants_windows_longer_than_its_engine_swings(quarter_car):
    estimate = identify(quarter_car_by_body(), quarter_car, RIEC(law(0.05, 0.5), Boxcar(8)))
    choice = window_choice(quarter_car_by_body(), quarter_car, estimate)
    low, high = choice.recommended
    assert 1 / 13.3 < low < 0.25
    assert 0.3 < high < 1.0
    assert choice.seen_best == (1.0, 10.0)
    assert "shorter ones are ruled out by masses" in choice.reason
    assert "longer ones are ruled out by tyre" in choice.reason
    document = json.loads(json.dumps(choice.describe(), allow_nan=False))
    assert document["recommended_s"] == [low, high]
    assert document["equations"]["body"]["least_error_share"] < 0.08


def spring(disturbance) -> tuple[Equation, Record]:
    n = 12_000
    motion = np.asarray(band_limited_noise(jax.random.key(1), n, 0.005, bandwidth=10.0, rms=1.0))
    record = Record({"x": motion, "F": 4 * motion + disturbance(np.arange(n) * 0.005)}, 0.005)
    return Equation(Term("k", "x"), -Term(1.0, "F"), name="spring"), record


def test_a_fast_error_wants_long_windows_and_an_offset_short_ones():
    for disturbance, side in (
        (lambda t: np.diff(np.random.default_rng(0).normal(size=t.size + 1)), "shorter"),
        (lambda t: 0.2 + 0 * t, "longer"),
    ):
        model, record = spring(disturbance)
        choice = window_choice(model, record, {"k": 4.0}, windows=AllWindows(0.1, 0.4))
        low, high = choice.recommended
        assert f"{side} ones are ruled out by spring" in choice.reason
        assert (low > 0.1) == (side == "shorter")
        assert (high < 0.3) == (side == "longer")
        assert high >= 1.99 * low


def test_a_model_without_error_takes_any_window():
    model, record = spring(lambda t: 0 * t)
    choice = window_choice(model, record, {"k": jnp.array(4.0)}, windows=AllWindows(0.1, 0.4))
    assert choice.recommended == (pytest.approx(choice.length[0]), pytest.approx(choice.length[-1]))
    assert "nor at any other length" in choice.reason


def test_without_an_estimate_windows_must_be_given():
    model, record = spring(lambda t: 0 * t)
    with pytest.raises(ModelError, match="needs some to start from"):
        window_choice(model, record, {"k": 4.0})
