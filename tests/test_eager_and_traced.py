"""One formula, run in two ways: what NumPy finds eagerly, JAX finds where it is traced."""

import equinox as eqx
import jax
import numpy as np
import pytest
from tests.machines import MODE_MODEL, MODE_TRUTH, STANDARD, body_with_mode, noisy

import riecjax as rx
from nightly import by_day
from riecjax.equations.model import as_model
from riecjax.models.catalogue import LISTED

SAMPLES, STEP = 3000, 0.005
ALL = (0.05, 0.5)


def recorded(model, gaps=(), samples=SAMPLES, seed=0):
    """Every signal of a model: tones of its own and a little noise, with some samples missing."""
    rng, t = np.random.default_rng(seed), STEP * np.arange(samples)
    names = sorted({name for e in as_model(model).equations for name in e.signals})
    made = {}
    for name in names:
        tones, phases = rng.uniform(0.3, 8.0, 12), rng.uniform(0, 2 * np.pi, 12)
        made[name] = np.sin(2 * np.pi * np.outer(t, tones) + phases).sum(1) / 4
        made[name] += 1e-3 * rng.standard_normal(samples)
        made[name][list(gaps)] = np.nan
    return rx.Record.from_samples(made, time_step=STEP).with_noise(
        rx.Noise.given(dict.fromkeys(names, 1e-3))
    )


PLATE = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v",)),
    rx.Terms("F", rx.roof([-1.0, -0.3, 0.3, 1.0]), "v"),
    rx.Term("k", "x"),
    -rx.Term(1.0, "u"),
)
PLAIN = rx.Equation(rx.Term("c", "v"), rx.Term("k", "x"), -rx.Term(1.0, "u"))
"""For a criterion that takes no derivative."""
GAPS = (700, 701, 1800)
CRITERIA = {
    "boxcar": (rx.RIEC(rx.AllWindows(*ALL)), ()),
    "boxcar, gaps": (rx.RIEC(rx.AllWindows(*ALL)), GAPS),
    "hat": (rx.RIEC(rx.AllWindows(*ALL), rx.Hat()), ()),
    "hat, gaps": (rx.RIEC(rx.AllWindows(*ALL), rx.Hat(6)), GAPS),
    "bump": (rx.RIEC(rx.AllWindows(0.2, 0.8), rx.Bump(lengths=6)), GAPS),
    "random": (rx.RIEC(rx.RandomWindows(*ALL, 4000)), GAPS),
    "random, few lengths": (rx.RIEC(rx.RandomWindows(*ALL, 4000), rx.Bump(lengths=4)), GAPS),
    "dols": (rx.DOLS(), GAPS),
}


def problem(case):
    """Equation, record, criterion and key of one of `CRITERIA`."""
    criterion, gaps = CRITERIA[case]
    key = jax.random.key(3) if criterion.needs_key else None
    return PLAIN if case == "dols" else PLATE, recorded(PLATE, gaps), criterion, key


def both(model, records, criterion=None, key=None):
    """The estimate as NumPy finds it, and as JAX does where it is traced."""
    eager = rx.identify(model, records, criterion, key=key)
    criterion = eager.criterion
    traced = eqx.filter_jit(lambda r, k: rx.identify(model, r, criterion, key=k))(records, key)
    return eager, traced


def assert_agree(eager, traced):
    """Values to a millionth of a standard error, and all that is said of their scatter."""
    error = np.asarray(eager.standard_errors)
    assert (error > 0).all()
    assert np.max(np.abs(eager.theta - np.asarray(traced.theta)) / error) < 1e-6
    np.testing.assert_allclose(traced.standard_errors, error, rtol=1e-5)
    ours, theirs = (np.asarray(one.uncertainty.studentized) for one in (eager, traced))
    np.testing.assert_allclose(theirs, ours, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("case", by_day(CRITERIA, "boxcar, gaps", "hat", "bump"))
def test_an_estimate_is_the_same(case):
    assert_agree(*both(*problem(case)))


@pytest.mark.parametrize("case", by_day(CRITERIA, "boxcar", "boxcar, gaps", "hat, gaps", "bump"))
def test_gram_matrices_are_the_same_to_rounding(case):
    equation, record, criterion, key = problem(case)
    criterion = criterion.fitted([record])
    eager = rx.summarise(equation, record, criterion, key=key)
    traced = eqx.filter_jit(lambda r, k: rx.summarise(equation, r, criterion, key=k))(record, key)
    (ours,), (theirs,) = (one.equations()[0] for one in (eager, traced))
    size = np.sqrt(np.diagonal(ours.moments.sum((0, 1))))
    scale = np.outer(size, size)
    for name in ("moments", "noise") if case != "dols" else ("moments",):
        mine, its = (np.asarray(getattr(sums, name)) for sums in (ours, theirs))
        assert np.max(np.abs(mine - its) / scale) < 1e-12
    np.testing.assert_allclose(ours.count, theirs.count, rtol=1e-14)


@pytest.mark.parametrize("name", by_day(LISTED, "quarter-car", "emps", "pendulum"))
def test_built_in_models_are_the_same(name):
    model = rx.find_model(name)
    if name == "quarter-car-source":
        pytest.skip("it is simulated, and not identified")
    assert_agree(*both(model, recorded(model, GAPS)))


def test_several_recordings_of_unequal_lengths_are_the_same():
    records = [recorded(PLATE, GAPS), recorded(PLATE, samples=1700, seed=1)]
    assert_agree(*both(PLATE, records))


def test_of_windows_whose_longest_is_not_known_blocks_stay_apart():
    """Eagerly it is known in samples; where the time step is traced it is not."""
    record, criterion = recorded(PLATE), rx.RIEC(rx.AllWindows(*ALL))
    eager = rx.identify(PLATE, record, criterion, intervals="sandwich")
    traced = jax.jit(lambda r: rx.identify(PLATE, r, criterion, intervals="sandwich"))(record)
    assert np.max(np.abs(eager.theta - traced.theta) / np.asarray(eager.standard_errors)) < 1e-6
    # Of other short blocks, and of about as many longer ones.
    np.testing.assert_allclose(traced.standard_errors, eager.standard_errors, rtol=0.3)


@pytest.mark.slow
def test_a_hidden_mode_is_the_same():
    # Of a traced record no noise is judged by its samples.
    signals = noisy(body_with_mode(), 1e-3)
    noise = rx.Noise.given({name: 1e-3 * float(np.std(of)) for name, of in signals.items()})
    record = rx.Record.from_samples(signals, time_step=STANDARD.step).with_noise(noise)
    eager, traced = both(MODE_MODEL, record)
    assert_agree(eager, traced)
    assert float(eager["M_mode"]) == pytest.approx(MODE_TRUTH["M_mode"], rel=0.05)
