"""What a spring may be in series with: dampers, and no mass, stiffness or constant."""

import pytest
from tests.machines import BODY

import riecjax as rx

TRAVEL = rx.difference("x1", "x2")


def equation(*terms: rx.Term | rx.Terms) -> rx.equations.Procedure:
    return rx.staged(rx.Equation(*terms, -rx.Term(1.0, "F"), name="body"))


@pytest.mark.parametrize(
    ("of", "why"),
    [("m", "an acceleration, a mass"), ("k", "a position, a stiffness: .* only a softer spring")],
)
def test_units_tell_what_is_no_damper(of, why):
    with pytest.raises(rx.ModelError, match=f"'{of}' is of {why}.*or a map of one: c\\."):
        rx.staged(BODY).with_series_springs(rx.SeriesSpring(of))


@pytest.mark.parametrize(
    ("of", "why"),
    [("m", "acceleration"), ("k", "position"), ("p_3", "position"), ("offset", "a constant")],
)
def test_derivatives_tell_where_units_do_not(of, why):
    body = equation(
        rx.Term("m", "x", derivative=2),
        rx.Term("c", "x", derivative=1),
        rx.Term("k", "x"),
        rx.Terms("p", rx.Polynomial((3, 5)), "x"),
        rx.Terms("F", rx.roof([-1.0, 0.0, 1.0]), TRAVEL),
        rx.Term("offset", rx.constant),
    )
    with pytest.raises(rx.ModelError, match=rf"{why}.*or a map of one: c, F_1\."):
        body.with_series_springs(rx.SeriesSpring(of))


def test_a_first_derivative_alone_may_be_either_until_its_unit_says():
    mass = rx.Term("m", "v", derivative=1)
    with pytest.raises(rx.ModelError, match=r"says so by its unit: unit='N s/m'.*no equation has"):
        equation(mass).with_series_springs(rx.SeriesSpring("m"))
    for unit in ("N s/m", "kN s/m"):
        damper = equation(rx.Term("c", "x", derivative=1, unit=unit), rx.Term("k", "x", unit="N/m"))
        assert damper.with_series_springs(rx.SeriesSpring("c")).springs


def test_dampers_are_taken_however_they_are_written():
    taken = [
        rx.Term("c", "v"),
        rx.Term("c", TRAVEL, derivative=1),
        rx.Term("c", rx.difference("v1", "v2"), unit="N s/m"),
    ]
    for damper in taken:
        body = equation(rx.Term("m", "v", derivative=1), damper)
        assert body.with_series_springs(rx.SeriesSpring("c")).parameters[-1] == "K_series"
