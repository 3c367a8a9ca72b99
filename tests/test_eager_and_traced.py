"""One formula, run in two ways: what NumPy finds eagerly, JAX finds where it is traced."""

import equinox as eqx
import jax
import numpy as np
import pytest

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
GAPS = (700, 701, 1800)
CRITERIA = {
    "boxcar": (rx.RIEC(rx.AllWindows(*ALL)), ()),
    "boxcar, gaps": (rx.RIEC(rx.AllWindows(*ALL)), GAPS),
    "hat": (rx.RIEC(rx.AllWindows(*ALL), rx.Hat()), ()),
    "hat, gaps": (rx.RIEC(rx.AllWindows(*ALL), rx.Hat(6)), GAPS),
    "bump": (rx.RIEC(rx.AllWindows(0.2, 0.8), rx.Bump(lengths=6)), GAPS),
    "random": (rx.RIEC(rx.RandomWindows(*ALL, 4000)), GAPS),
    "dols": (rx.DOLS(), GAPS),
}


def both(model, records, criterion=None, key=None):
    """The estimate as NumPy finds it, and as JAX does where it is traced."""
    eager = rx.identify(model, records, criterion, key=key)
    criterion = eager.criterion
    traced = eqx.filter_jit(lambda r, k: rx.identify(model, r, criterion, key=k))(records, key)
    return eager, traced


def agree(eager, traced):
    """Values to a millionth of a standard error, and all that is said of their scatter."""
    error = np.asarray(eager.standard_errors)
    assert (error > 0).all()
    assert np.max(np.abs(eager.theta - np.asarray(traced.theta)) / error) < 1e-6
    np.testing.assert_allclose(traced.standard_errors, error, rtol=1e-5)
    ours, theirs = (np.asarray(one.uncertainty.studentized) for one in (eager, traced))
    np.testing.assert_allclose(theirs, ours, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("case", by_day(CRITERIA, "boxcar, gaps", "hat", "bump"))
def test_an_estimate_is_the_same(case):
    criterion, gaps = CRITERIA[case]
    equation = PLATE if case != "dols" else rx.Equation(
        rx.Term("c", "v"), rx.Term("k", "x"), -rx.Term(1.0, "u")
    )  # fmt: skip
    key = jax.random.key(3) if criterion.needs_key else None
    agree(*both(equation, recorded(PLATE, gaps), criterion, key))


@pytest.mark.parametrize("case", by_day(CRITERIA, "boxcar", "boxcar, gaps", "hat, gaps", "bump"))
def test_gram_matrices_are_the_same_to_rounding(case):
    criterion, gaps = CRITERIA[case]
    equation = PLATE if case != "dols" else rx.Equation(
        rx.Term("c", "v"), rx.Term("k", "x"), -rx.Term(1.0, "u")
    )  # fmt: skip
    key = jax.random.key(3) if criterion.needs_key else None
    record = recorded(PLATE, gaps)
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
    agree(*both(model, recorded(model, GAPS)))


def test_several_recordings_of_unequal_lengths_are_the_same():
    records = [recorded(PLATE, GAPS), recorded(PLATE, samples=1700, seed=1)]
    agree(*both(PLATE, records))


@pytest.mark.slow
def test_a_hidden_mode_is_the_same():
    rng, step, n = np.random.default_rng(5), 0.005, 6000
    t = step * np.arange(n)
    u = np.zeros(n)
    for tone in rng.uniform(0.3, 14.0, 40):
        u += np.sin(2 * np.pi * tone * t + rng.uniform(0, 2 * np.pi))
    source = rx.Equation(
        rx.Term("M", "v", derivative=1), rx.Term("B", "v"), rx.Term("K", "x"), -rx.Term(1.0, "u")
    )
    # A mass of 1 on a spring, with one of 0.3 on it: in steps so small that none matters.
    fine, state, found = 20, np.zeros(4), np.zeros((n, 4))
    matrix = np.zeros((4, 4))
    m, b, k, mm, bm, km = 1.0, 0.8, 60.0, 0.3, 0.4, 700.0
    matrix[0, 1] = matrix[2, 3] = 1.0
    matrix[1] = np.array([-k - km, -b - bm, km, bm]) / m
    matrix[3] = np.array([km, bm, -km, -bm]) / mm
    forced = np.interp(np.arange(n * fine) / fine, np.arange(n), u)
    import scipy.linalg

    move = scipy.linalg.expm(matrix * step / fine)
    push = np.linalg.solve(matrix, (move - np.eye(4)) @ np.array([0.0, 1.0 / m, 0.0, 0.0]))
    for i in range(n):
        found[i] = state
        for j in range(fine):
            state = move @ state + push * forced[i * fine + j]
    record = rx.Record.from_samples({"x": found[:, 0], "v": found[:, 1], "u": u}, time_step=step)
    model = rx.Model("carried", stages=source, modes=(rx.HiddenMode("v"),))
    eager, traced = both(model, record)
    agree(eager, traced)
    assert float(eager["M_mode"]) == pytest.approx(mm, rel=0.02)
