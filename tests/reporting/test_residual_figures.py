import jax
import numpy as np
import pytest
from reporting_charts import assert_whole_in_print

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.records.record import Record
from riecjax.reporting.charts.chart import Chart, HeatMap, Line
from riecjax.reporting.charts.printed import printed
from riecjax.reporting.identification_figures import (
    density_label,
    residual_figures,
    window_choice_figures,
)
from riecjax.simulation.inputs import band_limited_noise
from riecjax.studies.choice import window_choice
from riecjax.validation.residuals import residual_tests


def recording() -> tuple[Equation, Record]:
    """A spring with a left-out oscillation at 12 Hz, unit and a gap."""
    n, step = 4000, 0.005
    motion = np.asarray(band_limited_noise(jax.random.key(0), n, step, bandwidth=30.0, rms=1.0))
    time = step * np.arange(n)
    rng = np.random.default_rng(0)
    phase = np.cumsum(0.1 * rng.normal(size=n))
    force = 4 * motion + np.sin(2 * np.pi * 12 * time + phase) + 0.01 * rng.normal(size=n)
    gap = np.arange(n) == 1000
    record = Record({"x": motion, "F": force}, step, missing={"F": gap})
    return Equation(Term("k", "x"), -Term(1.0, "F"), name="spring", unit="N"), record


@pytest.fixture(scope="module")
def figures():
    model, record = recording()
    tests = residual_tests(model, record, {"k": 4.0}, windows=AllWindows(0.05, 0.5))
    choice = window_choice(model, record, {"k": 4.0}, windows=AllWindows(0.05, 0.5))
    return tests, choice, {**residual_figures(tests), **window_choice_figures(choice)}


def test_there_is_one_figure_of_residuals_for_each_equation(figures):
    _, _, drawn = figures
    assert list(drawn) == ["residual_1", "window_choice"]


def test_every_axis_is_labelled_with_its_unit_and_inside_the_figure(figures):
    _, _, charts = figures
    for chart in charts.values():
        for panel in chart.panels:
            assert panel.x.label
            assert panel.y.label
        assert_whole_in_print(chart)
    labels = {panel.y.label for panel in charts["residual_1"].panels}
    assert {"impulse of the error / (N s)", "power density / (N²/Hz)"} <= labels


def labels_of(chart: Chart) -> list[str]:
    marks = [mark for panel in chart.panels for mark in panel.marks]
    return [mark.label for mark in marks if not isinstance(mark, HeatMap)]


def test_the_peak_and_the_recommended_range_are_named(figures):
    tests, choice, drawn = figures
    assert tests["spring"].peak is not None
    legends = [label for chart in drawn.values() for label in labels_of(chart)]
    assert any(text.startswith("peak near 1") for text in legends)
    low, high = choice.recommended
    assert f"recommended, {low:.2g} to {high:.2g} s" in legends
    assert "in use, 0.05 to 0.5 s" in legends


def test_lines_hold_the_series_and_break_at_a_gap(figures):
    tests, _, drawn = figures
    impulse = np.asarray(tests["spring"].error.impulse)
    lines = [mark for panel in drawn["residual_1"].panels for mark in panel.marks]
    series = [np.asarray(mark.y) for mark in lines if isinstance(mark, Line)]
    (found,) = (values for values in series if values.size == impulse.size)
    gone = ~np.asarray(tests["spring"].error.present)
    np.testing.assert_array_equal(np.isnan(found), gone)
    assert gone.sum() == 2
    np.testing.assert_allclose(found[~gone], impulse[~gone])


def test_a_criterion_without_windows_and_an_equation_without_unit_are_drawn_too():
    model, record = recording()
    plain = Equation(*model.terms, name="spring")
    tests = residual_tests(plain, record, {"k": 4.0})
    (chart,) = residual_figures(tests).values()
    printed(chart).canvas.draw()
    assert density_label("") == "power density / (1/Hz)"
    assert density_label("N m") == "power density / ((N m)²/Hz)"


@pytest.mark.slow
def test_the_windows_of_an_estimate_are_those_in_use():
    from riecjax.estimation.identify import identify

    model, record = recording()
    estimate = identify(model, record, RIEC(AllWindows(0.1, 0.3)))
    (chart,) = window_choice_figures(window_choice(model, record, estimate)).values()
    assert "in use, 0.1 to 0.3 s" in labels_of(chart)
