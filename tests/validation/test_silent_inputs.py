"""A force that was not recorded beside the motion it drove, and two that only look like it."""

import numpy as np
import pytest
import scipy.signal

from riecjax.assessment.trust import what_is_left
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import as_procedure
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.summaries.task import ready
from riecjax.uncertainty.intervals import Sandwich

STEP, SAMPLES = 0.01, 3000
AXIS = as_procedure(
    Equation(
        Term("m", "x", derivative=2, measured=("v",), unit="kg"),
        Term("c", "x", derivative=1, measured=("v",), unit="N s/m"),
        Term("k", "x", unit="N/m"),
        -Term(1.0, "F"),
        name="axis",
    )
)


def driven(seed) -> dict[str, np.ndarray]:
    """Motion under a force of white noise that is held from sample to sample, to the last digit."""
    force = np.random.default_rng(seed).normal(size=SAMPLES)
    system = scipy.signal.StateSpace([[0, 1], [-100.0, -3.0]], [[0], [1.0]], np.eye(2), [[0], [0]])
    _, motion, _ = scipy.signal.lsim(system, force, STEP * np.arange(SAMPLES), interp=False)
    return {"x": motion[:, 0], "v": motion[:, 1], "F": force}


def codes(signals, *others) -> list[tuple[str, tuple[str, ...]]]:
    every = [Record.from_samples(one, time_step=STEP) for one in (signals, *others)]
    records = [one.record for one in ready(AXIS, every)]
    estimate = identify(AXIS, records, intervals=Sandwich())
    residuals, _, _ = what_is_left(AXIS, records, estimate, lambda some: identify(AXIS, some))
    assert residuals is not None
    return [(f.code, f.signals) for f in residuals.faults]


SILENT = {
    "constant": lambda rng: np.full(SAMPLES, 0.3),
    "noise": lambda rng: 1e-3 * rng.normal(size=SAMPLES),
    "noise about an offset": lambda rng: 0.3 + 1e-3 * rng.normal(size=SAMPLES),
    "a last digit that flickers": lambda rng: 1e-3 * rng.integers(0, 2, SAMPLES),
}


@pytest.mark.raises_finding("silent_input")
@pytest.mark.parametrize("case", SILENT)
def test_an_input_that_says_nothing_is_named(case):
    signals = driven(0) | {"F": SILENT[case](np.random.default_rng(1))}
    assert codes(signals) == [("silent_input", ("F",))]


@pytest.mark.no_finding("silent_input")
def test_a_force_of_white_noise_is_none_nor_is_free_motion():
    assert codes(driven(0)) == []
    signals = driven(1)
    signals["F"][500:] = 0.0
    assert codes(signals) == []


@pytest.mark.raises_finding("silent_input")
def test_of_several_recordings_the_silent_one_is_named():
    signals = driven(1) | {"F": np.full(SAMPLES, 0.3)}
    assert codes(driven(0), signals) == [("silent_input", ("F",))]
