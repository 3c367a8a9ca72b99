import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria.criterion import DOLS, RIEC, Rows
from riecjax.criteria.test_functions import Boxcar
from riecjax.criteria.windows import RandomWindows, WindowSet
from riecjax.equations.equation import Equation
from riecjax.equations.noisy_columns import sampled_columns
from riecjax.equations.term import Polynomial, Term, Terms
from riecjax.records.record import Record

DURATION = 2.0


def smooth(t):
    return 2 + np.exp(-t) * np.sin(5 * t)


def smooth_integral(t):
    return 2 * t - np.exp(-t) * (np.sin(5 * t) + 5 * np.cos(5 * t)) / 26


def smooth_derivative(t):
    return np.exp(-t) * (5 * np.cos(5 * t) - np.sin(5 * t))


def smooth_record(steps):
    t = np.linspace(0, DURATION, steps + 1)
    signals = {"s": smooth(t), "ds": smooth_derivative(t)}
    return Record.from_samples(signals, time_step=DURATION / steps)


def increments(term, record, start, stop):
    windows = WindowSet(jnp.asarray(start), jnp.asarray(stop))
    return np.asarray(column_increments(Equation(term), record, windows))[1]


@eqx.filter_jit
def column_increments(equation, record, windows):
    return Boxcar(2).integrals(sampled_columns(equation, record, 1), windows).columns


