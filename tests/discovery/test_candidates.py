"""Candidates, their widths and units."""

import numpy as np
import pytest

import riecjax as rx
from riecjax.discovery.candidate import Shaped, default_candidates, not_offered
from riecjax.equations.motions import per

RNG = np.random.default_rng(0)
MASS = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg"), -rx.Term(1.0, "u"), unit="N"
)


def record(*names: str) -> rx.Record:
    return rx.Record.from_samples(
        {name: RNG.standard_normal(500) for name in names}, time_step=0.01
    )


def candidates(model: rx.Equation | rx.Model, *names: str):
    return default_candidates(rx.equations.as_model(model), [record(*names)])


def units_of(found) -> dict[str, str]:
    """Unit of each candidate's coefficient."""
    terms = [(one.at(0) if isinstance(one, Shaped) else one).terms[0] for one in found]
    return {one.name: next(iter(term.units.values())) for one, term in zip(found, terms)}


def test_a_mass_may_lack_friction_springs_and_an_offset_in_the_units_of_its_inertia():
    assert units_of(candidates(MASS, "x", "dx", "u")) == {
        "viscous": "N s/m",
        "coulomb": "N",
        "asymmetry": "N s/m",
        "quadratic_drag": "N s^2/m^2",
        "cubic_drag": "N s^3/m^3",
        "stribeck": "N",
        "limited_friction": "N s/m",
        "dahl": "N",
        "bouc_wen": "N",
        "stiffness": "N/m",
        "quadratic_stiffness": "N/m^2",
        "cubic_stiffness": "N/m^3",
        "quintic_stiffness": "N/m^5",
        "dead_zone": "N/m",
        "saturation": "N/m",
        "product": "N s/m^2",
        "offset": "N",
        "drift": "N/s",
    }


def told(model: rx.Equation | rx.Model, record: rx.Record) -> list[tuple[str, ...]]:
    found = not_offered(rx.equations.as_model(model), [record])
    assert all(one.code == "not_offered" for one in found)
    return [(*one.signals, one.message) for one in found]


@pytest.mark.raises_finding("not_offered")
def test_what_has_no_signal_is_said_and_how_to_name_one():
    nameless = rx.Equation(rx.Term("m", "x", derivative=2, unit="kg"), -rx.Term(1.0, "u"), unit="N")
    names = {*units_of(candidates(nameless, "x", "dx", "u"))}
    assert not names & {"coulomb", "dahl", "stribeck", "product"}
    ((signal, message),) = told(nameless, record("x", "u"))
    assert signal == "x"
    assert "measured=('dx',)" in message
    # By the name that the recording has for it.
    x = np.sin(0.02 * np.arange(500))
    speed = rx.Record.from_samples({"x": x, "speed": np.gradient(x), "u": x**2}, time_step=0.01)
    ((_, message),) = told(nameless, speed)
    assert "measured=('speed',)" in message
    rotor = rx.Equation(rx.Term("J", "w", derivative=1, unit="kg m^2"), -rx.Term(1.0, "T"))
    assert "stiffness" not in units_of(candidates(rotor, "w", "T"))
    ((signal, message),) = told(rotor, record("w", "T"))
    assert signal == "w"
    assert "springs" in message


@pytest.mark.no_finding("not_offered")
@pytest.mark.parametrize("model", ["mass", "quarter-car", "emps"])
def test_of_what_can_all_be_offered_nothing_is_said(model):
    model = rx.equations.as_model(MASS) if model == "mass" else rx.find_model(model)
    names = {*(signal.name for signal in model.signals), "x", "dx", "u"}
    assert told(model, record(*names)) == []


def test_of_several_motions_candidates_carry_the_signals_name_and_of_several_equations_theirs():
    model = rx.find_model("quarter-car")
    found = candidates(model, "x1", "x2", "x3", "x4", "F_t")
    names = [one.name for one in found]
    assert len(set(names)) == len(names)
    assert {"viscous_x3", "stiffness_x2", "offset_tyre"} <= {*names}
    assert units_of(found)["viscous_x3"] == "N s/m"


def test_widths_lie_within_the_motion_and_grow_and_closer_ones_keep_that_which_they_are_around():
    for one in candidates(MASS, "x", "dx", "u"):
        if isinstance(one, Shaped):
            assert np.all(np.diff(one.widths) > 0)
            assert 0 < one.widths[0] < one.widths[-1] < 3
            for number in (0, 2, 5) if one.name == "dead_zone" else ():
                closer = one.closer(number)
                assert one.widths[number] in closer.widths
                assert closer.widths.size == one.widths.size
                assert np.all(np.diff(closer.widths) > 0)
                assert np.ptp(closer.widths) < np.ptp(one.widths)


@pytest.mark.parametrize(
    ("unit", "of", "power", "found"),
    [
        ("N", "m/s", 2, "N s^2/m^2"),
        ("N m", "rad/s", 1, "N m s/rad"),
        ("rad/s^2", "rad/s", 2, "1/rad"),
        ("N/m", "m/s", 1, "N s/m^2"),
        ("N", "N", 1, ""),
        ("V/(m s)", "m", 1, "V/(m^2 s)"),
        ("N", "", 0, "N"),
        ("m/s", "1/s", 1, "m"),
    ],
)
def test_units_of_coefficients(unit, of, power, found):
    assert per(unit, of, power) == found
