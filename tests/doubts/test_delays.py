"""Delays of a force whose motion is known in closed form: of sums of sines it follows exactly."""

import numpy as np
import pytest

from nightly import nightly
from riecjax.doubts.columns import Asked, delay_of
from riecjax.doubts.delays import Settled, settled
from riecjax.doubts.equation_faults import demanded, finding_of
from riecjax.equations.equation import Equation
from riecjax.equations.model import as_model, staged
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.records.preparation.steps import undone
from riecjax.records.record import Record
from riecjax.summaries.summarise import ready
from riecjax.uncertainty.intervals import Sandwich

STEP, SAMPLES = 0.005, 6000
TRUTH = {"m": 2.0, "c": 9.0, "k": 400.0}
AXIS = as_model(
    Equation(
        Term("m", "x", derivative=2, measured=("v",), unit="kg"),
        Term("c", "x", derivative=1, measured=("v",), unit="N s/m"),
        Term("k", "x", unit="N/m"),
        -Term(1.0, "F"),
        name="axis",
        unit="N",
    )
)


def recorded(
    seed,
    *,
    delay: float | np.ndarray = 0.0,
    noise=0.01,
    friction=0.0,
    cubic=0.0,
    samples=SAMPLES,
    lag=0.0,
):
    """The record of an axis, its force `delay` samples late, or low-passed by `lag` seconds."""
    rng = np.random.default_rng(seed)
    hertz, phase = rng.uniform(0.3, 9, 60), rng.uniform(0, 2 * np.pi, 60)
    w = 2 * np.pi * hertz
    size = 1 / np.abs(TRUTH["k"] - TRUTH["m"] * w**2 + 1j * TRUTH["c"] * w)

    def motion(time):
        angle = np.exp(1j * (w * time[:, None] + phase))
        return tuple((size * angle * (1j * w) ** n).sum(1).real for n in range(3))

    def force(time):
        x, v, a = motion(time)
        linear = TRUTH["m"] * a + TRUTH["c"] * v + TRUTH["k"] * x
        scale = np.std(linear)
        return linear + scale * (
            friction * np.tanh(v / (0.1 * np.std(v))) + cubic * (x / np.std(x)) ** 3
        )

    time = STEP * np.arange(samples)
    x, v, _ = motion(time)
    signals = {"x": x, "v": v, "F": force(time - delay * STEP)}
    if lag:
        angle = np.exp(1j * (w * time[:, None] + phase))
        rigid = (TRUTH["k"] - TRUTH["m"] * w**2 + 1j * TRUTH["c"] * w) / (1 + 1j * w * lag)
        signals["F"] = (size * angle * rigid).sum(1).real
    noisy = {n: s + noise * np.std(s) * rng.normal(size=s.size) for n, s in signals.items()}
    return Record.from_samples(noisy, time_step=STEP)


def fitted(record, model=AXIS):
    records = [one.record for one in ready(model, record)]
    return records, identify(model, records, intervals=Sandwich())


def told(record, model=AXIS):
    """What is demanded, and what is told of it."""
    records, estimate = fitted(record, model)
    causes = demanded(model, records, estimate)
    return causes, [finding_of(one, model, records) for one in causes]


def delay_in(record, model=AXIS, signals=("F",)) -> Settled:
    """The delay of the force, whether it explains anything or not."""
    records, estimate = fitted(record, model)
    found = settled(Asked.of(model, estimate), records, delay_of(signals), 1.0)
    assert found is not None
    return found


@pytest.mark.raises_finding("late_signal")
@pytest.mark.parametrize("delay", [0.5, *nightly([1.0, 3.3, 11.0]), -2.0])
def test_a_delay_is_found_within_five_percent_of_a_sample(delay):
    (cause,), (finding,) = told(recorded(0, delay=delay))
    one = cause.undone
    assert one is not None
    assert one.samples == pytest.approx(delay, abs=0.05)
    assert abs(one.samples - delay) < 4 * one.error / STEP
    assert finding.code == "late_signal"
    assert finding.signals == ("F",)
    option, value = finding.remedy
    assert option == "--shift"
    assert float(value.removeprefix("F=")) == pytest.approx(delay * STEP, abs=0.05 * STEP)


@pytest.mark.raises_finding("late_signal")
def test_a_delay_of_many_samples_at_a_high_rate_is_as_long_as_any(monkeypatch):
    monkeypatch.setitem(globals(), "STEP", STEP / 10)
    (cause,), (finding,) = told(recorded(0, delay=36.0, samples=4 * SAMPLES))
    assert cause.undone is not None
    assert cause.undone.samples == pytest.approx(36, abs=0.2)
    assert finding.code == "late_signal"


