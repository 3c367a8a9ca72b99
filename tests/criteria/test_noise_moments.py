"""What noise adds to moments, against the mean over draws of NumPy's noise."""

import jax
import numpy as np
import pytest

import riecjax as rx
from nightly import nightly
from riecjax.criteria import noise_moments
from riecjax.equations.bases import RoofFunctions
from riecjax.equations.model import as_model
from riecjax.summaries.one_pass import stage_normal_equations

STEP, N, PAIRS = 0.01, 300, 150
STD = {"x": 0.15, "y": 0.1, "v": 0.2, "u": 0.1}


def motion(seed):
    rng = np.random.default_rng(seed)
    frequency, phase, size = rng.uniform(0.3, 2.5, 8), rng.uniform(0, 6, 8), rng.normal(size=8)
    wave = size @ np.sin(2 * np.pi * np.outer(frequency, STEP * np.arange(N)) + phase[:, None])
    return wave / wave.std()


PROBED = np.sqrt(1.25)
"""By how much four times as many probes as pairs of draws add to the scatter of these."""


@pytest.fixture
def many_probes(monkeypatch):
    signs = np.random.default_rng(3).integers(0, 2, (4 * PAIRS, 2**9), np.int8) * 2 - 1
    monkeypatch.setattr(noise_moments, "SIGNS", signs)


NONE = rx.Noise({name: {} for name in STD})
CLEAN = {name: motion(seed) for seed, name in enumerate(STD)}
INERTIA, FORCE = rx.Term("m", "v", derivative=1), -rx.Term(1.0, "u")
LINEAR = rx.Equation(INERTIA, rx.Term("c", "v"), rx.Term("k", "x"), FORCE)
CURVED = rx.Equation(
    INERTIA,
    rx.Term("c", lambda s: s["v"] * abs(s["v"])),
    rx.Term("k3", lambda s: s["x"] ** 3),
    rx.Term("p", lambda s: 0.5 * s["x"] * s["u"]),
    FORCE,
)
ROOF = rx.Equation(
    INERTIA,
    rx.Terms("F", RoofFunctions([-1.5, 0.0, 1.5]), lambda s: s["x"] - s["y"]),
    FORCE,
)
DRAWN = (0.05, 0.4, 400)
BOXCAR = rx.RIEC(rx.AllWindows(0.05, 0.4))
CRITERIA = {
    "boxcar": BOXCAR,
    "trapezoids": rx.RIEC(rx.AllWindows(0.05, 0.4), rx.Boxcar(2)),
    "hat": rx.RIEC(rx.AllWindows(0.1, 0.6), rx.Hat()),
    "bump": rx.RIEC(rx.AllWindows(0.1, 0.6), rx.Bump(lengths=4)),
    "random": rx.RIEC(rx.RandomWindows(*DRAWN)),
    "random hat": rx.RIEC(rx.RandomWindows(*DRAWN), rx.Hat()),
    "between": rx.RIEC(rx.RandomWindows(*DRAWN, between_samples=True)),
}


def white(seed=0, n=N):
    rng = np.random.default_rng(seed)
    return {name: std * rng.normal(size=(PAIRS, n)) for name, std in STD.items()}


def moments(equation, criterion, noise, arrays, present=None):
    """Of records along the leading axis: corrected, and not; their mean over mirror images."""
    key = jax.random.key(2) if criterion.needs_key else None

    def of(arrays):
        signals = {n: rx.Signal(v, (present or {}).get(n)) for n, v in arrays.items()}
        record = rx.Record(signals, STEP).with_noise(noise)
        found = stage_normal_equations(as_model(equation), record, criterion, key)
        return found[0].total().clean, found[0].total().moments

    both = jax.jit(lambda arrays: jax.lax.map(of, arrays, batch_size=25))(arrays)
    return [np.asarray(m).reshape(-1, PAIRS, *m.shape[1:]).mean(0) for m in both]


def mirrored(added):
    return {name: CLEAN[name] + np.concatenate([added[name], -added[name]]) for name in CLEAN}


def truth_of(equation, criterion, present=None):
    arrays = {name: np.broadcast_to(wave, (PAIRS, N)) for name, wave in CLEAN.items()}
    return moments(equation, criterion, NONE, arrays, present)[1][0]


