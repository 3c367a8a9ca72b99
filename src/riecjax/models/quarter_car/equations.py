"""The regression equations of the quarter car, eqs (23) and (24), and the paper's procedure.

One equation of motion serves both criteria: DOLS reads it as eq. (23), RIEC as eq. (24).
"""

from jaxtyping import Array

from riecjax.equations.bases import RoofFunctions
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term, Terms
from riecjax.estimation.procedure import Procedure, simultaneous, staged
from riecjax.models.quarter_car.identification import BREAK_POINTS
from riecjax.records.record import Signals


def suspension_velocity(signals: Signals) -> Array:
    """x3 - x4: wheel relative to body, positive in rebound."""
    return signals["x3"] - signals["x4"]


def tyre_equation() -> Equation:
    """(23a), (24a): F_t = K_t x1."""
    return Equation(Term(1.0, "F_t"), -Term("K_t", "x1", unit="N/m"), name="tyre", unit="N")


def mass_equation() -> Equation:
    """(23b), (24b): F_t = M_us x3' + M_s x4'."""
    return Equation(Term(1.0, "F_t"), -_unsprung(), -_sprung(), name="masses", unit="N")


def wheel_equation() -> Equation:
    """(23c), (24c): F_t - M_us x3' = K_s x2 + sum F_i R_i(x3 - x4)."""
    return Equation(Term(1.0, "F_t"), -_unsprung(), -_spring(), -_damper(), name="wheel", unit="N")


def body_equation() -> Equation:
    """(23d), (24d): M_s x4' = K_s x2 + sum F_i R_i(x3 - x4)."""
    return Equation(_sprung(), -_spring(), -_damper(), name="body", unit="N")


def quarter_car_by_body() -> Procedure:
    """The paper's three stages, suspension forces from the motion of the body (variants B)."""
    return staged(tyre_equation(), mass_equation(), body_equation())


def quarter_car_by_wheel() -> Procedure:
    """The paper's three stages, suspension forces from the motion of the wheel (variants W)."""
    return staged(tyre_equation(), mass_equation(), wheel_equation())


def quarter_car_at_once() -> Procedure:
    """All parameters from all four equations in one solve."""
    return simultaneous(tyre_equation(), mass_equation(), wheel_equation(), body_equation())


def _unsprung() -> Term:
    return Term("M_us", "x3", derivative=1, measured=("dx3",), unit="kg")


def _sprung() -> Term:
    return Term("M_s", "x4", derivative=1, measured=("dx4",), unit="kg")


def _spring() -> Term:
    return Term("K_s", "x2", unit="N/m")


def _damper() -> Terms:
    return Terms("F", RoofFunctions(BREAK_POINTS), of=suspension_velocity, unit="N")
