import numpy as np
import pytest

import riecjax as rx
from riecjax.records import check_signals

TIME = np.arange(4000) / 200
RNG = np.random.default_rng(3)
X = np.sin(2 * np.pi * 1.7 * TIME) + 0.4 * np.sin(2 * np.pi * 4.1 * TIME + 1)
V = np.gradient(X, TIME)
NOISE = RNG.normal(size=(2, TIME.size))


def found(**signals: np.ndarray) -> list[rx.Finding]:
    record = rx.Record.from_samples(signals, time_step=1 / 200)
    return [f for f in check_signals(record, signals) if f.code == "copied_signal"]


def gappy(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[500:700] = np.nan
    return values


@pytest.mark.raises_finding("copied_signal")
@pytest.mark.parametrize(
    "copy",
    [
        lambda x: x,
        lambda x: -35.15 * x,
        lambda x: 1e-300 * x,
        lambda x: 1e300 * x / np.max(np.abs(x)),
        lambda x: 2.5 * x + 70,
        lambda x: np.round(x / x.std(), 3),
        lambda x: x.astype(np.float32).astype(float),
        gappy,
    ],
    ids=["same", "multiple", "tiny", "huge", "offset", "rounded", "single precision", "gap"],
)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_copy_in_any_unit_and_rounding(copy, noise):
    x = X + noise * NOISE[0]
    (one,) = found(x=x, v=V + 0.01 * NOISE[1], u=copy(x))
    assert one.signals == ("x", "u")
    assert one.doubt == 1


def test_the_message_tells_a_copy_from_a_multiple():
    assert "u holds the samples of x, to" in found(x=X, u=X)[0].message
    assert "u is -35.2 times x plus 4, to" in found(x=X, u=4 - 35.2 * X)[0].message


@pytest.mark.no_finding("copied_signal")
@pytest.mark.parametrize("noise", [1e-3, 0.01, 0.05])
def test_two_sensors_of_one_motion_are_no_copies(noise):
    assert not found(x=X + noise * NOISE[0], y=3 * X + 3 * noise * NOISE[1])


@pytest.mark.no_finding("copied_signal")
@pytest.mark.parametrize("damping", [1e-4, 1e-5, 1e-6])
def test_a_slow_force_of_a_spring_is_no_copy(damping):
    assert not found(x=X, v=V, u=40 * X + 40 * damping * V)


MODEL = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v",)),
    rx.Term("c", "x", derivative=1, measured=("v",)),
    rx.Term("k", "x"),
    -rx.Term(1.0, "u"),
)


@pytest.mark.slow
def test_a_refusal_names_the_copy_that_is_why():
    record = rx.Record.from_samples({"x": X, "v": X, "u": NOISE[0].cumsum()}, time_step=1 / 200)
    checked = rx.check(MODEL, record, rx.RIEC(rx.AllWindows(0.1, 1.0)))
    assert checked.refusal is not None
    assert (checked.refusal.code, checked.refusal.signals) == ("copied_signal", ("x", "v"))
    with pytest.raises(rx.IdentifiabilityError, match="v holds the samples of x") as refused:
        rx.assess(MODEL, record, rx.RIEC(rx.AllWindows(0.1, 1.0)), refine=None)
    assert refused.value.code == "copied_signal"