def left_over(equation, criterion, noise, added, present=None):
    """In standard errors of the mean over draws, what the corrected moments leave of noise, and
    what there was."""
    found = moments(equation, criterion, noise, mirrored(added), present)
    error = found[0].std(0) / np.sqrt(PAIRS)
    truth = truth_of(equation, criterion, present)
    corrected, plain = (np.abs(m.mean(0) - truth) / error for m in found)
    return corrected.max(), plain.max()


@pytest.mark.parametrize("criterion", CRITERIA)
def test_corrected_moments_are_those_without_noise(criterion, many_probes):
    corrected, plain = left_over(LINEAR, CRITERIA[criterion], rx.Noise.given(STD), white())
    assert corrected < 4 * PROBED < 20 < plain


@pytest.mark.parametrize("criterion", ["boxcar", "hat", "random"])
def test_and_those_of_curved_terms(criterion):
    small = {name: std / 2 for name, std in STD.items()}
    added = {name: values / 2 for name, values in white().items()}
    corrected, plain = left_over(CURVED, CRITERIA[criterion], rx.Noise.given(small), added)
    assert corrected < 4 < 20 < plain


def test_kinks_lose_most_of_what_noise_does_to_them():
    """A kink is corrected on average over what passes it, which one short record is not."""
    truth, added = truth_of(ROOF, BOXCAR), mirrored(white())
    size = np.sqrt(np.outer(np.diag(truth), np.diag(truth)))
    left, plain = (
        np.abs((moments(ROOF, BOXCAR, noise, added)[0].mean(0) - truth) / size)[2:, 2:].max()
        for noise in (rx.Noise.given(STD), NONE)
    )
    assert left < 0.25 * plain
    assert plain > 0.05


def test_a_missing_stretch_and_a_shared_source():
    correlation = {("x", "v"): 0.8, ("v", "u"): -0.5, ("x", "u"): -0.3}
    names = ["x", "v", "u"]
    matrix = np.eye(3)
    for (a, b), value in correlation.items():
        i, j = names.index(a), names.index(b)
        matrix[i, j] = matrix[j, i] = value
    added = white()
    raw = np.stack([added[name] / STD[name] for name in names], axis=-1)
    mixed = raw @ np.linalg.cholesky(matrix).T
    added |= {name: STD[name] * mixed[..., i] for i, name in enumerate(names)}
    present = {"x": ~np.isin(np.arange(N), [80, *range(150, 170)])}
    noise = rx.Noise.given(STD, correlation)
    corrected, plain = left_over(LINEAR, CRITERIA["hat"], noise, added, present)
    assert corrected < 4 < 20 < plain
    # Taken for independent, the sources would leave their products.
    alone, _ = left_over(LINEAR, CRITERIA["hat"], rx.Noise.given(STD), added, present)
    assert alone > 10


def coloured(kind):
    """Noise of a record, and draws of it: a velocity by central differences, a low-passed force."""
    noise, reach = rx.Noise.given(STD), 10
    raw = white(1, N + 2 * reach)
    name, of, taps = {
        "velocity": ("v", "x", np.array([0.5, 0.0, -0.5]) / STEP / 20),
        "low-passed": ("u", "u", np.hanning(2 * reach + 1) / 4),
    }[kind]
    made = np.stack([np.convolve(row, taps, "same") for row in raw[of]])
    inner = slice(reach, reach + N)
    added = {k: values[:, inner] for k, values in raw.items()} | {name: made[:, inner]}
    made_of = {**{k: noise[k] for k in STD}, name: noise[of].convolved(taps)}
    return rx.Noise.of(made_of), added


@pytest.mark.parametrize("criterion", ["boxcar", *nightly(["hat"])])
@pytest.mark.parametrize("kind", ["low-passed", *nightly(["velocity"])])
def test_coloured_noise_is_sent_through_the_windows(kind, criterion, many_probes):
    noise, added = coloured(kind)
    corrected, plain = left_over(LINEAR, CRITERIA[criterion], noise, added)
    assert corrected < 4 * PROBED < 15 < plain
    # Taken for white of the same size it is wrong.
    same = rx.Noise.given({name: float(noise.std(name)) for name in STD})
    assert left_over(LINEAR, CRITERIA[criterion], same, added)[0] > 10
