"""How much noise the sums bear out, and what a noise level that was estimated leaves unsure."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from tests import machines
from tests.machines import MACHINES, Shape

import riecjax as rx
from nightly import nightly
from riecjax.estimation.stages import borne_out
from riecjax.records.noise_judgement import GivenNoise
from riecjax.summaries.normal_equations import NormalEquations

MACHINE, SHAPE = MACHINES["linear"], Shape(4000, 100)
STEP, N = SHAPE.step, SHAPE.count
OSCILLATOR, TRUTH = MACHINE.model, MACHINE.truth
CRITERION = rx.RIEC(rx.AllWindows(0.1, 0.6))
FAST = rx.Sandwich()


def response(force, seed=0):
    """Exact motion under a force that is held between samples: x, v and the force's mean."""
    m, c, k = TRUTH.values()
    system = ([[0, 1], [-k / m, -c / m]], [[0], [1 / m]], np.eye(2), np.zeros((2, 1)))
    times = STEP * np.arange(force.size)
    return scipy.signal.lsim(system, force, times, interp=False)[1].T


def noisy(seed, share=0.02):
    """Steady motion with white noise on all signals, and its standard deviations."""
    clean = MACHINE.signals(shape=SHAPE)
    clean = {name: clean[name] for name in ("x", "dx", "u")}
    std = {name: share * np.std(wave) for name, wave in clean.items()}
    return rx.Record(machines.noisy(clean, share, seed), STEP), std


def share_of(record, noise: GivenNoise = "auto"):
    summary = rx.summarise(OSCILLATOR, record, CRITERION, noise=noise)
    return share_kept(summary.equations()[0][0])


def share_kept(equations: NormalEquations) -> float:
    return float(np.asarray(borne_out(equations).noise).sum() / np.asarray(equations.noise).sum())


def test_noise_of_a_right_model_is_borne_out_and_corrected():
    """Estimates lie around the truth, where uncorrected ones are several errors off."""
    records = [noisy(seed, 0.1)[0] for seed in range(12)]
    assert [share_of(record) for record in records] == [1.0] * 12
    truth = np.array(list(TRUTH.values()))

    def off(noise):
        found = [
            rx.identify(OSCILLATOR, r, CRITERION, noise=noise, intervals=FAST) for r in records
        ]
        theta = np.array([f.theta for f in found])
        return np.abs(theta.mean(0) - truth) / theta.std(0), np.mean(
            [f.standard_errors for f in found], 0
        ) / theta.std(0)

    corrected, error = off("auto")
    assert (corrected < 4 / np.sqrt(12)).all()
    assert off("none")[0].max() > 4
    assert ((error > 0.5) & (error < 2)).all()


def moved_by_correction(signals):
    """The most that an estimate moves by what is taken off for noise, in standard errors."""
    record = rx.Record(signals, STEP)
    plain = rx.identify(OSCILLATOR, record, CRITERION, noise="none", intervals=rx.Sandwich())
    found = rx.identify(OSCILLATOR, record, CRITERION, intervals=rx.Sandwich())
    return (np.abs(found.theta - plain.theta) / plain.standard_errors).max()


def corners(seed):
    held = np.repeat(60 * np.random.default_rng(seed).normal(size=N // 25), 25)
    x, v = response(held)
    return {"x": x, "dx": v, "u": held}


@pytest.mark.parametrize("seed", [0, *nightly([1, 2])])
def test_a_motion_with_corners_and_no_noise_is_left_as_it_is(seed):
    assert moved_by_correction(corners(seed)) < 0.1


@pytest.mark.parametrize("seed", [0, *nightly([1, 2, 3])])
def test_a_force_that_is_new_at_each_sample_is_no_noise_of_what_it_moves(seed):
    force = 60 * np.random.default_rng(seed).normal(size=N)
    x, v = response(force)
    assert moved_by_correction({"x": x, "dx": v, "u": force}) < 0.1
    # Held from sample to sample, the force has its mean half a step later.
    middle = {"x": x[:-1], "dx": 0.5 * (v[1:] + v[:-1]), "u": force[:-1]}
    assert moved_by_correction(middle) < 0.1


def test_too_large_a_noise_is_cut_to_what_the_moments_hold():
    record, std = noisy(0)
    assert share_of(record, std) == 1.0
    # Twice the level is four times the variance, of which a quarter is there.
    assert share_of(record, {name: 2 * s for name, s in std.items()}) == pytest.approx(
        0.25, rel=0.15
    )
    moments = jnp.diag(jnp.array([4.0, 1.0, 2.0]))[None, None]
    whole = NormalEquations(moments, jnp.ones((1, 1)), ("a", "b"), moments * 0.95)
    assert share_kept(whole) == pytest.approx(0.9 / 0.95)


def test_what_is_unsure_of_the_level_is_how_estimates_scatter_with_it():
    record, std = noisy(0, 0.05)
    freedom = 30.0
    kernels = rx.Noise.given(std).kernels
    unsure = rx.Noise(kernels, dict.fromkeys(std, np.asarray(freedom)))
    sure, found = (
        rx.identify(OSCILLATOR, record, CRITERION, noise=noise, intervals=FAST)
        for noise in (rx.Noise.given(std), unsure)
    )
    np.testing.assert_allclose(found.theta, sure.theta, rtol=1e-12)
    added = np.asarray(found.uncertainty.covariance - sure.uncertainty.covariance)
    summary = rx.summarise(OSCILLATOR, record, CRITERION, noise=rx.Noise.given(std))
    one = summary.recordings[0].stages[0][0]
    assert one.noise_of_source is not None
    moments, sources = one.moments[0].sum(0), one.noise_of_source[0]
    rng = np.random.default_rng(0)
    theta = []
    for factors in rng.chisquare(freedom, (4000, len(sources))) / freedom:
        clean = moments - np.einsum("s,sij->ij", factors, sources)
        theta.append(np.linalg.solve(clean[1:, 1:], clean[1:, 0]))
    # To first order in the level, which moves by a quarter of itself.
    np.testing.assert_allclose(np.sqrt(np.diag(added)), np.std(theta, 0), rtol=0.08)
    correlation = added / np.sqrt(np.outer(np.diag(added), np.diag(added)))
    np.testing.assert_allclose(correlation, np.corrcoef(np.transpose(theta)), atol=0.05)
