"""A sensor's wrong zero, which is weighed beside all else that may be wrong."""

import pytest
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_signals as signals

import riecjax as rx
from nightly import nightly

STEP = 0.01
DRAG = rx.find_model("drag-oscillator")


def recording(seed: int, noise: float = 0.01, **offsets: float) -> rx.Record:
    """Offsets in standard deviations of the signals."""
    values = {n: v.copy() for n, v in signals(seed, noise).items()}
    for name, size in offsets.items():
        values[name] += size * values[name].std()
    return rx.Record.from_samples(values, time_step=STEP)


def told(record: rx.Record, model: rx.Model = DRAG):
    findings = rx.assess(model, record, refine=None, sweep=False).findings()
    return [f for f in findings if f.code == "wrong_zero"]


@pytest.mark.raises_finding("wrong_zero")
@pytest.mark.parametrize(
    ("name", "size"), [("x", 1.0), ("x", -5.0), ("x", 30.0), ("u", -5.0), ("u", 10.0)]
)
def test_an_offset_is_named_with_what_it_moves_and_estimated(name, size):
    record = recording(0, **{name: size})
    (found,) = told(record)
    assert found.remedy == ("--unknown-offset", "u")
    assert max(found.doubts.values()) > 0.5
    answer = rx.assess(
        DRAG.with_elements(rx.elements.SensorZero("u")), record, refine=None, sweep=False
    ).estimate
    for parameter, value in TRUTH.items():
        error = float(dict(zip(answer.parameters, answer.standard_errors))[parameter])
        assert float(answer[parameter]) == pytest.approx(value, abs=5 * error + 0.01 * value)


def test_an_answer_stands_beside_a_large_zero():
    # Several amplitudes of zero are a doubt.
    assert float(rx.identify(DRAG, recording(0, u=10.0), intervals=rx.Naive())["k"]) > 0


@pytest.mark.no_finding("wrong_zero")
def test_a_force_that_never_varies_has_no_wrong_zero():
    values = {n: v.copy() for n, v in signals(0, 0.01).items()}
    values["u"][:] = 40.0
    assert told(rx.Record.from_samples(values, time_step=STEP)) == []


@pytest.mark.no_finding("wrong_zero")
@pytest.mark.parametrize("noise", [*nightly([0.0, 0.01]), 0.05])
def test_no_alarm_of_right_models(noise):
    for seed in range(5):
        assert told(recording(seed, noise)) == []
        sensed = DRAG.with_elements(rx.elements.SensorZero("u"))
        assert told(recording(seed, noise, x=3.0), sensed) == []


@pytest.mark.no_finding("wrong_zero")
def test_a_term_that_a_model_lacks_is_no_zero():
    # Half as much stiffness at one end of the stroke as at the other end of it, and in the middle.
    values = {n: v.copy() for n, v in signals(0, 0.01).items()}
    values["u"] += 300 * values["x"] ** 3
    assert told(rx.Record.from_samples(values, time_step=STEP)) == []
