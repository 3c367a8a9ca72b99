"""Which of two sensors a damping term reads."""

import jax
import numpy as np
import pytest
from tests.machines import DRAG_TRUTH, drag_record

import riecjax as rx
from riecjax.criteria.suited import with_less_noise
from riecjax.equations.model import as_model

STEP = 0.01
TIME = STEP * np.arange(3000)
MOTION = {"x": np.sin(3 * TIME) + np.sin(7 * TIME), "u": np.cos(TIME)}
MOTION["v"] = 3 * np.cos(3 * TIME) + 7 * np.cos(7 * TIME)
MOTION["u"] = 2 * np.gradient(MOTION["v"], STEP) + 5 * MOTION["v"] + 90 * MOTION["x"]
BOXCAR = rx.RIEC.of_band((1.0, 10.0))


def equation(damping):
    return rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("v",), unit="kg"),
        damping,
        rx.Term("k", "x"),
        -rx.Term(1.0, "u"),
        name="rig",
        unit="N",
    )


BY_POSITION = equation(-rx.Term("c", "x", derivative=1, measured=("v", "a"), unit="N s/m", known=5))
BY_VELOCITY = equation(-rx.Term("c", "v", measured=("a",), unit="N s/m", known=5))


def read(noise, criterion=BOXCAR, record=None):
    record = rx.Record(MOTION, STEP) if record is None else record
    record = record.with_noise(rx.Noise.given(noise)) if isinstance(noise, dict) else record
    return with_less_noise(as_model(BY_POSITION), record, criterion)


@pytest.mark.parametrize(
    ("noise", "criterion", "expected"),
    [
        ({"x": 0.1, "v": 0.1, "u": 0.0}, BOXCAR, BY_VELOCITY),
        # 2 x 0.01 against 0.275 s x 0.01 s x 9.
        ({"x": 0.1, "v": 3.0, "u": 0.0}, BOXCAR, BY_POSITION),
        ({"x": 0.1, "v": 0.0, "u": 0.0}, BOXCAR, BY_VELOCITY),
        # One per cent of the position's standard deviation is not noticed.
        ({"x": 0.01, "v": 0.01, "u": 0.0}, BOXCAR, BY_POSITION),
        ({"x": 0.1, "v": 0.1, "u": 0.0}, rx.RIEC.of_band((1.0, 10.0), rx.Hat()), BY_POSITION),
        ({"x": 0.1, "v": 0.1, "u": 0.0}, rx.DOLS(), BY_POSITION),
        ({"x": 0.0, "v": 0.0, "u": 0.0}, BOXCAR, BY_POSITION),
        (None, BOXCAR, BY_POSITION),
    ],
)
def test_boxcars_read_the_sensor_that_adds_less(noise, criterion, expected):
    found, wanted = read(noise, criterion).stages, as_model(expected).stages
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    np.testing.assert_array_equal(jax.tree.leaves(found), jax.tree.leaves(wanted))


def test_a_velocity_that_is_made_of_the_position_is_not_read():
    record = rx.Record({name: MOTION[name] for name in ("x", "u")}, STEP)
    record = record.with_noise(rx.Noise.given({"x": 0.1, "u": 0.0}))
    found = read(None, record=rx.differentiate(record, "x", "v"))
    assert jax.tree.structure(found.stages) == jax.tree.structure(as_model(BY_POSITION).stages)


@pytest.mark.slow
def test_summaries_of_either_sensor_are_of_the_same_equations():
    clean, noisy = (
        rx.summarise(BY_POSITION, rx.Record(MOTION, STEP), BOXCAR, noise=noise)
        for noise in ("none", {"x": 0.01, "v": 0.01, "u": 0.0})
    )
    assert clean.outline.is_of(noisy.outline)
    both = clean.merge(noisy)
    assert float(rx.estimate(BY_POSITION, both)["m"]) == pytest.approx(2, rel=1e-2)


@pytest.mark.slow
def test_damping_beside_drag_scatters_less():
    """Of noise of a fifth of each signal, that of the position would drown what tells r from r2."""
    inertia = rx.Term("m", "x", derivative=2, measured=("dx",))
    rest = rx.Term("r2", rx.odd("dx", 2)), rx.Term("k", "x"), -rx.Term(1.0, "u")
    errors = {}
    for measured in (("dx",), ()):
        damping = rx.Term("r", "x", derivative=1, measured=measured)
        model = rx.Equation(inertia, damping, *rest)
        fits = [rx.identify(model, drag_record(i, 0.2), intervals=rx.Naive()) for i in range(25)]
        errors[measured] = np.array([float(fit["r"]) for fit in fits]) - DRAG_TRUTH["r"]
    assert np.std(errors["dx",]) < 0.8 * np.std(errors[()])
    assert abs(np.mean(errors["dx",])) < 3 * np.std(errors["dx",]) / 5