def windows_in_samples(kind, steps):
    """The same windows in time for every number of steps: on the coarsest grid, or anywhere."""
    rng = np.random.default_rng(0)
    if kind == "on samples":
        start = rng.integers(0, 10, 60)
        stop = start + rng.integers(1, 21 - start)
        return start * (steps // 20), stop * (steps // 20)
    start = rng.uniform(0, 1.5, 60)
    return start * steps / DURATION, (start + rng.uniform(0.05, 0.5, 60)) * steps / DURATION


def observed_order(kind, term, primitive):
    errors = []
    for steps in (400, 800):
        start, stop = windows_in_samples(kind, steps)
        step = DURATION / steps
        exact = primitive(stop * step) - primitive(start * step)
        found = increments(term, smooth_record(steps), start, stop)
        errors.append(np.sqrt(np.mean((found - exact) ** 2)))
    return np.log2(errors[0] / errors[1])


@pytest.mark.parametrize("kind", ["on samples", "between samples"])
def test_window_integrals_converge_with_order_two(kind):
    assert observed_order(kind, Term("k", "s"), smooth_integral) == pytest.approx(2, abs=0.1)


def test_window_integrals_of_a_derivative_converge_with_order_two_between_samples():
    # The error changes sign with the place between samples, hence the wider band.
    order = observed_order("between samples", Term("m", "s", derivative=1), smooth)
    assert order == pytest.approx(2, abs=0.3)


def test_window_integrals_of_derivatives_are_exact_differences_on_samples():
    start, stop = windows_in_samples("on samples", 400)
    t = DURATION / 400
    first = increments(Term("m", "s", derivative=1), smooth_record(400), start, stop)
    np.testing.assert_allclose(first, smooth(stop * t) - smooth(start * t), rtol=0, atol=1e-14)
    term = Term("m", "s", derivative=2, measured=("ds",))
    second = increments(term, smooth_record(400), start, stop)
    expected = smooth_derivative(stop * t) - smooth_derivative(start * t)
    np.testing.assert_allclose(second, expected, rtol=0, atol=1e-13)


def trapezoid(samples, start, stop):
    """Integral of the polygon through the samples, in sample units, by brute force."""
    inner = np.arange(np.ceil(start), np.floor(stop) + 1)
    at = np.unique(np.concatenate([[start], inner, [stop]]))
    return np.trapezoid(np.interp(at, np.arange(samples.size), samples), at)


@pytest.mark.parametrize("kind", ["on samples", "between samples"])
def test_window_integrals_are_those_of_the_polygon_through_the_samples(kind):
    samples = 3 + np.random.default_rng(1).normal(size=41)
    record = Record.from_samples({"s": samples}, time_step=0.01)
    start, stop = windows_in_samples(kind, 40)
    expected = [0.01 * trapezoid(samples, a, b) for a, b in zip(start, stop)]
    np.testing.assert_allclose(
        increments(Term("k", "s"), record, start, stop), expected, rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("frequency", [0.3, 1.0, 2.0, 4.0, 5.0, 9.0])
@pytest.mark.parametrize("derivative", [0, 1])
def test_the_sampled_boxcar_has_the_gain_of_eq_13(frequency, derivative):
    length, step, w = 0.25, 0.002, 2 * np.pi * frequency
    lag = round(length / step)
    t = step * np.arange(2 * lag + 1)
    waves = {"real": np.cos(w * t), "imaginary": np.sin(w * t)}
    record = Record.from_samples(waves, time_step=step)
    start = np.arange(lag + 1)
    real, imaginary = (
        increments(Term("c", name, derivative=derivative), record, start, start + lag)
        for name in waves
    )
    gain = np.hypot(real, imaginary)
    exact = abs(2 * np.sin(w * length / 2) / w) * w**derivative
    # The trapezoidal rule lowers the gain by the share (w h)^2 / 12, at most 1.1e-3 here.
    quadrature = (w * step) ** 2 / 12 * exact if derivative == 0 else 0.0
    np.testing.assert_allclose(gain, exact, rtol=0, atol=1.02 * quadrature + 1e-13)


def test_a_large_offset_costs_window_integrals_no_accuracy_beyond_its_own_rounding():
    samples = np.random.default_rng(2).normal(size=20_001)
    record = Record.from_samples({"s": samples + 1e9}, time_step=1.0)
    start = np.arange(0, 19_900, 100)
    found = increments(Term("k", "s"), record, start, start + 100)
    rounded = (samples + 1e9) - 1e9
    expected = 1e11 + np.array([np.trapezoid(rounded[t : t + 101]) for t in start])
    # 1e11 itself has a spacing of 1.5e-5; the running integral reaches 2e13, spacing 4e-3.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)


EQUATION = Equation(
    Term(1.0, "u"),
    -Term("m", "x", derivative=2, measured=("v", "a")),
    -Term("d", "v"),
    -Terms("k", Polynomial((1, 3)), of="x"),
)


def oscillator_record(count=200):
    rng = np.random.default_rng(3)
    signals = {name: rng.normal(size=count) for name in ("u", "x", "v", "a")}
    return Record.from_samples(signals, time_step=0.01), signals


def test_dols_takes_the_equation_at_every_sample():
    record, s = oscillator_record()
    rows = DOLS().rows(EQUATION, record)
    np.testing.assert_allclose(rows.target, -s["u"], rtol=1e-15)
    expected = -np.stack([s["a"], s["v"], s["x"], s["x"] ** 3], axis=1)
    np.testing.assert_allclose(rows.regressors, expected, rtol=1e-14)
    assert rows.parameters == ("m", "d", "k_1", "k_3")
    assert not DOLS().needs_key


@pytest.mark.parametrize("between_samples", [False, True])
def test_riec_takes_the_integral_of_every_term_over_every_window(between_samples):
    record, s = oscillator_record()
    windows = RandomWindows(0.05, 0.3, 50, between_samples=between_samples)
    key = jax.random.key(5)
    rows = eqx.filter_jit(RIEC(windows, Boxcar(2)).rows)(EQUATION, record, key)
    drawn = windows.draw(key, record.sample_count, record.time_step)
    at = np.arange(200.0)
    for i, (a, b) in enumerate(zip(np.asarray(drawn.start), np.asarray(drawn.stop))):
        rise = np.diff(np.interp([a, b], at, s["v"]))[0]
        integrals = [0.01 * trapezoid(y, a, b) for y in (s["v"], s["x"], s["x"] ** 3)]
        expected = -np.array([rise, *integrals])
        np.testing.assert_allclose(rows.regressors[i], expected, rtol=0, atol=1e-13)
        np.testing.assert_allclose(rows.target[i], -0.01 * trapezoid(s["u"], a, b), atol=1e-13)
    # Compiled as a whole, a product and a sum may round once instead of twice.
    np.testing.assert_allclose(rows.position, drawn.start, rtol=1e-14)


def test_criteria_describe_themselves_as_plain_data():
    described = RIEC(RandomWindows(0.05, 0.3, 50)).describe()
    expected = {"name": "riec", "alpha": 0.05, "beta": 0.3, "windows": 50}
    assert described == expected | {"test_function": "boxcar", "quadrature": 4}
    assert DOLS().describe() == {"name": "dols"}


def some_rows():
    columns = jnp.array(np.random.default_rng(4).normal(size=(4, 6)))
    return Rows(columns, jnp.arange(6), ("a", "b", "c"))


def test_embedded_rows_have_zeros_for_further_parameters():
    rows = some_rows()
    wide = rows.embed(("c", "z", "a", "b"))
    expected = np.stack(
        [rows.columns[0], rows.columns[3], np.zeros(6), rows.columns[1], rows.columns[2]]
    )
    np.testing.assert_array_equal(wide.columns, expected)
    assert wide.parameters == ("c", "z", "a", "b")


def test_fixed_parameters_move_their_columns_to_the_target():
    rows = some_rows()
    left = rows.fix({"a": jnp.array(2.0), "c": jnp.array(-3.0), "other": jnp.array(1.0)})
    np.testing.assert_allclose(
        left.target, rows.target - 2 * rows.columns[1] + 3 * rows.columns[3], rtol=1e-14
    )
    np.testing.assert_array_equal(left.regressors[:, 0], rows.columns[2])
    assert left.parameters == ("b",)


def test_concatenated_rows_follow_one_another():
    rows = some_rows()
    both = Rows.concatenate([rows, rows])
    np.testing.assert_array_equal(both.regressors, np.tile(rows.regressors, (2, 1)))
    assert both.position.shape == (12,)
