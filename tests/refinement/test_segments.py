"""Searches that are lost over a whole recording: it is reached by way of segments, or they stay."""

import numpy as np
import pytest
import scipy.integrate

from riecjax.assessment.assess import assess
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.models.catalogue import built_in_model
from riecjax.records.record import Record
from riecjax.refinement.output_error import OutputError, Tiles
from riecjax.refinement.refine import refine

RATE = 100
HARD = {"m": 1.0, "d": 2.0, "k1": 100.0, "k2": 0.0, "k3": 2e6}


@pytest.fixture(scope="module")
def hard() -> Record:
    """40 s of m x'' + d x' + k1 x + k3 x^3 = u by SciPy's DOP853, without noise.

    50 N at 1.3 Hz that fade in, and 25 tones of 0.3 N from 0.1 to 3 Hz with random phases: k3 x^2
    reaches 36 k1, and neighbouring motions part by a factor of 1e5 in 20 s, so that no steps and no
    parameters of ten digits follow the recording as a whole.
    """
    frequencies = np.linspace(0.1, 3.0, 25)
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, 25)

    def force(t: float | np.ndarray) -> np.ndarray:
        angles = 2 * np.pi * np.multiply.outer(t, frequencies) + phases
        both = 50 * np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.sin(angles).sum(axis=-1)
        return both * (1 - np.exp(-t / 2))

    def slope(t: float, s: np.ndarray) -> list[float]:
        return [s[1], float(force(t)) - 2 * s[1] - 100 * s[0] - 2e6 * s[0] ** 3]

    t = np.arange(40 * RATE) / RATE
    run = scipy.integrate.solve_ivp(slope, (0, t[-1]), [0, 0], "DOP853", t, rtol=1e-11, atol=1e-13)
    assert 30 < HARD["k3"] * np.max(run.y[0] ** 2) / HARD["k1"] < 40
    return Record.from_samples({"u": force(t), "y": run.y[0], "dy": run.y[1]}, time_step=1 / RATE)


def assert_true(values) -> None:
    """Within 0.1 % of the truth; k2 y^2 within that of the rest of the spring's force."""
    for name, true in HARD.items():
        within = 1e-3 * (true or HARD["k1"] / 0.03)
        assert float(values[name]) == pytest.approx(true, abs=within), name


def test_a_motion_that_nothing_predicts_for_long_is_refined_over_segments(hard):
    model = built_in_model("duffing")
    start = identify(model, hard)
    assert abs(float(start["k1"]) / HARD["k1"] - 1) > 1e-3
    refined = refine(model, hard, start)
    assert bool(refined.search.converged)
    assert dict(refined.search.by)["windows"] == "tiles"
    assert_true(refined)


def test_an_assessment_refines_it_by_itself(hard):
    assessment = assess(built_in_model("duffing"), hard)
    assert assessment.refinement is not None
    assert assessment.refinement.chosen, assessment.refinement.declined
    assert "refinement_not_converged" not in {f.code for f in assessment.findings()}
    assert_true(assessment.answer)


@pytest.fixture(scope="module")
def swinging() -> Record:
    """A minute of a lightly damped oscillator, its closed form, at 2 Hz."""
    t = np.arange(6000) / RATE
    w, decay = 4 * np.pi, 0.02
    noise = 0.02 * np.random.default_rng(1).normal(size=t.size)
    return Record.from_samples(
        {"x": np.exp(-decay * t) * np.cos(w * t) + noise}, time_step=1 / RATE
    )


def swing() -> Equation:
    return Equation(Term(1.0, "x", derivative=2), Term("c", "x", derivative=1), Term("k", "x"))


def test_a_start_from_afar_comes_to_the_whole_record(swinging):
    """Its phase is off by 12 turns at the end."""
    start = {"c": 0.05, "k": (0.9 * 4 * np.pi) ** 2}
    refined = refine(swing(), swinging, start)
    assert bool(refined.search.converged)
    assert dict(refined.search.by)["windows"] == "whole record"
    k = (4 * np.pi) ** 2 + 0.02**2
    assert abs(float(refined["k"]) - k) < 5 * float(refined.standard_error("k"))
    assert float(refined["k"]) == pytest.approx(k, rel=1e-4)
    assert float(refined["c"]) == pytest.approx(0.04, rel=0.05)
    rms = float(refined.search.rms[0])
    assert rms == pytest.approx(0.02, rel=0.05)


def test_segments_that_were_asked_for_stay(swinging):
    """Only whole records are reached by way of others."""
    start = {"c": 0.05, "k": (0.9 * 4 * np.pi) ** 2}
    refined = refine(swing(), swinging, start, OutputError(Tiles(samples=400)))
    assert dict(refined.search.by)["samples"] == 400
