"""Hidden modes: systems with an oscillator that the model does not know, solved by SciPy."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import BODY, STANDARD
from tests.machines import MODE_MODEL as MODEL
from tests.machines import MODE_TRUTH as TRUTH
from tests.machines import body_with_mode as motion

import riecjax as rx
from riecjax.equations.hidden_elements import Expanded
from riecjax.estimation import mode_evidence
from riecjax.uncertainty.intervals import Sandwich


@pytest.fixture(scope="module")
def with_mode() -> rx.Record:
    return rx.Record(motion(True), STANDARD.step)


def test_a_hidden_mode_is_found(with_mode):
    estimate = rx.identify(MODEL, with_mode)
    for name, value in TRUTH.items():
        assert float(estimate[name]) == pytest.approx(value, rel=2e-3), name
    assert dict(estimate.units)["K_mode"] == "N/m"
    evidence = mode_evidence(MODEL, estimate)[0]
    assert evidence.carried
    assert evidence.findings() == []
    # On a body at rest: sqrt(K / M) = 9.4 Hz, B / (2 sqrt(K M)) = 17 %.
    assert evidence.frequency[0] == pytest.approx(np.sqrt(21000 / 6) / (2 * np.pi), rel=1e-3)
    assert evidence.damping_ratio[0] == pytest.approx(60 / np.sqrt(21000 * 6), rel=3e-3)
    # The map is lowest near the mode.
    best = float(evidence.map.frequency[int(np.argmin(evidence.map.unexplained))])
    assert best == pytest.approx(np.sqrt(21000 / 6) / (2 * np.pi), rel=0.1)


def test_noise_is_taken_off(with_mode):
    rng = np.random.default_rng(5)
    noisy = {
        name: np.asarray(x) + 0.02 * np.std(x) * rng.standard_normal(x.shape)
        for name, x in with_mode.arrays.items()
    }
    estimate = rx.identify(MODEL, rx.Record(noisy, STANDARD.step))
    for name in ("m", "M_mode", "K_mode"):
        assert float(estimate[name]) == pytest.approx(TRUTH[name], rel=0.03), name
        low, high = estimate.interval(name)
        assert high - low < 0.15 * TRUTH[name]


def test_a_right_model_carries_no_mode():
    rng = np.random.default_rng(6)
    clean = motion(False)
    noisy = {n: x + 0.01 * x.std() * rng.standard_normal(x.shape) for n, x in clean.items()}
    estimate = rx.identify(MODEL, rx.Record(noisy, STANDARD.step))
    evidence = mode_evidence(MODEL, estimate)[0]
    assert not evidence.carried
    assert [finding.code for finding in evidence.findings()] == ["mode_not_carried"]


def test_a_late_velocity_is_no_oscillator():
    late = motion(False)
    late["v"] = np.concatenate([late["v"][:1], late["v"][:-1]])
    estimate = rx.identify(MODEL, rx.Record(late, STANDARD.step))
    evidence = mode_evidence(MODEL, estimate)[0]
    assert not evidence.carried
    assert "delay" in evidence.findings()[0].message


def test_a_known_mode_is_no_unknown(with_mode):
    known = {name: TRUTH[name] for name in ("M_mode", "K_mode", "B_mode")}
    estimate = rx.identify(MODEL, with_mode, known=known)
    assert estimate.parameters == ("m", "c", "k")
    assert float(estimate["m"]) == pytest.approx(20.0, rel=1e-3)


FEW_LENGTHS = rx.RIEC(rx.AllWindows(0.14, 0.3), rx.criteria.GradedBump(lengths=3))


@pytest.mark.slow
def test_a_batch_is_what_its_records_are_one_by_one():
    rng, clean, parts = np.random.default_rng(8), motion(True), []
    for level in (0.001, 0.08, 0.08):
        parts.append(
            {n: x + level * x.std() * rng.standard_normal(x.shape) for n, x in clean.items()}
        )
    batch = {name: jnp.stack([jnp.asarray(part[name]) for part in parts]) for name in clean}
    known = {name: 0.04 * x.std() for name, x in clean.items()}

    def of(signals: dict[str, jax.Array]) -> rx.Estimate:
        record = rx.Record(signals, STANDARD.step)
        return rx.identify(MODEL, record, FEW_LENGTHS, intervals=Sandwich(), noise=known)

    together = jax.vmap(lambda signals: (of(signals).theta, of(signals).standard_errors))(batch)
    each = [of(part) for part in parts]
    np.testing.assert_allclose(together[0], [np.asarray(e.theta) for e in each], rtol=1e-8)
    errors = [np.asarray(e.standard_errors) for e in each]
    # A record that is looked at is filled up, and its noise cut into blocks a little otherwise.
    np.testing.assert_allclose(together[1], errors, rtol=1e-3)


@pytest.mark.slow
def test_gradients_are_those_of_differences(with_mode):
    signals = {name: jnp.asarray(x) for name, x in with_mode.arrays.items()}
    # Of a change that no parameter undoes: a second motion, added to the position alone.
    away = jnp.sin(2 * jnp.pi * 3.0 * STANDARD.step * jnp.arange(6000)) * jnp.std(signals["x"])

    def found(size: jax.Array) -> jax.Array:
        record = rx.Record({**signals, "x": signals["x"] + size * away}, STANDARD.step)
        estimate = rx.identify(MODEL, record, FEW_LENGTHS, intervals=Sandwich(), noise="none")
        return jnp.log(jnp.stack([estimate[name] for name in ("M_mode", "K_mode", "B_mode", "k")]))

    compiled, step = jax.jit(found), 1e-4
    slope = jax.jit(jax.jacrev(found))(jnp.asarray(0.01))
    differences = (compiled(0.01 + step) - compiled(0.01 - step)) / (2 * step)
    np.testing.assert_allclose(slope, differences, rtol=1e-4, atol=1e-4 * np.abs(slope).max())


IN_32_BIT = """
import sys
import numpy as np
import riecjax as rx
from tests.machines import MODE_MODEL, STANDARD, body_with_mode