@pytest.mark.raises_finding("drifting_signal")
@pytest.mark.parametrize("seed", range(3))
def test_a_drift_is_sized_with_the_parameters_that_it_moves(seed):
    """Of a position, as large as its motion, beside which the stiffness seems too small."""
    _, *others, _ = AXIS.equations[0].terms
    over_mass = Term(1.0, "x", derivative=2, measured=("v",)), *others, -Term("b", "F")
    record = recorded(seed)
    drift = 2.0 * float(np.std(record["x"]))
    line = drift * np.linspace(-0.5, 0.5, SAMPLES)
    drifting = record.with_signals({"x": record.signal("x") + line})
    (cause,), (finding,) = told(drifting, as_model(Equation(*over_mass)))
    assert cause.doubt.name == "drift of x"
    assert cause.size == pytest.approx(drift, rel=0.02)
    mended = undone(drifting, [finding.remedy])
    np.testing.assert_allclose(mended["x"], record["x"], atol=0.02 * drift)


@pytest.mark.no_finding("unmodelled_mode", "late_signal", "missing_term", "wrong_zero")
@pytest.mark.parametrize("noise", [0.05, 0.1])
def test_noise_of_a_sound_axis_is_no_mode(noise):
    for seed in range(12):
        _, found = told(recorded(seed, noise=noise, samples=3000))
        assert not found


@pytest.mark.no_finding("late_signal", "low_passed", "two_clocks", "lost_rows")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_a_force_in_time_is_not_called_late(noise):
    for seed in range(3):
        record = recorded(seed, noise=noise)
        one, (_, found) = delay_in(record), told(record)
        assert not found
        assert abs(one.samples) < max(4 * one.error / STEP, 0.01)
    for friction, cubic in ((0.3, 0.0), (0.0, 0.05)):
        # What a model leaves out is no delay.
        _, found = told(recorded(3, friction=friction, cubic=cubic, noise=noise))
        assert not found


@pytest.mark.raises_finding("low_passed")
@pytest.mark.no_finding("late_signal")
@pytest.mark.parametrize("samples", [1.5, 4.0])
def test_a_force_behind_a_low_pass_is_named_as_that(samples):
    (cause,), (finding,) = told(recorded(0, lag=samples * STEP))
    one = cause.undone
    assert one is not None
    assert one.low_passed
    assert one.certain
    assert one.size == pytest.approx(samples * STEP, rel=0.02)
    assert finding.code == "low_passed"


@pytest.mark.raises_finding("two_clocks")
@pytest.mark.no_finding("late_signal", "lost_rows")
def test_a_clock_that_runs_slow_is_told_by_its_rate():
    (cause,), (finding,) = told(recorded(0, delay=200e-6 * np.arange(SAMPLES)))
    assert cause.undone is not None
    course = cause.undone.course
    assert course is not None
    assert course.kind == "clocks"
    assert course.change / SAMPLES == pytest.approx(200e-6, rel=0.05)
    assert finding.signals == ("F",)
    assert f"{1e6 * course.change / course.place[1]:.3g} ppm" in finding.message
    option, clock = finding.remedy
    assert option == "--clock"
    assert float(clock.removeprefix("F=")) == pytest.approx(200, rel=0.05)


@pytest.mark.raises_finding("lost_rows")
@pytest.mark.no_finding("late_signal", "two_clocks")
@pytest.mark.parametrize(("lost", "at"), [(1, 2500), (5, 5000), *nightly([(20, 2500)])])
def test_rows_that_a_force_lost_are_found_where_they_were(lost, at):
    record = recorded(0, delay=-lost * np.heaviside(np.arange(SAMPLES) - at, 0.0))
    (cause,), (finding,) = told(record)
    assert cause.undone is not None
    assert cause.undone.course is not None
    assert cause.undone.course.change == pytest.approx(-lost, abs=0.05)
    option, seconds = finding.remedy
    # Before the loss all were in time, however short that part is.
    assert option == "--to"
    assert at * STEP - 4.0 < float(seconds) < at * STEP


@pytest.mark.slow
@pytest.mark.raises_finding("late_signal")
@pytest.mark.parametrize("late", ["F", "y"])
def test_the_late_one_is_that_which_explains_what_all_equations_leave(late):
    spring = Equation(Term("K", "y", unit="N/m"), -Term(1.0, "F"), name="spring", unit="N")
    model = staged(spring, AXIS.equations[0])
    # A little friction that the model lacks stays, whatever is shifted.
    sound, delayed = (recorded(0, delay=d, noise=0.0, friction=0.01) for d in (0.0, 1.0))
    rng, signals = np.random.default_rng(1), {"x": sound["x"], "v": sound["v"]}
    signals["F"] = (delayed if late == "F" else sound)["F"]
    signals["y"] = (delayed if late == "y" else sound)["F"] / 5e4
    noisy = {n: np.asarray(s) for n, s in signals.items()}
    noisy = {n: s + 0.01 * np.std(s) * rng.normal(size=s.size) for n, s in noisy.items()}
    records, estimate = fitted(Record.from_samples(noisy, time_step=STEP), model)
    (cause,) = demanded(model, records, estimate)
    finding = finding_of(cause, model, records)
    assert finding.signals == (late,)


def test_a_record_too_short_is_passed_over():
    records, estimate = fitted(recorded(0, delay=3.0, samples=400))
    assert demanded(AXIS, records, estimate) == []
