"""Unknown offsets and gains of sensors, beside truth and beside the algebra that they follow."""

import numpy as np
import pytest

import riecjax as rx
from riecjax.errors import ModelError

M, C, K = 2.0, 3.0, 80.0
TIME = np.arange(4000) * 0.005


def motion():
    """A mass on spring and damper: position and force, in closed form."""
    rng = np.random.default_rng(20240501)
    x, v, a = np.zeros((3, TIME.size))
    for w in (2.0, 5.0, 9.0, 14.0):
        phase = w * TIME + rng.uniform(0, 6)
        x, v, a = x + np.sin(phase) / w, v + np.cos(phase), a - w * np.sin(phase)
    return x, M * a + C * v + K * x


def equation(*more, k=rx.Term("k", "x", unit="N/m")):
    return rx.Equation(
        rx.Term("m", "x", derivative=2, unit="kg"),
        rx.Term("c", "x", derivative=1, unit="N s/m"),
        k,
        -rx.Term(1.0, "F"),
        *more,
        unit="N",
    )


def estimate(procedure, x, force, **fixed):
    record = rx.Record.from_samples({"x": x, "F": force}, time=TIME)
    criterion = rx.RIEC(rx.every_window(rx.Hat(), band=(0.3, 3.0))) if False else None
    found = rx.identify(record, procedure, criterion, **fixed)
    return {name: float(value) for name, value in found.values.items()}


def test_the_zero_of_a_load_cell():
    x, force = motion()
    procedure = rx.as_model(equation()).build_procedure().with_unknown_offset("F", "N")
    assert procedure.units["offset_F"] == "N"
    found = estimate(procedure, x, force + 7.0)
    assert found["offset_F"] == pytest.approx(7.0, rel=1e-3)
    assert found["k"] == pytest.approx(K, rel=1e-3)
