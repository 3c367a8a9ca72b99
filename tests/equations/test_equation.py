"""Terms, equations, and which of their terms are force elements."""

import numpy as np
import pytest
from tests.machines import BODY

import riecjax as rx
from riecjax.criteria.criterion import DOLS
from riecjax.equations.bases import Polynomial, roof
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term, Terms
from riecjax.errors import DataError
from riecjax.records.record import Record

RNG = np.random.default_rng(1)
SAMPLES = {name: RNG.normal(size=20) for name in ("x", "dx", "ddx", "y", "u")}
RECORD = Record.from_samples(SAMPLES, time_step=0.1)


def difference(signals):
    return signals["x"] - signals["y"]


def test_parameters_come_in_order_of_first_appearance_and_once():
    equation = Equation(
        Term("m", "ddx"), Terms("F", roof([-1.0, 1.0]), of="x"), Term("m", "dx"), Term(2.0, "u")
    )
    assert equation.parameters == ("m", "F_1", "F_2")


def test_columns_are_signed_sums_and_known_terms_change_sides():
    equation = Equation(
        Term(3.0, "u"),
        -Term("k", difference),
        -Terms("c", Polynomial((1, 2)), of="y", sign=2.0),
        Term("k", "dx"),
        -Term(2.0, "x"),
    )
    rows = DOLS().rows(equation, RECORD)
    s = SAMPLES
    np.testing.assert_allclose(rows.target, -(3 * s["u"] - 2 * s["x"]), rtol=1e-14)
    expected = np.stack([-(s["x"] - s["y"]) + s["dx"], -2 * s["y"], -2 * s["y"] ** 2], axis=1)
    np.testing.assert_allclose(rows.regressors, expected, rtol=1e-12, atol=1e-14)
    assert rows.parameters == ("k", "c_1", "c_2")


@pytest.mark.parametrize(("derivative", "signal"), [(0, "x"), (1, "dx"), (2, "ddx")])
def test_a_derivative_is_read_from_the_signal_that_measures_it(derivative, signal):
    term = Term("m", "x", derivative=derivative, measured=("dx", "ddx"))
    rows = DOLS().rows(Equation(term), RECORD)
    np.testing.assert_array_equal(rows.regressors[:, 0], SAMPLES[signal])


@pytest.mark.parametrize(
    ("term", "words"),
    [
        (Term("m", "x", derivative=1), ["first time derivative of x", "names no signal"]),
        (
            Term("m", difference, derivative=2, measured=("dx",)),
            ["second time derivative of an expression", "--test-function hat"],
        ),
        (
            Term("m", "x", derivative=1, measured=("velocity",)),
            ["'velocity'", "ddx", "--map velocity=COLUMN"],
        ),
        (Term("m", "absent"), ["no signal 'absent'", "--map absent=COLUMN"]),
        (Term("m", lambda s: s["absent"]), ["no signal 'absent'"]),
    ],
)
def test_a_missing_signal_is_explained_with_a_remedy(term, words):
    with pytest.raises(DataError) as caught:
        DOLS().rows(Equation(term), RECORD)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


TRAVEL = rx.difference("x1", "x2")


def equation(*terms: rx.Term) -> rx.Model:
    return rx.staged(rx.Equation(*terms, -rx.Term(1.0, "F"), name="body"))


SPRUNG = equation(
    rx.Term("m", "x", derivative=2),
    rx.Term("c", "x", derivative=1),
    rx.Term("k", "x"),
    rx.Terms("p", rx.Polynomial((3, 5)), "x"),
    rx.Terms("F", rx.roof([-1.0, 0.0, 1.0]), TRAVEL),
    rx.Term("offset", rx.constant),
)


@pytest.mark.parametrize(
    ("model", "of", "why"),
    [
        (rx.staged(BODY), "m", r"'m' is of an acceleration, a mass.*or a map of one: c\."),
        (rx.staged(BODY), "k", r"a position, a stiffness: .* only a softer spring.*one: c\."),
        *(
            (SPRUNG, of, rf"{why}.*or a map of one: c, F_1\.")
            for of, why in (
                ("m", "acceleration"),
                ("k", "position"),
                ("p_3", "position"),
                ("offset", "a constant"),
            )
        ),
    ],
)
def test_units_tell_what_is_no_damper_and_derivatives_where_there_are_none(model, of, why):
    with pytest.raises(rx.ModelError, match=why):
        model.with_elements(rx.SeriesSpring(of))


def test_dampers_are_taken_however_they_are_written():
    taken = [
        rx.Term("c", "v"),
        rx.Term("c", TRAVEL, derivative=1),
        rx.Term("c", rx.difference("v1", "v2"), unit="N s/m"),
    ]
    for damper in taken:
        body = equation(rx.Term("m", "v", derivative=1), damper)
        assert body.with_elements(rx.SeriesSpring("c")).parameter_names[-1] == "K_series"
