"""What each equation of a simultaneous fit leaves, and what one without a known term does to it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import riecjax as rx
from nightly import nightly

KEY = jax.random.key(2)
STEP = 0.01
WINDOWS = rx.RIEC(rx.RandomWindows(0.05, 0.3, 150))


def spring(name="spring"):
    return rx.Equation(rx.Term(1.0, "f"), -rx.Term("k", "x", unit="N/m"), name=name)


def damped(name="damped"):
    return rx.Equation(
        rx.Term(1.0, "g"),
        -rx.Term("k", "x", unit="N/m"),
        -rx.Term("c", "v", unit="N s/m"),
        name=name,
    )


def record(seed=0, gap=False):
    """A strong spring force that fits, and a weak force of the second equation that does not."""
    rng = np.random.default_rng(seed)
    t = np.arange(400) * STEP
    x, v = np.sin(5 * t) + 0.3 * np.cos(17 * t + seed), 5 * np.cos(5 * t)
    f = 40 * x + 0.5 * rng.normal(size=t.size)
    g = 40 * x * (1 + 0.2 * np.cos(3 * t)) + 0.02 * v + 20 * np.sin(11 * t)
    if gap:
        g[120:150] = np.nan
    return rx.Record.from_samples({"x": x, "v": v, "f": f, "g": g}, time_step=STEP)


@pytest.mark.parametrize("gap", [False, *nightly([True])])
@pytest.mark.parametrize("criterion", [rx.DOLS(), *nightly([WINDOWS])])
def test_each_equation_leaves_a_share_of_its_own(criterion, gap):
    one, expected = record(gap=gap), []
    model = rx.simultaneous(spring(), damped())
    found = rx.identify(model, one, criterion, key=KEY, intervals=rx.Sandwich())
    for equation in (spring(), damped()):
        rows = criterion.rows(equation, one, KEY)
        theta = np.array([float(found[name]) for name in rows.parameters])
        error = np.asarray(rows.target) - np.asarray(rows.regressors) @ theta
        expected.append(np.linalg.norm(error) / np.linalg.norm(rows.target))
    assert list(found.equations) == ["spring", "damped"]
    left = [float(fit.relative_rms) for fit in found.equations.values()]
    np.testing.assert_allclose(left, expected, rtol=1e-7)
    total = sum(float(fit.residual_rms) ** 2 * float(fit.count) for fit in found.equations.values())
    stage = found.stages[0]
    assert total == pytest.approx(float(stage.residual_rms) ** 2 * float(stage.count), rel=1e-9)


@pytest.mark.raises_finding("large_residual")
def test_a_failing_equation_does_not_hide_behind_another():
    """A hundredth as strong as the other, and not explained by its own model."""
    one = record()
    weak = np.asarray(one["v"]) + 10 * np.random.default_rng(4).normal(size=400)
    second = rx.Equation(rx.Term(1.0, "g"), -rx.Term("c", "v", unit="N s/m"), name="weak")
    both = rx.Record({**one.arrays, "g": 0.1 * weak}, STEP)
    found = rx.identify(rx.simultaneous(spring(), second), both, rx.DOLS(), intervals=rx.Sandwich())
    assert found.stages[0].relative_rms < 0.05
    share = 100 * float(found.equations["weak"].relative_rms)
    assert share > 90
    (message,) = [f.message for f in found.findings() if f.code == "large_residual"]
    assert message.startswith(f"weak: the model leaves {share:.0f} % of the signal")
    lines = [line for line in str(found).splitlines() if ": relative residual" in line]
    assert [line.split(":")[0] for line in lines] == ["spring + weak", "spring", "weak"]
    assert lines[2] == f"weak: relative residual {share:.3g} %"


# A driven mass, and one hung on it, on which a third hides: the driven one's equation is exact.
TRUTH = {"m1": 2.0, "k0": 600.0, "c0": 6.0, "k": 400.0, "c": 4.0}


def two_masses(hidden_stiffness, noise=0.0):
    t = np.arange(2000) * STEP
    rng = np.random.default_rng(1)
    filtering = np.asarray(scipy.signal.butter(4, 0.12, output="sos"))
    force = np.asarray(scipy.signal.sosfilt(filtering, 100 * rng.normal(size=t.size)))
    m1, k0, c0, k, c = TRUTH.values()
    h, d = hidden_stiffness, 0.002 * hidden_stiffness
    stiffness = np.array([[k0 + k, -k, 0], [-k, k + h, -h], [0, -h, h]])
    damping = np.array([[c0 + c, -c, 0], [-c, c + d, -d], [0, -d, d]])
    inverse = np.diag([1 / m1, 1 / 3.0, 1 / 0.8])
    state = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ stiffness, -inverse @ damping]])
    drive = np.concatenate([np.zeros(3), inverse[:, 0]])
    motion = scipy.signal.lsim((state, drive[:, None], np.eye(6), np.zeros((6, 1))), force, t)[1]
    rates = motion @ state.T + force[:, None] * drive
    signals = {"F": force}
    for i in (0, 1):
        signals |= {f"x{i}": motion[:, i], f"v{i}": motion[:, 3 + i], f"a{i}": rates[:, 3 + i]}
    signals |= {"s": signals["x0"] - signals["x1"], "sv": signals["v0"] - signals["v1"]}
    noisy = {n: v + noise * np.std(v) * rng.normal(size=v.size) for n, v in signals.items()}
    return rx.Record(noisy, STEP)


def driven():
    return rx.Equation(
        rx.Term(1.0, "F"),
        -rx.Term("m1", "a0"),
        -rx.Term("k0", "x0"),
        -rx.Term("c0", "v0"),
        -rx.Term("k", "s"),
        -rx.Term("c", "sv"),
        name="driven",
    )


def hung():
    return rx.Equation(rx.Term("m2", "a1"), -rx.Term("k", "s"), -rx.Term("c", "sv"), name="hung")


def of_masses(model, one):
    return rx.identify(model, one, rx.DOLS(), intervals=rx.Sandwich())


@pytest.mark.raises_finding("no_known_term")
@pytest.mark.parametrize(
    ("stiffness", "noise", "least"), [(600.0, 0.0, 0.3), *nightly([(0.0, 0.1, 0.03)])]
)
def test_an_equation_without_a_known_term_says_how_far_it_shrinks_its_coefficients(
    stiffness, noise, least
):
    one = two_masses(stiffness, noise)
    together = of_masses(rx.simultaneous(driven(), hung()), one)
    in_turn = of_masses(rx.staged(driven(), hung()), one)
    lost = 1 - float(together["k"] / in_turn["k"])
    assert lost > least
    assert float(together.equations["hung"].shrinkage) == pytest.approx(lost, rel=0.1)
    assert together.equations["driven"].shrinkage == 0
    (message,) = [f.message for f in together.findings() if f.code == "no_known_term"]
    for word in ("hung: no term of it is known", "m2, k, c towards zero", "riecjax.staged"):
        assert word in message
    assert "no_known_term" not in [f.code for f in in_turn.findings()]
    for name, value in TRUTH.items() if noise == 0 else ():
        assert float(in_turn[name]) == pytest.approx(value, rel=1e-6)
    # An exact equation shrinks nothing.
    exact = of_masses(rx.simultaneous(driven(), hung()), two_masses(0.0))
    assert float(exact["m2"]) == pytest.approx(3.0, rel=1e-6)
    assert not {f.code for f in exact.findings()} & {"no_known_term", "large_residual"}


def test_without_a_target_the_share_is_of_the_largest_term():
    one = two_masses(600.0)
    found = of_masses(rx.simultaneous(driven(), hung()), one)
    parts = [found[n] * one[s] for n, s in (("m2", "a1"), ("k", "s"), ("c", "sv"))]
    error = np.asarray(parts[0] - parts[1] - parts[2])
    largest = max(float(jnp.sum(part**2)) for part in parts)
    share = float(found.equations["hung"].relative_rms)
    assert share == pytest.approx(np.sqrt(np.sum(error**2) / largest), rel=1e-7)
