"""Hidden modes: systems with an oscillator that the model does not know, solved by SciPy."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import BODY, STANDARD, noisy
from tests.machines import MODE_MODEL as MODEL
from tests.machines import MODE_TRUTH as TRUTH
from tests.machines import body as driven
from tests.machines import body_with_mode as motion

import riecjax as rx
from conftest import in_32_bit
from nightly import nightly
from riecjax.doubts.check import raise_if_not_carried
from riecjax.estimation import element_evidence
from riecjax.estimation.projection import find_shapes

FREQUENCY = np.sqrt(TRUTH["K_mode"] / TRUTH["M_mode"]) / (2 * np.pi)
SPRUNG = MODEL.with_elements(rx.SeriesSpring("c"))


def recorded(signals: dict[str, np.ndarray], noise: float = 0.0, seed: int = 5) -> rx.Record:
    return rx.Record(noisy(signals, noise, seed), STANDARD.step)


@pytest.fixture(scope="module")
def with_mode() -> rx.Record:
    return recorded(motion(True))


@pytest.fixture(scope="module")
def with_noise() -> rx.Record:
    return recorded(motion(True), 0.003)


@pytest.fixture(scope="module")
def without_mode() -> rx.Record:
    return recorded(motion(False), 0.005)


def evidence_near(hz: float | None, record: rx.Record):
    model = rx.staged(BODY).with_elements(rx.HiddenMode("v", hz))
    return element_evidence(model, rx.identify(model, record))[0]


def test_a_hidden_mode_is_found(with_mode):
    """Scatter alone is a tenth of what the integrals are off by, which intervals hold."""
    estimate = rx.identify(MODEL, with_mode)
    for name, value in TRUTH.items():
        assert float(estimate[name]) == pytest.approx(value, rel=2e-3), name
        low, high = estimate.interval(name)
        assert low <= value <= high
    assert dict(estimate.units)["K_mode"] == "N/m"
    evidence = element_evidence(MODEL, estimate)[0]
    assert evidence.carried
    assert evidence.findings() == []
    # On a body at rest: sqrt(K / M) = 9.4 Hz, B / (2 sqrt(K M)) = 17 %.
    assert evidence.frequency[0] == pytest.approx(FREQUENCY, rel=1e-3)
    assert evidence.damping_ratio[0] == pytest.approx(60 / np.sqrt(21000 * 6), rel=3e-3)
    # The map is lowest near the mode.
    best = float(evidence.map.frequency[int(np.argmin(evidence.map.unexplained))])
    assert best == pytest.approx(FREQUENCY, rel=0.1)
    known = {name: TRUTH[name] for name in ("M_mode", "K_mode", "B_mode")}
    held = rx.identify(MODEL, with_mode, known=known, intervals=rx.Naive())
    assert held.parameters == ("m", "c", "k")
    assert float(held["m"]) == pytest.approx(20.0, rel=1e-3)


def test_noise_is_taken_off():
    estimate = rx.identify(MODEL, recorded(motion(True), 0.02))
    for name in ("m", "M_mode", "K_mode"):
        assert float(estimate[name]) == pytest.approx(TRUTH[name], rel=0.03), name
        low, high = estimate.interval(name)
        assert high - low < 0.15 * TRUTH[name]


def test_a_late_velocity_is_no_oscillator():
    late = motion(False)
    late["v"] = np.concatenate([late["v"][:1], late["v"][:-1]])
    estimate = rx.identify(MODEL, recorded(late))
    evidence = element_evidence(MODEL, estimate)[0]
    assert not evidence.carried
    assert "delay" in evidence.findings()[0].message


@pytest.mark.raises_finding("mode_elsewhere")
@pytest.mark.parametrize("hz", [3.0, *nightly([25.0])])
def test_a_mode_found_elsewhere_is_said(with_noise, hz):
    evidence = evidence_near(hz, with_noise)
    assert evidence.carried
    (finding,) = evidence.findings()
    assert finding.code == "mode_elsewhere"
    assert f"no mode near {hz:g} Hz: the search for M_mode ended at 9.4" in finding.message
    assert finding.parameters == ("M_mode", "K_mode", "B_mode")
    # The map shows both where it was looked for and where it was found.
    frequencies = np.asarray(evidence.map.frequency)
    assert frequencies.min() < min(hz, FREQUENCY) < max(hz, FREQUENCY) < frequencies.max()


@pytest.mark.parametrize("hz", [8.0, *nightly([None, 12.0])])
def test_of_a_mode_that_is_near_nothing_is_said(with_noise, hz):
    evidence = evidence_near(hz, with_noise)
    assert evidence.frequency[0] == pytest.approx(FREQUENCY, rel=1e-2)
    assert evidence.findings() == []


@pytest.mark.slow
def test_modes_have_the_names_of_the_frequencies_asked_for():
    """Two modes on one body, of 8 and 20 Hz, whichever is asked for first."""
    a = np.zeros((6, 6))
    a[0, 1], a[1, :2] = 1, [-TRUTH["k"] / TRUTH["m"], -TRUTH["c"] / TRUTH["m"]]
    for x, (mass, hz, ratio) in ((2, (6.0, 8.0, 0.1)), (4, (1.5, 20.0, 0.05))):
        stiff = mass * (2 * np.pi * hz) ** 2
        force = np.array([stiff, 2 * ratio * np.sqrt(stiff * mass)])
        a[1, :2] -= force / TRUTH["m"]
        a[1, x : x + 2] = force / TRUTH["m"]
        a[x, x + 1] = 1
        a[x + 1, :2] = force / mass
        a[x + 1, x : x + 2] = -force / mass
    both = rx.HiddenMode("v", 20), rx.HiddenMode("v", 8)
    found = rx.identify(rx.staged(BODY).with_elements(*both), recorded(driven(a), 0.003))
    assert float(found["M_mode"]) == pytest.approx(1.5, rel=0.02)
    assert float(found["M_mode_2"]) == pytest.approx(6.0, rel=0.02)


def test_the_map_follows_the_best_damping(with_noise):
    evidence = evidence_near(None, with_noise)
    damping = np.asarray(evidence.map.damping)
    inside = (damping > 0.021) & (damping < 0.79)
    # Of a grid of five dampings both shares would step wherever the best one changes.
    assert inside.sum() > 10
    assert np.unique(np.round(damping[inside], 3)).size > 0.9 * inside.sum()


@pytest.mark.raises_finding("mode_not_carried")
def test_a_mode_that_is_not_there_is_to_be_left_out(without_mode):
    (finding,) = evidence_near(None, without_mode).findings()
    assert finding.code == "mode_not_carried"
    checked = rx.check(MODEL, without_mode)
    refusal = checked.refusal
    assert refusal is not None
    assert "Leave the hidden mode out (on the command line: without --add-mode)" in refusal.message
    assert "--set" not in refusal.message
    # Nor is it where it was looked for: both doubts are raised.
    evidence = evidence_near(20.0, without_mode)
    assert [f.code for f in evidence.findings()] == ["mode_not_carried", "mode_elsewhere"]
    with pytest.raises(rx.IdentifiabilityError, match=r"do not carry.*no mode near 20 Hz"):
        raise_if_not_carried([evidence], checked.excitations)


@pytest.mark.slow
@pytest.mark.parametrize("mode", [False, True])
def test_as_many_modes_as_there_are(mode):
    model, record, carried = rx.staged(BODY), recorded(motion(mode)), [True]
    while carried[-1] and len(model.elements) < 2:
        model = model.with_elements(rx.HiddenMode("v"))
        carried.append(element_evidence(model, rx.identify(model, record))[-1].carried)
    assert carried[1:] == [True, False][not mode :]


FEW_LENGTHS = rx.RIEC(rx.AllWindows(0.14, 0.3), rx.criteria.GradedBump(lengths=3))


@pytest.mark.slow
def test_gradients_are_those_of_differences(with_mode):
    signals = {name: jnp.asarray(x) for name, x in with_mode.arrays.items()}
    # Of a change that no parameter undoes: a second motion, added to the position alone.
    away = jnp.sin(2 * jnp.pi * 3.0 * STANDARD.step * jnp.arange(6000)) * jnp.std(signals["x"])

    def found(size: jax.Array) -> jax.Array:
        record = rx.Record({**signals, "x": signals["x"] + size * away}, STANDARD.step)
        estimate = rx.identify(MODEL, record, FEW_LENGTHS, intervals=rx.Sandwich(), noise="none")
        return jnp.log(jnp.stack([estimate[name] for name in ("M_mode", "K_mode", "B_mode", "k")]))

    compiled, step = jax.jit(found), 1e-4
    slope = jax.jit(jax.jacrev(found))(jnp.asarray(0.01))
    differences = (compiled(0.01 + step) - compiled(0.01 - step)) / (2 * step)
    np.testing.assert_allclose(slope, differences, rtol=1e-4, atol=1e-4 * np.abs(slope).max())


@pytest.mark.slow
def test_in_32_bit_modes_are_found_to_a_percent():
    record = recorded(motion(True))
    criterion = rx.identify(MODEL, record).criterion
    with in_32_bit():
        estimate = jax.jit(lambda record: rx.identify(MODEL, record, criterion))(record)
    assert estimate.theta.dtype == np.float32
    for name in ("m", "M_mode", "K_mode"):
        assert float(estimate[name]) == pytest.approx(TRUTH[name], rel=1e-2)


def test_what_cannot_be_asked(with_mode):
    with pytest.raises(rx.ModelError, match="no equation has one"):
        rx.staged(BODY).with_elements(rx.HiddenMode("F"))
    with pytest.raises(rx.ModelError, match="positive number of hertz"):
        rx.HiddenMode("v", hz=-1.0)
    with pytest.raises(rx.ModelError, match="all of M_mode, K_mode, B_mode are known or none"):
        rx.identify(MODEL, with_mode, known={"M_mode": 6.0})
    with pytest.raises(rx.ModelError, match="takes 3 derivatives off"):
        rx.identify(MODEL, with_mode, rx.RIEC(rx.AllWindows(0.05, 0.5)))
    with pytest.raises(rx.ModelError, match="per_record"):
        rx.identify(MODEL, [with_mode, with_mode], per_record=["c"])
    model = rx.staged(BODY).with_elements(rx.HiddenMode("v", 500.0))
    with pytest.raises(rx.ModelError, match="no mode near 500 Hz can be seen at 200 samples"):
        rx.identify(model, with_mode)
    still = recorded(motion(True) | {"v": np.zeros(6000)})
    with pytest.raises(rx.IdentifiabilityError, match="never moves") as raised:
        rx.identify(MODEL, still)
    assert raised.value.code == "not_excited"


@pytest.mark.parametrize("model", [MODEL, *nightly([SPRUNG])], ids=["mode", "mode and spring"])
def test_the_choice_of_window_lengths_is_part_of_the_variance(with_mode, model):
    """Of the two lengths that tell most, each by itself."""
    found = rx.identify(model, with_mode, intervals=rx.Sandwich())
    assert found.summary is not None
    modes = [find_shapes(model, found.summary, {}, rank=rank) for rank in (0, 1)]
    alone = [dataclasses.replace(found.summary, band=of.bands[0]) for of in modes]
    first, second = (rx.estimate(model, one, intervals=rx.Sandwich()) for one in alone)
    assert modes[0].bands != modes[1].bands
    known_as_well = np.minimum(np.diag(first.covariance) / np.diag(second.covariance), 1.0)
    apart = np.sqrt(known_as_well) * (np.asarray(second.theta) - np.asarray(first.theta))
    added = apart[:, None] * apart[None, :]
    np.testing.assert_allclose(found.theta, first.theta, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, first.covariance + added, rtol=1e-6)
