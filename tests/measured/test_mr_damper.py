"""A magneto-rheological damper on a shaking table: its force over velocity is no function.

A. N. Vargas, "Data, source code, and documents for the shaking table with MR-damper", Zenodo 2021.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.io

import riecjax as rx
from conftest import measured_data

CRITERION = rx.RIEC(rx.RandomWindows(0.05, 0.5, 4000))
KEY = jax.random.key(0)


@pytest.fixture(scope="module")
def record() -> rx.Record:
    """Coil energised; displacement in mm, force in N; velocity differenced about each sample."""
    data = scipy.io.loadmat(
        measured_data("mr_damper_labcontrol") / "data_simulation_4.4_MRdamper.mat"
    )
    motion = data["x_F"]
    raw = rx.Record.from_samples({"x": motion[:, 0], "F": motion[:, 2]}, time_step=0.01)
    return rx.differentiate(raw, "x", "v")


def curve(record: rx.Record) -> rx.Equation:
    reach = float(jnp.max(jnp.abs(record["v"])))
    points = [-reach, -0.4 * reach, 0.4 * reach, reach]
    return rx.Equation(
        -rx.Terms("F", rx.roof(points), "v", unit="N"),
        rx.Term(1.0, "F"),
        name="damper curve",
        unit="N",
    )


def test_the_damper_curve_rises_and_saturates(record):
    estimate = rx.identify(curve(record), record, CRITERION, key=KEY)
    low, left, right, high = np.asarray(estimate.theta)
    assert left < 0 < right
    assert abs(high - right) < 0.2 * (right - left)
    assert abs(low - left) < 0.2 * (right - left)
    # The authors' Dahl model has 210 N of friction and 1.3 N s/mm of viscous force at 72 mm/s.
    assert right == pytest.approx(300, rel=0.2)


def test_what_the_curve_leaves_is_hysteresis(record):
    """The residual goes with the acceleration's sign: up the stroke and down differ."""
    equation = curve(record)
    estimate = rx.identify(equation, record, CRITERION, key=KEY)
    curve_term = equation.terms[0]
    assert curve_term.basis is not None
    basis = curve_term.basis
    explained = estimate.theta @ basis(record["v"])
    residual = np.asarray(record["F"] - explained)
    velocity, acceleration = np.asarray(record["v"]), np.gradient(np.asarray(record["v"]))
    slow = np.abs(velocity) < 0.25 * np.abs(velocity).max()
    loop = residual[slow & (acceleration > 0)].mean() - residual[slow & (acceleration < 0)].mean()
    force = float(jnp.sqrt(jnp.mean(record["F"] ** 2)))
    assert abs(loop) > 0.1 * force
