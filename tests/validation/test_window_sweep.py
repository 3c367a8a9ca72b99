import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import Shape, simulated

import riecjax as rx
from riecjax.criteria.windows import WindowSet
from riecjax.equations.noisy_columns import sampled_columns
from riecjax.models.oscillators import drag_oscillator_equation
from riecjax.validation.sweep import window_sweep

KEY = jax.random.key(0)
CRITERION = rx.RIEC(rx.RandomWindows(0.05, 0.5, 3000), rx.Hat(6))


def oscillator(seed=0, noise=0.0) -> rx.Record:
    """A drag oscillator under noise up to 8 Hz, with measurement noise on the force."""
    run = simulated("drag-oscillator", seed, Shape(8000, 200), bandwidth=8.0, rms=5.0)
    force = run["u"] + noise * np.random.default_rng(seed).normal(size=8000)
    return run.with_signals({"u": force}).select("x", "dx", "u")


def linear_oscillator() -> rx.Equation:
    """Without its spring and its quadratic drag."""
    return rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("dx",)),
        rx.Term("r", "x", derivative=1),
        -rx.Term(1.0, "u"),
    )


@pytest.mark.slow
def test_noise_alone_seldom_makes_an_exact_model_window_sensitive():
    alarms = 0
    for seed in range(12):
        record = oscillator(seed, noise=1.0)
        sweep = window_sweep(drag_oscillator_equation(), record, CRITERION, key=KEY)
        alarms += bool(sweep.findings())
    assert alarms <= 2


@pytest.mark.raises_finding("window_sensitive")
def test_a_term_left_out_shows():
    sweep = window_sweep(linear_oscillator(), oscillator(), CRITERION, key=KEY)
    (finding,) = sweep.findings()
    assert finding.code == "window_sensitive"
    assert "m" in finding.parameters
    assert "The model leaves something out" in finding.message
    first, last, difference, error = sweep.drift("m")
    assert abs(difference) > 3 * error
    assert first < last


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [60, 100])
def test_lengths_that_hardly_fit_between_gaps_have_no_estimate(spacing):
    whole = oscillator()
    present = jnp.arange(whole.sample_count) % spacing != 0
    record = whole.with_signals({"u": rx.Signal(whole["u"], present)})
    sweep = window_sweep(drag_oscillator_equation(), record, CRITERION, key=KEY)
    # So many samples between gaps span a window of one interval less.
    fits = sweep.alpha <= (spacing - 2) * 0.005 * (1 + 1e-9)
    np.testing.assert_array_equal(np.isfinite(sweep.theta), np.stack([fits] * 4, axis=1))
    assert 0 < np.sum(fits) < fits.size
    truth = np.broadcast_to([1.5, 0.8, 0.5, 20.0], sweep.theta.shape)
    np.testing.assert_allclose(sweep.theta[fits], truth[fits], rtol=5e-3)
    assert sweep.findings() == []
    linear = window_sweep(linear_oscillator(), record, CRITERION, key=KEY)
    assert "window_sensitive" in {finding.code for finding in linear.findings()}
    assert not any("nan" in finding.message for finding in linear.findings())


@pytest.mark.slow
def test_standard_errors_are_those_of_scores_summed_over_blocks_of_time():
    record = oscillator(noise=1.0)
    sweep = window_sweep(drag_oscillator_equation(), record, CRITERION, key=KEY, bands=4)
    lags = range(round(float(sweep.alpha[1]) / 0.01), round(float(sweep.beta[1]) / 0.01) + 1)
    columns = sampled_columns(drag_oscillator_equation(), record, 2)
    each = []
    for lag in lags:
        start = jnp.arange(record.sample_count - 2 * lag)
        integrals, _ = rx.Hat(6).integrals(columns, WindowSet(start, start + 2 * lag))
        each.append((start, integrals))
    rows = np.concatenate([np.asarray(values) for _, values in each], axis=1)
    a, y = rows[1:].T, rows[0]
    theta = np.linalg.lstsq(a, y)[0]
    blocks = int(sweep.block_count)
    # Blocks are made of whole short ones, as long as the fit's longest window at the least.
    samples = 2 ** int(np.ceil(np.log2(0.5 / 0.005 + 2)))
    short = -(-record.sample_count // samples)
    block = (np.concatenate([start for start, _ in each]) // samples) * blocks // short
    scores = np.stack([(a * (y - a @ theta)[:, None])[block == b].sum(0) for b in range(blocks)])
    moved = np.linalg.solve(a.T @ a, scores.T)
    expected = np.sqrt(blocks / (blocks - 1) * np.sum(moved**2, axis=1))
    np.testing.assert_allclose(sweep.standard_errors[1], expected, rtol=1e-6)


def test_a_drift_is_told_from_scatter_of_the_difference():
    sweep = window_sweep(linear_oscillator(), oscillator(), CRITERION, key=KEY)
    theta = np.asarray(sweep.theta[:, 0])
    value = float(theta[-1])
    far = np.max(np.abs(theta - value))
    # Less than the whole distance, by the scatter that remains between two lengths.
    assert 0.5 * far < sweep.away("m", value) < far
    exact = window_sweep(drag_oscillator_equation(), oscillator(noise=1.0), CRITERION, key=KEY)
    assert exact.away("m", float(exact.theta[-1, 0])) < 2e-3 * 1.5


@pytest.mark.slow
def test_a_steady_range_holds_no_estimate_that_differs():
    wrong = window_sweep(linear_oscillator(), oscillator(), CRITERION, key=KEY)
    assert wrong.steady(("m",)) is None
    sweep = window_sweep(drag_oscillator_equation(), oscillator(noise=1.0), CRITERION, key=KEY)
    steady = sweep.steady(("m",))
    assert steady is not None
    low, high = steady
    inside = (sweep.alpha >= low) & (sweep.beta <= high)
    theta = np.asarray(sweep.theta[:, 0])
    assert np.sum(inside) >= 2
    assert np.ptp(theta[inside]) <= 0.01 * np.max(np.abs(theta))


@pytest.mark.slow
def test_noise_explains_what_short_windows_leave():
    record = oscillator()
    rng = np.random.default_rng(1)
    spread = {name: 0.2 * float(np.std(record[name])) for name in ("x", "dx", "u")}
    noisy = record.with_signals(
        {name: record[name] + rng.normal(size=8000) * by for name, by in spread.items()}
    )
    sweep = window_sweep(drag_oscillator_equation(), noisy, rx.RIEC(rx.AllWindows(0.05, 0.5)))
    assert sweep.noise_share("m") > 0.8
    bare = window_sweep(linear_oscillator(), record, rx.RIEC(rx.AllWindows(0.05, 0.5)))
    assert bare.noise_share("m") < 0.1
