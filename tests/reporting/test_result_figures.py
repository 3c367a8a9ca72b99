"""What an identification's document and figures hold, against numbers from its samples."""

import json

import equinox as eqx
import jax
import msgspec
import numpy as np
import pytest
from reporting_charts import assert_whole_in_print

import riecjax as rx
from riecjax.assessment.assess import Assessment
from riecjax.charts import Dots, Line
from riecjax.doubts.check import Check
from riecjax.equations.model import as_model, staged
from riecjax.reporting.answer import Known, answer_of
from riecjax.reporting.document import ends_of
from riecjax.reporting.result_figures import (
    curves_figure,
    identification_figures,
    identified_curves,
    residual_figure,
)
from riecjax.simulation.inputs import band_limited_noise
from riecjax.validation.residuals import ResidualTests, residual_tests

MASS = rx.Term("m", "a", unit="kg")
EQUATION = rx.Equation(MASS, rx.Term("c", "v", unit="N s/m"), -rx.Term(1.0, "f"))


@pytest.fixture(scope="module")
def record() -> rx.Record:
    rng = np.random.default_rng(0)
    a, v = rng.normal(size=(2, 500))
    return rx.Record({"a": a, "v": v, "f": 2 * a + 3 * v + 0.1 * rng.normal(size=500)}, 0.01)


@pytest.fixture(scope="module")
def identified(record):
    return rx.identify(EQUATION, record, rx.DOLS(), known={"c": 3.0})


def result_of(estimate, model, record) -> Assessment:
    return Assessment(
        model=as_model(model),
        recordings=[rx.Recording(record, "a.csv", ("filtered",))],
        validated_on=[],
        checked=Check([], [], (), estimate.criterion),
        estimate=estimate,
        tests=(ResidualTests(()),),
        key=jax.random.key(5),
    )


def test_a_document_holds_numbers_that_samples_give(identified, record):
    answer = answer_of(result_of(identified, staged(EQUATION), record))
    a, left = np.asarray(record["a"]), np.asarray(record["f"] - 3 * record["v"])
    mass = (a @ left) / (a @ a)
    naive = np.sqrt(np.sum((left - mass * a) ** 2) / 499 / (a @ a))
    error = float(identified.standard_error("m"))
    assert msgspec.to_builtins(answer.parameters["m"]) == {
        "value": pytest.approx(mass, rel=1e-9),
        "unit": "kg",
        "std_error": error,
        "interval95": identified.interval("m"),
        "naive_std_error": pytest.approx(naive, rel=1e-9),
        "effective_windows": pytest.approx(500 * (naive / error) ** 2, rel=1e-9),
    }
    assert answer.known == {"c": Known(value=3.0, unit="N s/m")}
    share = np.sqrt(np.mean((left - mass * a) ** 2) / np.mean(left**2))
    assert answer.residual.relative_rms == pytest.approx(share, rel=1e-9)
    assert answer.residual.stages[0].rows == 500
    assert answer.provenance.preparation == ["filtered"]
    assert answer.provenance.seed == 5


def test_numbers_that_are_not_finite_become_null(identified, record):
    lost = eqx.tree_at(lambda e: e.uncertainty.covariance, identified, np.full((1, 1), np.nan))
    answer = answer_of(result_of(lost, staged(EQUATION), record))
    assert answer.parameters["m"].interval95 == (None, None)
    json.dumps(msgspec.to_builtins(answer), allow_nan=False)


@pytest.mark.parametrize(
    ("criterion", "unit"),
    [
        (rx.DOLS(), "N"),
        (rx.RIEC(rx.RandomWindows(0.05, 0.2, 300)), "N s"),
        (rx.RIEC(rx.RandomWindows(0.05, 0.2, 300), rx.Hat()), "N s^2"),
        (rx.RIEC(rx.RandomWindows(0.05, 0.2, 300), rx.Bump()), "N s"),
    ],
)
def test_fit_shows_what_is_explained_against_what_was_measured(record, criterion, unit):
    equation = rx.Equation(*EQUATION.terms[:2], -rx.Term(1.0, "f", unit="N"), unit="N")
    model = staged(equation)
    key = jax.random.key(0)
    summary = rx.summarise(model, record, criterion, key=key, survey=True)
    found = rx.estimate(model, summary)
    chart = identification_figures(result_of(found, model, record))["fit"]
    fit, residual = chart.panels
    dots, left = fit.marks[-1], residual.marks[-1]
    assert isinstance(dots, Dots)
    assert isinstance(left, Dots)
    explained, measured = np.asarray(dots.x), np.asarray(dots.y)
    scatter = np.asarray(left.y)
    np.testing.assert_allclose(measured - explained, scatter, atol=1e-12)
    # The residual of a least-squares fit is at right angles to what is explained.
    assert abs(explained @ scatter) < 1e-9 * (explained @ explained)
    assert fit.x.label.endswith(f"({unit})")
    share = np.sqrt(np.mean(scatter**2) / np.mean(measured**2))
    assert share == pytest.approx(float(found.stages[0].relative_rms), rel=1e-6)


def damper(t):
    v = np.cos(3 * t) + 0.5 * np.sin(7 * t)
    return v, np.interp(v, [-2.0, -0.5, 0.5, 2.0], [-9.0, -5.0, 4.0, 7.0])