estimate = rx.identify(MODE_MODEL, rx.Record(body_with_mode(), STANDARD.step))
assert estimate.theta.dtype == np.float32, estimate.theta.dtype
print(*(float(estimate[name]) for name in ("m", "M_mode", "K_mode")))
"""


@pytest.mark.slow
def test_in_32_bit_modes_are_found_to_a_percent():
    environment = {**os.environ, "JAX_ENABLE_X64": "0"}
    done = subprocess.run(
        [sys.executable, "-c", IN_32_BIT], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    found = [float(value) for value in done.stdout.split()]
    meant = [TRUTH[name] for name in ("m", "M_mode", "K_mode")]
    np.testing.assert_allclose(found, meant, rtol=1e-2)


def test_what_cannot_be_asked(with_mode):
    with pytest.raises(rx.ModelError, match="no equation has one"):
        rx.staged(BODY).with_modes(rx.HiddenMode("F"))
    with pytest.raises(rx.ModelError, match="positive number of hertz"):
        rx.HiddenMode("v", hz=-1.0)
    with pytest.raises(rx.ModelError, match="all of M_mode, K_mode, B_mode are known or none"):
        rx.identify(MODEL, with_mode, known={"M_mode": 6.0})
    with pytest.raises(rx.ModelError, match="takes 3 derivatives off"):
        rx.identify(MODEL, with_mode, rx.RIEC(rx.AllWindows(0.05, 0.5)))
    with pytest.raises(rx.ModelError, match="per_record"):
        rx.identify(MODEL, [with_mode, with_mode], per_record=["c"])


def test_rows_of_third_derivatives():
    # The third derivative of t^3 is 6: its row is that of the constant 6.
    t = STANDARD.step * (np.arange(80) - 40)
    equation = rx.Equation(rx.Term("a", "cube"), -rx.Term(1.0, "six"))
    cube = Expanded.of(
        rx.Equation(rx.Term("a", "cube", derivative=1), -rx.Term(1.0, "six")),
        [rx.HiddenMode("cube")],
    ).equation
    record = rx.Record({"cube": t**3, "six": np.full(80, 6.0)}, STANDARD.step)
    weight = rx.criteria.GradedBump(lengths=1)
    criterion = rx.RIEC(rx.RandomWindows(0.2, 0.21, 20), weight)
    key = jax.random.key(0)
    third = criterion.rows(cube, record, key)
    constant = criterion.rows(equation, record, key)
    column = third.columns[1 + third.parameters.index("a''")]
    np.testing.assert_allclose(column, constant.columns[0], rtol=2e-4)


def test_a_frequency_that_the_sampling_cannot_show_is_refused(with_mode):
    model = rx.staged(BODY).with_modes(rx.HiddenMode("v", 500.0))
    with pytest.raises(rx.ModelError, match="no mode near 500 Hz can be seen at 200 samples"):
        rx.identify(model, with_mode)


def test_a_body_that_never_moves_tells_of_no_mode():
    still = motion(True) | {"v": np.zeros(6000)}
    with pytest.raises(rx.IdentifiabilityError, match="never moves") as raised:
        rx.identify(MODEL, rx.Record(still, STANDARD.step))
    assert raised.value.code == "not_excited"
