"""Masses and dampers below zero are pointed out; other parameters may have any sign."""

import jax
import numpy as np
import pytest

from riecjax.criteria.criterion import DOLS
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.records.record import Record


def codes(truth: float, unit: str, noise: float = 0.01) -> list[str]:
    rng = np.random.default_rng(0)
    a = rng.normal(size=2000)
    signals = {"a": a, "y": truth * a + noise * rng.normal(size=2000)}
    equation = Equation(Term("c", "a", unit=unit), -Term(1.0, "y"))
    record = Record.from_samples(signals, time_step=0.01)
    return [f.code for f in identify(equation, record, DOLS(), key=jax.random.key(0)).findings()]


@pytest.mark.raises_finding("negative_value")
@pytest.mark.parametrize("unit", ["kg", "kg m^2", "kg·m²", "N s/m", "N*s/m", "N m s/rad"])
def test_masses_and_dampers(unit):
    assert codes(-2.0, unit) == ["negative_value"]
    assert codes(2.0, unit) == []


@pytest.mark.parametrize("unit", ["", "N/m", "N", "1/s", "N m/rad"])
def test_what_may_have_any_sign(unit):
    assert codes(-2.0, unit) == []


@pytest.mark.raises_finding("interval_wider_than_estimate")
def test_what_may_as_well_be_above_zero_is_hardly_determined():
    found = codes(-0.001, "kg", noise=1.0)
    assert "interval_wider_than_estimate" in found
    assert "negative_value" not in found
