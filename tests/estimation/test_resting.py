"""A joint that sticks: what is done about rest, what is said of it, and where nothing is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import JOINT, JOINT_TRUTH, Shape, joint, joint_record

import riecjax as rx
from riecjax.equations.dry_friction import InMotion, in_motion

SEED = 1


@pytest.fixture(scope="module")
def motion():
    return joint(SEED, Shape(10_001, 500))


def said(found):
    return [finding for finding in found.findings() if finding.code == "at_rest"]


def errors(found):
    return np.array([float(found[name]) / true - 1 for name, true in JOINT_TRUTH.items()])


@pytest.fixture(scope="module")
def clean(motion):
    return joint_record(motion, "clean", SEED)


@pytest.fixture(scope="module")
def masked(clean):
    return rx.identify(JOINT, clean, intervals=rx.Sandwich())


@pytest.fixture(scope="module")
def kept(clean):
    return rx.identify(JOINT, clean, intervals=rx.Sandwich(), at_rest="keep")


@pytest.mark.slow
def test_rest_left_out_leaves_no_error_where_rest_kept_does(masked, kept):
    assert np.abs(errors(masked)).max() < 2e-3
    assert np.abs(errors(kept)).max() > 0.1


@pytest.mark.raises_finding("at_rest")
def test_the_finding_says_how_long_what_was_done_and_what_it_moves(clean, kept):
    found = rx.identify(JOINT, clean, intervals=rx.Sandwich())
    (one,), (other,) = said(found), said(kept)
    assert one.signals == ("dq",)
    assert f"Fs {float(found['Fs']):.4g} would be {float(kept['Fs']):.4g}" in one.message
    assert not one.doubts
    assert other.remedy == ("--at-rest", "mask")
    expected = abs(float(found["Fs"]) / float(kept["Fs"]) - 1)
    assert other.doubts["Fs"] == pytest.approx(expected)


@pytest.mark.no_finding("at_rest")
@pytest.mark.parametrize("equation", ["friction that does not jump", "a velocity that passes"])
def test_nothing_is_said_or_done_elsewhere(clean, equation):
    record = clean
    if equation == "a velocity that passes":
        t = 0.002 * np.arange(4000)
        signals = {"q": 1 - np.cos(5 * t), "dq": 5 * np.sin(5 * t), "tau": 20 * np.cos(5 * t)}
        record = rx.Record.from_samples(signals, time_step=0.002)
        model = rx.Equation(
            rx.Term("J", "dq", derivative=1), rx.Term("Fc", _sign), -rx.Term(1.0, "tau")
        )
    else:
        model = rx.Equation(
            rx.Term("J", "dq", derivative=1), rx.Term("d", "dq"), -rx.Term(1.0, "tau")
        )
    assert in_motion(rx.staged(model), record) == rx.staged(model)
    rx.identify(model, record, intervals=rx.Sandwich())


def _sign(signals):
    return jnp.sign(signals["dq"])


def test_an_equation_with_the_derivative_of_another_motion_stays_and_says_so(clean):
    model = rx.Equation(
        rx.Term("J", "dq", derivative=1),
        rx.Term("m", "tau", derivative=1),
        rx.Term("Fc", _sign),
        -rx.Term(1.0, "tau"),
    )
    assert in_motion(rx.staged(model), clean) == rx.staged(model)
    (one,) = said(rx.identify(model, clean, intervals=rx.Sandwich()))
    assert "it was kept, since" in one.message


def test_weights_hold_the_equation_for_every_order_and_criterion(clean):
    """Columns of the weighted equation times the truth cancel, derivatives taken numerically."""
    (equation,) = in_motion(rx.staged(JOINT), clean).equations
    assert all(isinstance(term, InMotion) for term in equation.terms)
    step, left, right = 0.002, 0.0, 0.0
    for term in equation.terms:
        values = np.asarray(term.samples(clean, 0).values[0])
        integral = np.concatenate([[0], np.cumsum(0.5 * (values[1:] + values[:-1]) * step)])
        part = values - values[0] if term.derivative else integral
        left = left + JOINT_TRUTH.get("".join(term.parameters), 1.0) * part
        right = max(right, np.abs(part).max())
    assert np.abs(left).max() < 1e-3 * right


def test_under_trace_nothing_happens(clean):
    def friction(tau):
        record = clean.with_signals({"tau": tau})
        return rx.identify(JOINT, record, intervals=rx.Sandwich())["Fs"]

    kept = rx.identify(JOINT, clean, intervals=rx.Sandwich(), at_rest="keep", noise="none")
    assert jnp.isfinite(jax.jit(friction)(clean["tau"]))
    assert np.isfinite(float(kept["Fs"]))


def test_a_word_that_says_nothing_of_rest_is_refused(clean):
    with pytest.raises(rx.ModelError, match="'mask' or 'keep'"):
        rx.identify(JOINT, clean, at_rest="smooth")  # pyright: ignore[reportArgumentType]
