"""Hidden modes that are named by a frequency, and what is said of those that are not there."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import BODY, STANDARD
from tests.machines import MODE_MODEL as MODEL
from tests.machines import MODE_TRUTH as TRUTH
from tests.machines import body as driven
from tests.machines import body_with_mode as motion

import riecjax as rx
from nightly import nightly
from riecjax.equations.hidden_elements import is_hidden_name
from riecjax.estimation import mode_evidence
from riecjax.estimation.check import raise_if_not_carried
from riecjax.estimation.hidden_modes import as_asked

FREQUENCY = np.sqrt(TRUTH["K_mode"] / TRUTH["M_mode"]) / (2 * np.pi)


def noisy(signals: dict[str, np.ndarray], level: float = 0.003) -> rx.Record:
    rng = np.random.default_rng(0)
    return rx.Record(
        {n: x + level * np.std(x) * rng.standard_normal(x.shape) for n, x in signals.items()},
        STANDARD.step,
    )


@pytest.fixture(scope="module")
def record() -> rx.Record:
    return noisy(motion(True))


def evidence_near(hz: float | None, record: rx.Record):
    model = rx.staged(BODY).with_modes(rx.HiddenMode("v", hz))
    return mode_evidence(model, rx.identify(model, record))[0]


@pytest.mark.raises_finding("mode_elsewhere")
@pytest.mark.parametrize("hz", [3.0, *nightly([25.0])])
def test_a_mode_found_elsewhere_is_said(record, hz):
    evidence = evidence_near(hz, record)
    assert evidence.carried
    (finding,) = evidence.findings()
    assert finding.code == "mode_elsewhere"
    assert f"no mode near {hz:g} Hz: the search for M_mode ended at 9.4" in finding.message
    assert finding.parameters == ("M_mode", "K_mode", "B_mode")
    # The map shows both where it was looked for and where it was found.
    frequencies = np.asarray(evidence.map.frequency)
    assert frequencies.min() < min(hz, FREQUENCY) < max(hz, FREQUENCY) < frequencies.max()


@pytest.mark.parametrize("hz", [8.0, *nightly([None, 12.0])])
def test_of_a_mode_that_is_near_nothing_is_said(record, hz):
    evidence = evidence_near(hz, record)
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
    found = rx.identify(rx.staged(BODY).with_modes(*both), noisy(driven(a, 6000)))
    assert float(found["M_mode"]) == pytest.approx(1.5, rel=0.02)
    assert float(found["M_mode_2"]) == pytest.approx(6.0, rel=0.02)


def test_only_modes_of_one_body_are_exchanged():
    first, second, third = ([np.log(8.0), 0.1], [np.log(20.0), 0.2], [np.log(14.0), 0.3])
    at = jnp.array([*first, *second, *third, 0.7])
    v, w = (lambda hz=None: rx.HiddenMode("v", hz)), rx.HiddenMode("w", 30.0)
    swapped = as_asked(at, (v(19), w, v(), None))
    np.testing.assert_array_equal(swapped, [*third, *second, *first, 0.7])
    np.testing.assert_array_equal(as_asked(at, (v(9), w, v(13), None)), at)
    np.testing.assert_array_equal(as_asked(at, (v(), w, v(), None)), at)
    np.testing.assert_array_equal(as_asked(at[-1:], (None,)), at[-1:])


def test_the_map_follows_the_best_damping(record):
    evidence = evidence_near(None, record)
    damping = np.asarray(evidence.map.damping)
    inside = (damping > 0.021) & (damping < 0.79)
    # Of a grid of five dampings both shares would step wherever the best one changes.
    assert inside.sum() > 10
    assert np.unique(np.round(damping[inside], 3)).size > 0.9 * inside.sum()


@pytest.mark.slow
def test_a_second_mode_that_fails_is_named(record):
    model = MODEL.with_modes(rx.HiddenMode("v"))
    evidence = mode_evidence(model, rx.identify(model, record))[0]
    assert not evidence.carried
    message = evidence.findings()[0].message
    assert "the hidden mode on v (M_mode_2)" in message
    assert "(M_mode)" not in message


def test_a_mode_that_is_not_there_is_to_be_left_out():
    found = rx.check(MODEL, noisy(motion(False), 0.005))
    refusal = found.refusal
    assert refusal is not None
    assert "Leave the hidden mode out (on the command line: without --add-mode)" in refusal.message
    assert "--set" not in refusal.message


@pytest.mark.raises_finding("mode_not_carried")
def test_both_doubts_of_a_mode_are_raised():
    record = noisy(motion(False), 0.005)
    evidence = evidence_near(20.0, record)
    assert [f.code for f in evidence.findings()] == ["mode_not_carried", "mode_elsewhere"]
    excited = rx.check(MODEL, record).excitations
    with pytest.raises(
        rx.IdentifiabilityError, match=r"do not carry.*no mode near 20 Hz"
    ) as raised:
        raise_if_not_carried([evidence], excited)
    assert raised.value.code == "mode_not_carried"


def test_names_of_hidden_parameters():
    hidden = ["M_mode", "K_mode_2", "B_mode_13", "K_series", "K_series_2"]
    assert all(map(is_hidden_name, hidden))
    assert not any(map(is_hidden_name, ["M", "M_mode_x", "K_s", "mode", "K_series_"]))
