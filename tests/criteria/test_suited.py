"""The criterion that a model and what was recorded of its motion call for."""

import jax
import numpy as np
import pytest
from tests.machines import MACHINES, SHORT, noisy

import riecjax as rx
from riecjax.criteria.suited import suited
from riecjax.equations.model import as_model

STEP = 0.01
TIME = STEP * np.arange(2000)
SIGNALS = {"x": np.sin(TIME), "v": np.cos(TIME), "u": np.cos(3 * TIME)}
OSCILLATOR = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v", "a")), rx.Term("k", "x"), -rx.Term(1.0, "u")
)
FIRST_ORDER = rx.Equation(rx.Term("c", "x", derivative=1), rx.Term("k", "x"), -rx.Term(1.0, "u"))


def chosen(equation, record, band=None):
    return suited(as_model(equation), band, [record])


@pytest.mark.parametrize(
    ("equation", "names"), [(OSCILLATOR, ("x", "v", "u")), (FIRST_ORDER, ("x", "u"))]
)
def test_where_boxcars_read_what_was_recorded_they_stay(equation, names):
    record = rx.Record({name: SIGNALS[name] for name in names}, STEP)
    usual, found = rx.RIEC.of_band((1.0, 10.0)), chosen(equation, record)
    assert found.describe() == usual.describe()


@pytest.mark.parametrize("made", [False, True])
def test_a_velocity_that_no_sensor_measured_is_left_out(made):
    noise = rx.Noise.given({"x": 0.01})
    record = rx.Record({"x": SIGNALS["x"], "u": SIGNALS["u"]}, STEP).with_noise(noise)
    if made:
        record = rx.differentiate(record, "x", "v")
    found = chosen(OSCILLATOR, record)
    assert isinstance(found.test_function, rx.Bump)
    assert "no sensor measured v" in found.why
    assert float(found.windows.alpha) == pytest.approx(0.5)
    assert float(found.windows.beta) == pytest.approx(2.0)


def test_a_velocity_that_a_model_says_how_to_derive_is_formed():
    machine = MACHINES["linear"]
    record = machine.record().select("x", "u")
    inertia, damper = rx.Term("m", "x", derivative=2), rx.Term("c", "dx")
    equation = rx.Equation(inertia, damper, rx.Term("k", "x"), -rx.Term(1.0, "u"))
    with pytest.raises(rx.DataError, match="no signal 'dx'"):
        rx.identify(equation, record)
    model = rx.Model(stages=equation, derived={"dx": "x"})
    for name, value in rx.identify(model, record, intervals=rx.Naive()).values.items():
        assert float(value) == pytest.approx(machine.truth[name], rel=0.02)


def test_bumps_hold_enough_samples_and_fit_into_a_short_record():
    for step, count in ((0.1, 2000), (0.01, 300), (0.02, 150)):
        time = step * np.arange(count)
        record = rx.Record({"x": np.sin(time), "u": np.cos(time)}, step)
        windows = chosen(OSCILLATOR, record).windows
        alpha, beta = float(windows.alpha), float(windows.beta)
        assert 12 * step <= alpha * (1 + 1e-9)
        assert 2 * alpha <= beta * (1 + 1e-9)
        assert beta <= max(0.2 * record.duration, 24 * step) * (1 + 1e-9)


def test_it_may_be_asked_for_inside_of_jit():
    @jax.jit
    def mass(x, u):
        record = rx.Record({"x": x, "u": u}, STEP)
        return rx.identify(OSCILLATOR, record, intervals=rx.Naive()).theta[0]

    truth, signals = MACHINES["linear"].truth, MACHINES["linear"].signals(shape=SHORT)
    force = signals["u"] - truth["c"] * np.gradient(signals["x"], STEP)
    assert float(mass(signals["x"], force)) == pytest.approx(truth["m"], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_it_is_about_as_good_as_the_best_of_those_chosen_by_hand(noise):
    """Of an oscillator of which the position alone was recorded, over draws of its noise."""
    machine, truth = MACHINES["linear"], MACHINES["linear"].truth
    exact = {name: values for name, values in machine.signals().items() if name in ("x", "u")}
    by_hand = [
        rx.RIEC(rx.AllWindows(alpha, beta), function)
        for function in (rx.Hat(), rx.Bump(lengths=8))
        for alpha, beta in ((0.06, 0.5), (0.25, 1.0), (0.5, 2.0), (1.0, 4.0))
    ]

    def error(criterion):
        records = [
            rx.Record(noisy(exact, {"x": noise}, seed), machine.shape.step) for seed in range(12)
        ]
        fits = [rx.identify(machine.model, one, criterion, intervals=rx.Naive()) for one in records]
        off = np.array([[float(fit[name]) / truth[name] - 1 for name in truth] for fit in fits])
        return np.exp(np.mean(np.log(np.mean(off**2, axis=0)) / 2))

    assert error(None) < 1.3 * min(error(criterion) for criterion in by_hand)
