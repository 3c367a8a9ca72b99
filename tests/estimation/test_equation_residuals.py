"""What each equation of a simultaneous fit leaves, and what one without a known term does to it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from nightly import nightly
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.windows import RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import simultaneous, staged
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.uncertainty.intervals import Sandwich

KEY = jax.random.key(2)
STEP = 0.01
WINDOWS = RIEC(RandomWindows(0.05, 0.3, 150))


def spring(name="spring"):
    return Equation(Term(1.0, "f"), -Term("k", "x", unit="N/m"), name=name)


def damped(name="damped"):
    return Equation(
        Term(1.0, "g"), -Term("k", "x", unit="N/m"), -Term("c", "v", unit="N s/m"), name=name
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
    return Record.from_samples({"x": x, "v": v, "f": f, "g": g}, time_step=STEP)


def shares(rows, values):
    """Share of each equation by NumPy, from its rows: [(target, {name: column})]."""
    left = []
    for target, columns in rows:
        error = target - sum(values[name] * column for name, column in columns.items())
        left.append(np.sqrt(np.sum(error**2) / np.sum(target**2)))
    return left


def rows_of(criterion, one):
    for equation in (spring(), damped()):
        rows = criterion.rows(equation, one, KEY)
        yield np.asarray(rows.target), dict(zip(rows.parameters, np.asarray(rows.regressors).T))


@pytest.mark.parametrize("gap", [False, *nightly([True])])
@pytest.mark.parametrize("criterion", [DOLS(), *nightly([WINDOWS])])
def test_each_equation_leaves_a_share_of_its_own(criterion, gap):
    one = record(gap=gap)
    found = identify(
        simultaneous(spring(), damped()), one, criterion, key=KEY, intervals=Sandwich()
    )
    expected = shares(rows_of(criterion, one), {name: float(found[name]) for name in found})
    assert list(found.equations) == ["spring", "damped"]
    left = [float(fit.relative_rms) for fit in found.equations.values()]
    np.testing.assert_allclose(left, expected, rtol=1e-7)
    total = sum(float(fit.residual_rms) ** 2 * float(fit.count) for fit in found.equations.values())
    stage = found.stages[0]
    assert total == pytest.approx(float(stage.residual_rms) ** 2 * float(stage.count), rel=1e-9)


def failing():
    """One equation a hundredth as strong as the other, which its own model does not explain."""
    one = record()
    weak = np.asarray(one["v"]) + 10 * np.random.default_rng(4).normal(size=400)
    second = Equation(Term(1.0, "g"), -Term("c", "v", unit="N s/m"), name="weak")
    known = Record({**one.arrays, "g": 0.1 * weak}, STEP)
    return identify(simultaneous(spring(), second), known, DOLS(), intervals=Sandwich())


@pytest.mark.raises_finding("large_residual")
def test_a_failing_equation_does_not_hide_behind_another():
    found = failing()
    assert found.stages[0].relative_rms < 0.05
    assert found.equations["weak"].relative_rms > 0.9
    messages = [f.message for f in found.findings() if f.code == "large_residual"]
    assert len(messages) == 1
    share = 100 * float(found.equations["weak"].relative_rms)
    assert messages[0].startswith(f"weak: the model leaves {share:.0f} % of the signal")
    lines = [line for line in str(found).splitlines() if ": relative residual" in line]
    assert [line.split(":")[0] for line in lines] == ["spring + weak", "spring", "weak"]
    assert lines[2] == f"weak: relative residual {share:.3g} %"


def test_an_equation_of_known_coefficients_is_measured_against_its_largest_term():
    checked = Equation(
        Term(1.0, "g"), -Term("p", "x", known=40.0), -Term("q", "v", known=0.1), name="checked"
    )
    one = record()
    found = identify(simultaneous(spring(), checked), one, DOLS(), intervals=Sandwich())
    error = np.asarray(one["g"] - 40 * one["x"] - 0.1 * one["v"])
    largest = max(np.sum(np.asarray(one["g"]) ** 2), np.sum((40 * np.asarray(one["x"])) ** 2))
    share = float(found.equations["checked"].relative_rms)
    assert share == pytest.approx(np.sqrt(np.sum(error**2) / largest), rel=1e-9)


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
    return Record(noisy, STEP)


def driven():
    return Equation(
        Term(1.0, "F"),
        -Term("m1", "a0"),
        -Term("k0", "x0"),
        -Term("c0", "v0"),
        -Term("k", "s"),
        -Term("c", "sv"),
        name="driven",
    )


def hung():
    return Equation(Term("m2", "a1"), -Term("k", "s"), -Term("c", "sv"), name="hung")


def of_masses(procedure, one):
    return identify(procedure, one, DOLS(), intervals=Sandwich())


def codes(found):
    return [finding.code for finding in found.findings()]


@pytest.mark.raises_finding("no_known_term")
@pytest.mark.parametrize(
    ("stiffness", "noise", "least"), [(600.0, 0.0, 0.3), *nightly([(0.0, 0.1, 0.03)])]
)
def test_an_equation_without_a_known_term_says_how_far_it_shrinks_its_coefficients(
    stiffness, noise, least
):
    one = two_masses(stiffness, noise)
    together = of_masses(simultaneous(driven(), hung()), one)
    in_turn = of_masses(staged(driven(), hung()), one)
    lost = 1 - float(together["k"] / in_turn["k"])
    assert lost > least
    assert float(together.equations["hung"].shrinkage) == pytest.approx(lost, rel=0.1)
    assert together.equations["driven"].shrinkage == 0
    (message,) = [f.message for f in together.findings() if f.code == "no_known_term"]
    for word in ("hung: no term of it is known", "m2, k, c towards zero", "riecjax.staged"):
        assert word in message
    assert "no_known_term" not in codes(in_turn)


def test_solved_in_turn_the_true_stiffness_comes_back():
    in_turn = of_masses(staged(driven(), hung()), two_masses(600.0))
    for name, value in TRUTH.items():
        assert float(in_turn[name]) == pytest.approx(value, rel=1e-6)


def test_an_exact_equation_without_a_known_term_shrinks_nothing():
    found = of_masses(simultaneous(driven(), hung()), two_masses(0.0))
    assert float(found["m2"]) == pytest.approx(3.0, rel=1e-6)
    assert "no_known_term" not in codes(found)
    assert "large_residual" not in codes(found)


def test_without_a_target_the_share_is_of_the_largest_term():
    one = two_masses(600.0)
    found = of_masses(simultaneous(driven(), hung()), one)
    parts = [found[n] * one[s] for n, s in (("m2", "a1"), ("k", "s"), ("c", "sv"))]
    error = np.asarray(parts[0] - parts[1] - parts[2])
    largest = max(float(jnp.sum(part**2)) for part in parts)
    share = float(found.equations["hung"].relative_rms)
    assert share == pytest.approx(np.sqrt(np.sum(error**2) / largest), rel=1e-7)
