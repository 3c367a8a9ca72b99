"""A joint that sticks: what is done about rest, what is said of it, and where nothing is."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import JOINT, JOINT_TRUTH, Shape, joint, joint_record

import riecjax as rx
from riecjax.elements.dry_friction import DryFrictionAtRest

SEED = 1


def said(found):
    return [finding for finding in found.findings() if finding.code == "at_rest"]


@pytest.fixture(scope="module")
def clean():
    return joint_record(joint(SEED, Shape(10_001, 500)), "clean", SEED)


@pytest.mark.raises_finding("at_rest")
def test_rest_left_out_leaves_no_error_where_rest_kept_does_which_is_said(clean):
    found = rx.identify(JOINT, clean, intervals=rx.Sandwich())
    kept = rx.identify(JOINT, clean, intervals=rx.Sandwich(), at_rest="keep")
    errors, errors_kept = (
        max(abs(float(fit[name]) / true - 1) for name, true in JOINT_TRUTH.items())
        for fit in (found, kept)
    )
    assert errors < 2e-3
    assert errors_kept > 0.1
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
    record, friction = clean, rx.Term("d", "dq")
    if equation == "a velocity that passes":
        t = 0.002 * np.arange(4000)
        signals = {"q": 1 - np.cos(5 * t), "dq": 5 * np.sin(5 * t), "tau": 20 * np.cos(5 * t)}
        record, friction = rx.Record.from_samples(signals, time_step=0.002), rx.Term("Fc", _sign)
    model = rx.staged(rx.Equation(rx.Term("J", "dq", derivative=1), friction, -rx.Term(1.0, "tau")))
    assert DryFrictionAtRest().trusted(model, record) is model
    rx.identify(model, record, intervals=rx.Naive())


def _sign(signals):
    return jnp.sign(signals["dq"])


def test_an_equation_with_the_derivative_of_another_motion_stays_and_says_so(clean):
    model = rx.Equation(
        rx.Term("J", "dq", derivative=1),
        rx.Term("m", "tau", derivative=1),
        rx.Term("Fc", _sign),
        -rx.Term(1.0, "tau"),
    )
    staged = rx.staged(model)
    assert DryFrictionAtRest().trusted(staged, clean) is staged
    (one,) = said(rx.identify(model, clean, intervals=rx.Naive()))
    assert "it was kept, since" in one.message