def test_curves_pass_through_their_break_points_and_leave_the_hysteresis():
    t = np.arange(3000) * 0.01
    v, force = damper(t)
    lag = 0.8 * np.sign(np.gradient(v))
    record = rx.Record({"v": rx.Signal(v, unit="m/s"), "F": force + lag}, 0.01)
    points = [-2.0, -0.5, 0.5, 2.0]
    equation = rx.Equation(
        -rx.Terms("F_d", rx.roof(points), "v", unit="N"), rx.Term(1.0, "F"), unit="N"
    )
    model = staged(equation)
    estimate = rx.identify(model, record, rx.DOLS(), intervals=rx.Naive())
    (curve,) = identified_curves(result_of(estimate, model, record))
    inner = (np.array(points) > v.min()) & (np.array(points) < v.max())
    at_points = np.interp(np.array(points)[inner], curve.x, curve.y)
    np.testing.assert_allclose(at_points, np.asarray(estimate.theta)[inner], atol=0.02)
    assert curve.samples is not None
    x, y = curve.samples
    np.testing.assert_allclose(x, v)
    np.testing.assert_allclose(y, force + lag, atol=1e-12)
    above, below = curves_figure([curve]).panels
    assert below.x.label == "v / (m/s)"
    assert above.y.label == "F_d / (N)"
    (left,) = (mark for mark in below.marks if isinstance(mark, Line))
    np.testing.assert_allclose(np.asarray(left.y), y - np.interp(x, curve.x, curve.y))
    band = above.marks[-1]
    assert isinstance(band, Line)
    assert band.high is not None
    np.testing.assert_allclose(np.asarray(band.high), curve.y + 1.96 * curve.error)


def test_a_curve_is_drawn_beside_what_each_recording_has_of_its_own():
    v = np.sin(0.01 * np.arange(2000)) + 0.3 * np.sin(0.037 * np.arange(2000))
    records = [rx.Record({"v": v, "F": 3 * v + v**3 + zero}, 0.01) for zero in (1.0, 2.0)]
    law, zero = rx.Terms("k", rx.Polynomial((1, 3)), "v"), rx.Term("zero", rx.constant)
    model = staged(rx.Equation(law, zero, -rx.Term(1.0, "F")))
    estimate = rx.identify(model, records, per_record=["zero"], intervals=rx.Naive())
    (curve,) = identified_curves(result_of(estimate, model, records[0]))
    assert curve.samples is not None
    np.testing.assert_allclose(curve.samples[1], 3 * v + v**3, atol=1e-8)
    np.testing.assert_allclose(curve.y, 3 * curve.x + curve.x**3, atol=1e-8)


def recording() -> tuple[rx.Equation, rx.Record]:
    """A spring with a left-out oscillation at 12 Hz, unit and a gap."""
    n, step = 4000, 0.005
    motion = np.asarray(band_limited_noise(jax.random.key(0), n, step, bandwidth=30.0, rms=1.0))
    time = step * np.arange(n)
    rng = np.random.default_rng(0)
    phase = np.cumsum(0.1 * rng.normal(size=n))
    force = 4 * motion + np.sin(2 * np.pi * 12 * time + phase) + 0.01 * rng.normal(size=n)
    gap = np.arange(n) == 1000
    record = rx.Record({"x": motion, "F": rx.Signal(force, ~gap)}, step)
    return rx.Equation(rx.Term("k", "x"), -rx.Term(1.0, "F"), name="spring", unit="N"), record


@pytest.fixture(scope="module")
def left():
    """What the spring leaves, and its figure."""
    model, record = recording()
    tests = residual_tests(model, record, {"k": 4.0}, windows=rx.AllWindows(0.05, 0.5))
    return tests["spring"], residual_figure(tests["spring"])


def test_every_axis_is_labelled_with_its_unit_and_inside_the_figure(left):
    _, chart = left
    for panel in chart.panels:
        assert panel.x.label
        assert panel.y.label
    assert_whole_in_print(chart)
    labels = {panel.y.label for panel in chart.panels}
    assert {"impulse of the error / (N s)", "power density / (N²/Hz)"} <= labels


def test_lines_hold_the_series_and_break_at_a_gap(left):
    residual, chart = left
    impulse = np.asarray(residual.error.impulse)
    lines = [mark for panel in chart.panels for mark in panel.marks]
    series = [np.asarray(mark.y) for mark in lines if isinstance(mark, Line)]
    (found,) = (values for values in series if values.size == impulse.size)
    gone = ~np.asarray(residual.error.present)
    np.testing.assert_array_equal(np.isnan(found), gone)
    assert gone.sum() == 2
    np.testing.assert_allclose(found[~gone], impulse[~gone])


@pytest.mark.parametrize(
    ("interval", "said"),
    [
        ((19.98634, 20.02816), ["19.9863", "20.0282"]),
        # Half the width, 1.2e-6, has two digits down to the seventh decimal.
        ((11.9999988, 12.0000012), ["11.9999988", "12.0000012"]),
        ((-1e5 - 0.003, -1e5 + 0.003), ["-100000.003", "-99999.997"]),
        ((12.0, 12.0), ["12", "12"]),
        ((None, 3.0), ["none", "3"]),
        ((None, None), ["none"]),
        ((float("-inf"), 2.0), ["-inf", "2"]),
        # Beyond twelve digits numbers are rounding.
        ((1.0, 1.0 + 1e-15), ["1", "1"]),
        ((-0.5, 0.25), ["-0.5", "0.25"]),
    ],
)
def test_ends_differ_in_print(interval, said):
    assert ends_of(interval) == said
