"""The motion of hidden masses, against SciPy and the equation that it has to close."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from tests.machines import BODY, STANDARD
from tests.machines import MODE_TRUTH as TRUTH
from tests.machines import body_with_mode as motion

import riecjax as rx
from nightly import nightly
from riecjax.equations.element import Shape
from riecjax.equations.element_motion import filtered
from riecjax.equations.expressions import evaluate
from riecjax.records.signal import Signal
from riecjax.validation import equation_error

TIMES = STANDARD.step * np.arange(2000)


def smooth(t: np.ndarray) -> np.ndarray:
    return np.sin(2 * np.pi * 3 * t) + 0.5 * np.cos(2 * np.pi * 11 * t + 1) + 0.3


def test_a_mass_moves_as_scipy_says():
    p, q = 6 / 21000, 120 / 21000
    shape = Shape.filtering(jnp.asarray(q), jnp.asarray(p), numerator=[jnp.asarray(q)])
    passed = filtered(Signal(smooth(TIMES)), jnp.asarray(STANDARD.step), shape)
    found, known = passed.values, passed.present
    # Twenty steps to a sample, so that lines between them are as good as the curve.
    times = STANDARD.step / 20 * np.arange(40000)
    _, truth, _ = scipy.signal.lsim(([q, 1], [p, q, 1]), smooth(times), times)
    known = np.array(known)
    known[-20:] = False  # the mirror image has a kink of curvature
    assert known.sum() > 1800
    # SciPy's mass starts at rest, beside a body that moves by 2: of that 1 % is left.
    np.testing.assert_allclose(found[known], truth[::20][known], atol=0.02)
    inside = known & (np.arange(2000) > 500) & (np.arange(2000) < 1900)
    np.testing.assert_allclose(found[inside], truth[::20][inside], atol=5e-4)


def test_samples_after_a_gap_wait_until_it_is_forgotten():
    missing = np.zeros(2000, bool)
    missing[1000:1010] = True
    samples = np.where(missing, np.nan, smooth(TIMES))
    record = rx.Record.from_samples({"v": samples}, time_step=STANDARD.step)
    p, q = jnp.asarray(6 / 21000), jnp.asarray(120 / 21000)
    shape = Shape.filtering(q, p, numerator=[q])
    known = filtered(evaluate("v", record), record.time_step, shape).present
    # 1 % is left after ln(100) 2 p / q = 0.46 s.
    waited = int(np.log(100) * 2 * 6 / 120 / STANDARD.step)
    expected = np.ones(2000, bool)
    expected[:waited] = False
    expected[1000 : 1010 + waited] = False
    np.testing.assert_array_equal(known, expected)


@pytest.mark.parametrize("sign", [-1.0, *nightly([1.0])])
def test_the_true_mode_closes_the_equation(sign):
    record = rx.Record(motion(True), STANDARD.step)
    equation = rx.Equation(*(-t if sign < 0 else t for t in BODY.terms), name="body")
    model = rx.staged(equation).with_elements(rx.HiddenMode("v"))
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    (left,) = equation_error(model, record, values)
    (without,) = equation_error(equation, record, values)
    assert float(left.relative_rms) < 0.01 < 0.1 < float(without.relative_rms)


def test_a_position_s_derivatives_move_along():
    moved = motion(True)
    position = rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("v",)),
        *BODY.terms[1:],
        name="body",
    )
    model = rx.staged(position).with_elements(rx.HiddenMode("x"))
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    (left,) = equation_error(model, rx.Record(moved, STANDARD.step), values)
    assert left.span == 1
    assert float(left.relative_rms) < 0.01
